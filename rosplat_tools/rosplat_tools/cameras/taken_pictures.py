"""Pictures of a real camera, from topics, each with lens, mask and pose.

Hears `image_raw`, `camera_info` and `mask`, and poses by TF or on `pose`. Of the pictures that came
while another was in use, only the newest is used.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Generic

import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header

from rosplat_core.cameras import Camera
from rosplat_core.lenses import Lens
from rosplat_ros.images import from_image, read_mask
from rosplat_ros.program.parameters import declare, declare_clip, declare_path
from rosplat_ros.qos import PICTURES
from rosplat_tools.cameras import calibrations
from rosplat_tools.cameras.drawn_map import DrawnMap
from rosplat_tools.cameras.health import Health, NoPicture
from rosplat_tools.cameras.heard_lens import HeardLens, Optics
from rosplat_tools.cameras.pose_history import Pose, PoseError
from rosplat_tools.cameras.poses import declare_poses, nanoseconds
from rosplat_tools.latched import LatchedSubscription

WAITING = 8  # pictures that wait for their poses
CLIP = 0.01, 1e6  # depths between which splats are drawn, by default [m]
SILENCE = 5.0  # after which the log says that no picture has come [s]
PATIENCE = 1.0  # how long pictures wait for poses before a warning [s]


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
    clip: tuple[float, float]
    """Depths between which splats are drawn. [m]"""

    @property
    def world_to_lens(self) -> NDArray[np.float64]:
        """(4, 4) [m]"""
        return np.asarray(self.rotation @ np.linalg.inv(self.pose), np.float64)

    def camera(self, pinhole: Camera) -> Camera:
        """A pinhole camera at the lens's place."""
        near, far = self.clip
        return replace(pinhole, world_to_camera=self.world_to_lens, near=near, far=far)

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
        clip: tuple[float, float] = CLIP,
    ) -> None:
        """prepare: called once with each lens; may raise LensError. rectified: whether pictures are
        rectified, by r and p of their CameraInfo. mask (height, width): false where pixels don't
        count. clip: as of Taken.
        """
        self._prepare, self._rectified, self.mask, self._clip = prepare, rectified, mask, clip
        self.lens = HeardLens(self._optics_of, "camera_info", "camera_info")

    def _optics_of(self, info: CameraInfo) -> tuple[Optics, Pose]:
        turned = np.eye(4)
        if self._rectified:
            lens, turned[:3, :3] = calibrations.rectified(info)
        else:
            lens = calibrations.lens_of(info)
        return self._prepare(lens), turned

    def read(self, image: Image, pose: Pose) -> Taken[Optics]:
        """A picture, from where it was taken. Raises NoPicture."""
        info, (optics, rotation) = self.lens.made()
        if (image.width, image.height) != (info.width, info.height):
            raise NoPicture(
                "of another size",
                f"a picture is {image.width} x {image.height}, camera_info says "
                f"{info.width} x {info.height}",
            )
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
        return Taken(image.header, colours, counts, optics, rotation, pose, self._clip)


class TakenPictures(Generic[Optics]):
    """Pictures of one camera. Callbacks queue them; the drawing thread calls all else."""

    def __init__(self, node: Node, drawn_map: DrawnMap, prepare: Callable[[Lens], Optics]) -> None:
        """prepare: called once with each lens; may raise LensError.

        Declares poses, rectified, mask, near and far. Raises InputError.
        """
        rectified = declare(node, "rectified", False, "Pictures are rectified, by r and p.")
        mask = declare_path(node, "mask", "", "Picture file, black where pixels don't count.")
        clip = declare_clip(node)
        pixels = read_mask(mask) if mask else None
        self.reader = PictureReader(prepare, rectified=rectified, mask=pixels, clip=clip)
        self._map = drawn_map
        self._poses = declare_poses(node, [""], drawn_map.came.set)[""]
        self._images: deque[Image] = deque(maxlen=WAITING)
        self._began = self._poseless_since = time.monotonic()  # since when pictures wait for poses
        self.newest: Image | None = None
        """The last picture that came, whether or not it was used."""
        self.health = Health(node, node.resolve_topic_name("image_raw"))
        # Reliable until publishers are known: of best effort, a busy machine loses most pictures.
        LatchedSubscription(node, Image, "image_raw", self._on_image, PICTURES)
        LatchedSubscription(node, CameraInfo, "camera_info", self.reader.lens.hear, PICTURES)
        LatchedSubscription(node, Image, "mask", self._on_mask, PICTURES)

    # --- What ROS hands over ----------------------------------------------------------------------

    def _on_image(self, image: Image) -> None:
        self.newest = image
        self._images.append(image)
        self._map.came.set()

    def _on_mask(self, image: Image) -> None:
        try:
            self.reader.mask = np.asarray(from_image(image).any(axis=-1))
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
            return self.reader.read(image, pose)
        return None

    def _drop(self, count: int) -> None:
        for _ in range(min(count, len(self._images))):
            self._images.popleft()

    def _pose_of(self, image: Image) -> Pose:
        header = image.header
        when = nanoseconds(header.stamp)
        return self._poses.pose(header.frame_id, self._map.frame_id, when)[1]
