"""Holds a map against what a camera sees, picture by picture.

Hears `gaussians`, `image_raw`, `camera_info` and `mask`, and by TF or on `pose` where the camera
was. Publishes `rendered`, the map drawn for the picture; `difference`, a heat map of the errors;
`metrics`; with `attribute`, `residuals`: the map with a channel that says where it is wrong.
"""

from __future__ import annotations

import threading
import time
from collections import deque

import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.qos import QoSProfile, qos_profile_sensor_data
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header

from rosplat_core.lens_pictures import take_picture
from rosplat_core.lenses import LensError, Warp
from rosplat_core.log_text import shown
from rosplat_core.splats import SceneError
from rosplat_msgs.msg import Comparison
from rosplat_sorter.diagnostics import Diagnostics
from rosplat_sorter.qos import overridable
from rosplat_tools.cameras import calibrations, comparison
from rosplat_tools.cameras.drawn_map import DrawnMap
from rosplat_tools.cameras.health import Health, NoPicture
from rosplat_tools.cameras.pose_history import SECOND, Pose, PoseError
from rosplat_tools.cameras.poses import declare_poses
from rosplat_tools.cameras.residual_map import ResidualMap
from rosplat_tools.images import from_image, read_mask, to_bytes, to_image
from rosplat_tools.program.parameters import declare
from rosplat_tools.program.running import run, spinning

PICTURES = QoSProfile(depth=5)
POLL = 0.005  # how often TF is asked [s]
WAITING = 8  # pictures that wait for their poses
PATIENCE = 1.0  # with a picture's pose [s]


