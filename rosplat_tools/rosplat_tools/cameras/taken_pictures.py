"""Pictures of a real camera, from topics, each with lens, mask and pose.

Hears `image_raw`, `camera_info` and `mask`, and poses by TF or on `pose`. Of the pictures that came
while another was in use, only the newest is used.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header

from rosplat_core.lenses import Lens
from rosplat_ros.images import from_image, read_mask
from rosplat_ros.program.parameters import declare, declare_clip, declare_path
from rosplat_tools.cameras import calibrations
from rosplat_tools.cameras.drawn_map import DrawnMap
from rosplat_tools.cameras.health import Health, NoPicture
from rosplat_tools.cameras.pose_history import Pose, PoseError
from rosplat_tools.cameras.poses import declare_poses, nanoseconds
from rosplat_tools.latched import LatchedSubscription

# Until publishers are known, as of best effort a busy machine loses most pictures.
PICTURES = QoSProfile(depth=5)
WAITING = 8  # pictures that wait for their poses
SILENCE = 5.0  # after which the log says that no picture has come [s]
PATIENCE = 1.0  # how long pictures wait for poses before a warning [s]

Optics = TypeVar("Optics")


@dataclass(frozen=True, eq=False)
class Taken(Generic[Optics]):
    """A picture that a camera took."""

    header: Header
    colours: NDArray[np.uint8]
    """(height, width, 3) RGB."""
    counts: NDArray[np.bool_]
    """(height, width) true of pixels that the mask leaves in."""
    optics: Optics
    """What `prepare` made of the lens."""
    rotation: Pose
    """(4, 4) from the optical frame into the lens's; the identity unless rectified."""
    pose: Pose
    """(4, 4) of the optical frame in the map's, before any refinement. [m]"""

    @property
    def world_to_lens(self) -> NDArray[np.float64]:
        """(4, 4) [m]"""
        return np.asarray(self.rotation @ np.linalg.inv(self.pose), np.float64)

    @property
    def stamp(self) -> int:
        """[ns]"""
        return nanoseconds(self.header.stamp)


class PictureReader(Generic[Optics]):
    """Reads pictures with their CameraInfo and mask. Keeps the lens between pictures."""

    def __init__(
        self,
        prepare: Callable[[Lens], Optics],
        *,
        rectified: bool = False,
        mask: NDArray[np.bool_] | None = None,
    ) -> None:
        """prepare: called once with each lens; may raise LensError. rectified: whether pictures are
        rectified, by r and p of their CameraInfo. mask (height, width): false where pixels don't
        count.
        """
        self._prepare, self._rectified, self.mask = prepare, rectified, mask
        self._lens: tuple[CameraInfo, Optics, Pose] | None = None

    def read(self, image: Image, info: CameraInfo | None, pose: Pose) -> Taken[Optics]:
        """A picture, from where it was taken. Raises NoPicture."""
        optics, rotation = self._lens_of(image, info)
        try:
            colours = from_image(image)
        except ValueError as error:
            raise NoPicture("not read", error) from error
        counts = self.mask
        if counts is None:
            counts = np.ones(colours.shape[:2], bool)
        elif counts.shape != colours.shape[:2]:
            raise NoPicture("of another size", "the mask has another size than pictures")
        elif not counts.any():
            raise NoPicture("masked", "the mask leaves no pixel")
        return Taken(image.header, colours, counts, optics, rotation, pose)

    def _lens_of(self, image: Image, info: CameraInfo | None) -> tuple[Optics, Pose]:
        if info is None:
            raise NoPicture("without a lens", "no CameraInfo has come on camera_info")
        if (image.width, image.height) != (info.width, info.height):
            raise NoPicture(
                "of another size",
                f"a picture is {image.width} x {image.height}, camera_info says "
                f"{info.width} x {info.height}",
            )
        if not self._lens or self._lens[0] is not info:
            turned = np.eye(4)
            try:
                if self._rectified:
                    lens, turned[:3, :3] = calibrations.rectified(info)
                else:
                    lens = calibrations.lens_of(info)
                self._lens = info, self._prepare(lens), turned
            except ValueError as error:  # LensError, or beyond what float32 or int64 holds
                raise NoPicture("without a lens", f"camera_info is refused: {error}") from error
        return self._lens[1:]