class Compare(Node):
    """Callbacks hand over; compare() draws. Of pictures that came meanwhile, the newest counts."""

    def __init__(self) -> None:
        """Raises SceneError for a parameter that makes no sense."""
        super().__init__("compare")
        self._rectified = declare(self, "rectified", False, "Pictures are rectified, by r and p.")
        mask = declare(self, "mask", "", "Picture file, black where pixels don't count.")
        attribute = declare(self, "attribute", False, "Publish the map with a channel residual.")
        self._near = declare(self, "near", 0.01, "Splats nearer are left out. [m]", 1e-4, 1e6)
        self._far = declare(self, "far", 1e6, "Splats farther are left out. [m]", 1e-3, 1e10)
        if not self._near < self._far:
            raise SceneError(f"parameters near, far: {self._near} is not less than {self._far}")
        self._mask = read_mask(mask) if mask else None
        self._came = threading.Event()
        self._poses = declare_poses(self, [""], self._came.set)
        self._map = DrawnMap(self, self._came.set)
        self._residuals = ResidualMap(self, self._map) if attribute else None
        self._images: deque[tuple[float, Image]] = deque(maxlen=WAITING)
        self._info: CameraInfo | None = None
        self._lens: tuple[CameraInfo, Warp, NDArray[np.float64]] | None = None
        self._rendered = self.create_publisher(Image, "rendered", **overridable(PICTURES))
        self._difference = self.create_publisher(Image, "difference", **overridable(PICTURES))
        self._metrics = self.create_publisher(Comparison, "metrics", **overridable(PICTURES))
        for kind, topic, heard in (
            (Image, "image_raw", self._on_image),
            (CameraInfo, "camera_info", self._on_info),
            (Image, "mask", self._on_mask),
        ):
            self.create_subscription(kind, topic, heard, **overridable(qos_profile_sensor_data))
        self._health = Health(self.resolve_topic_name("image_raw"), self.get_logger().warning)
        Diagnostics(self, self._health.name, self._health.report)

    def compare(self) -> None:
        """Compares pictures until ROS ends."""
        while self.context.ok():
            self._came.wait(POLL)
            self._came.clear()
            self._map.take()
            try:
                self._compare_newest()
            except NoPicture as none:
                self._health.trouble(none.kind, none)
            if self._residuals:
                self._residuals.publish()

    # --- What ROS hands over ----------------------------------------------------------------------

    def _on_image(self, image: Image) -> None:
        self._images.append((time.monotonic(), image))
        self._came.set()

    def _on_info(self, info: CameraInfo) -> None:
        info.header = Header()  # whatever its time, it is the same calibration
        if info != self._info:
            self._info = info

    def _on_mask(self, image: Image) -> None:
        try:
            self._mask = np.asarray(from_image(image).any(axis=-1))
        except ValueError as error:
            self._health.trouble("masks", f"a mask is left out: {error}")

    # --- Of the drawing thread --------------------------------------------------------------------

    def _compare_newest(self) -> None:
        """Of the pictures whose poses are known, the newest; older ones are done with."""
        images = list(self._images)
        if images and (problem := self._map.problem()):
            self._forget(len(images))
            raise NoPicture("without a map", problem)
        for number, (arrived, image) in reversed(list(enumerate(images))):
            try:
                pose = self._pose_of(image)
            except PoseError as error:
                if number == 0 and time.monotonic() - arrived > PATIENCE:
                    self._forget(1)
                    raise NoPicture("without a pose", error) from error
                continue
            self._forget(number + 1)
            self._health.counts["skipped"] += number
            self._compare(image, pose)
            return

    def _forget(self, count: int) -> None:
        for _ in range(min(count, len(self._images))):
            self._images.popleft()

    def _pose_of(self, image: Image) -> Pose:
        stamp = image.header.stamp
        when = stamp.sec * SECOND + stamp.nanosec
        return self._poses.at("", image.header.frame_id, self._map.frame_id, when)

    def _compare(self, image: Image, pose: Pose) -> None:
        began = time.perf_counter()
        warp, rotation = self._warp_of(image)
        try:
            real = from_image(image)
        except ValueError as error:
            raise NoPicture("not read", error) from error
        mask = self._mask_of(warp)
        turned = np.eye(4)
        turned[:3, :3] = rotation
        world_to_lens = turned @ np.linalg.inv(pose)
        depths = {"near": self._near, "far": self._far}
        try:
            colour = take_picture(self._map.renderer, warp, world_to_lens, **depths).colour
        except (RuntimeError, MemoryError) as error:
            reason = shown(error, 300) or "out of memory"
            raise NoPicture("not drawn", reason) from error
        rendered = to_bytes(colour)  # as a camera has it
        message, errors = _measured(rendered, real, mask)
        books = self._map.books
        message.header, message.map_id, message.revision = (
            image.header,
            books.map_id,
            books.revision,
        )
        self._metrics.publish(message)
        for publisher, pixels in (
            (self._rendered, rendered),
            (self._difference, comparison.heat(errors, mask)),
        ):
            picture = to_image(pixels, "rgb8")
            picture.header = image.header
            publisher.publish(picture)
        if self._residuals:
            self._residuals.add(warp, world_to_lens, **depths, errors=errors, mask=mask)
        stamp = image.header.stamp
        now = self.get_clock().now().nanoseconds
        latency = (now - stamp.sec * SECOND - stamp.nanosec) / SECOND
        self._health.well(latency, time.perf_counter() - began)

    def _warp_of(self, image: Image) -> tuple[Warp, NDArray[np.float64]]:
        info = self._info
        if info is None:
            raise NoPicture("without a lens", "no CameraInfo has come on camera_info")
        if (image.width, image.height) != (info.width, info.height):
            raise NoPicture(
                "of another size",
                f"a picture is {image.width} x {image.height}, camera_info says "
                f"{info.width} x {info.height}",
            )
        if not self._lens or self._lens[0] is not info:
            try:
                if self._rectified:
                    lens, rotation = calibrations.rectified(info)
                else:
                    lens, rotation = calibrations.lens_of(info), np.eye(3)
                self._lens = info, Warp(lens), rotation
            except LensError as error:
                raise NoPicture("without a lens", f"camera_info is refused: {error}") from error
        return self._lens[1:]

    def _mask_of(self, warp: Warp) -> NDArray[np.bool_]:
        mask = self._mask
        if mask is None:
            return warp.met
        if mask.shape != warp.met.shape:
            raise NoPicture("of another size", "the mask has another size than pictures")
        if not (mask & warp.met).any():
            raise NoPicture("masked", "the mask leaves no pixel")
        return mask & warp.met


def _measured(
    rendered: NDArray[np.uint8], real: NDArray[np.uint8], mask: NDArray[np.bool_]
) -> tuple[Comparison, NDArray[np.float32]]:
    """The figures of two pictures, and the errors of pixels, (height, width)."""
    ours, theirs = (picture.astype(np.float32) / np.float32(255) for picture in (rendered, real))
    exposure = comparison.fit_exposure(ours, theirs, mask)
    plain = comparison.figures(ours, theirs, mask)
    fitted = comparison.figures(exposure.apply(ours), theirs, mask)
    message = Comparison(
        pixels=int(mask.sum()),
        psnr=plain.psnr,
        ssim=plain.ssim,
        explained=plain.explained,
        gain=exposure.gain,
        bias=exposure.bias,
        fitted_psnr=fitted.psnr,
        fitted_ssim=fitted.ssim,
        fitted_explained=fitted.explained,
    )
    return message, comparison.errors(ours, theirs)


def main() -> None:
    """Runs the node until it is told to end; exit code 1 where a parameter makes no sense."""
    run("compare", _compare)


def _compare() -> None:
    node = Compare()
    with spinning(node):
        node.compare()


if __name__ == "__main__":
    main()