class TakenPictures(Generic[Optics]):
    """Pictures of one camera. Callbacks queue them; the drawing thread calls all else."""

    def __init__(self, node: Node, drawn_map: DrawnMap, prepare: Callable[[Lens], Optics]) -> None:
        """prepare: called once with each lens; may raise LensError.

        Declares poses, rectified, mask, near and far. Raises InputError.
        """
        rectified = declare(node, "rectified", False, "Pictures are rectified, by r and p.")
        mask = declare_path(node, "mask", "", "Picture file, black where pixels don't count.")
        self.near, self.far = declare_clip(node)
        pixels = read_mask(mask) if mask else None
        self._reader = PictureReader(prepare, rectified=rectified, mask=pixels)
        self._map = drawn_map
        self._poses = declare_poses(node, [""], drawn_map.came.set)
        self._images: deque[Image] = deque(maxlen=WAITING)
        self._began = self._poseless_since = time.monotonic()  # since when pictures wait for poses
        self._info: CameraInfo | None = None
        self.newest: Image | None = None
        """The last picture that came, whether or not it was used."""
        self.health = Health(node.resolve_topic_name("image_raw"), node.get_logger().warning)
        LatchedSubscription(node, Image, "image_raw", self._on_image, PICTURES)
        LatchedSubscription(node, CameraInfo, "camera_info", self._on_info, PICTURES)
        LatchedSubscription(node, Image, "mask", self._on_mask, PICTURES)

    # --- What ROS hands over ----------------------------------------------------------------------

    def _on_image(self, image: Image) -> None:
        self.newest = image
        self._images.append(image)
        self._map.came.set()

    def _on_info(self, info: CameraInfo) -> None:
        info.header = Header()  # with another time it is the same calibration
        if info != self._info:
            self._info = info

    def _on_mask(self, image: Image) -> None:
        try:
            self._reader.mask = np.asarray(from_image(image).any(axis=-1))
        except ValueError as error:
            self.health.trouble("masks", f"a mask is left out: {error}")

    # --- Of the drawing thread --------------------------------------------------------------------

    def forget(self) -> None:
        """Drops the pictures that wait: nobody wants them."""
        self._drop(len(self._images))

    def next(self) -> Taken[Optics] | None:
        """The newest picture whose pose is known. Drops it and older ones from the queue.

        None if no picture waits, or if poses may yet come. Raises NoPicture.
        """
        images = list(self._images)
        now = time.monotonic()
        if self.newest is None and now - self._began > SILENCE:
            self.health.silence("no picture has come")
        if images and (problem := self._map.problem()):
            self._drop(len(images))
            raise NoPicture("without a map", problem)
        if not images:
            self._poseless_since = now
        for number, image in reversed(list(enumerate(images))):
            try:
                pose = self._pose_of(image)
            except PoseError as error:
                # Not one picture's wait: a fast camera pushes each out of the queue before that.
                if number == 0 and now - self._poseless_since > PATIENCE:
                    self._drop(len(images))
                    self._poseless_since = now
                    raise NoPicture("without a pose", error) from error
                continue
            self._poseless_since = now
            self._drop(number + 1)
            self.health.counts["skipped"] += number
            return self.read(image, pose)
        return None

    def read(self, image: Image, pose: Pose) -> Taken[Optics]:
        """A picture, from where it was taken. Raises NoPicture."""
        return self._reader.read(image, self._info, pose)

    def _drop(self, count: int) -> None:
        for _ in range(min(count, len(self._images))):
            self._images.popleft()

    def _pose_of(self, image: Image) -> Pose:
        header = image.header
        when = nanoseconds(header.stamp)
        return self._poses.at("", header.frame_id, self._map.frame_id, when)
