"""Holds a map against what a camera sees, picture by picture.

Hears `gaussians`, `image_raw`, `camera_info` and `mask`, and by TF or on `pose` where the camera
was. Publishes `rendered`, the map drawn for the picture; `difference`, a heat map of the errors;
`metrics`; with `attribute`, `residuals`: the map with a channel that says where it is wrong.
`--bag BAG` compares all pictures of a bag instead, and prints a table.
"""

from __future__ import annotations

import sys
import threading
import time
from collections import deque

import numpy as np
from rclpy.node import Node
from rclpy.qos import QoSProfile, qos_profile_sensor_data
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header

from rosplat_core.splats import SceneError
from rosplat_msgs.msg import Comparison
from rosplat_sorter.diagnostics import Diagnostics
from rosplat_sorter.qos import overridable
from rosplat_tools.cameras import compare_bag, comparison
from rosplat_tools.cameras.comparer import Comparer
from rosplat_tools.cameras.drawn_map import DrawnMap
from rosplat_tools.cameras.health import Health, NoPicture
from rosplat_tools.cameras.pose_history import SECOND, Pose, PoseError
from rosplat_tools.cameras.poses import declare_poses
from rosplat_tools.cameras.residual_map import ResidualMap
from rosplat_tools.images import from_image, read_mask, to_image
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
        rectified = declare(self, "rectified", False, "Pictures are rectified, by r and p.")
        mask = declare(self, "mask", "", "Picture file, black where pixels don't count.")
        attribute = declare(self, "attribute", False, "Publish the map with a channel residual.")
        near = declare(self, "near", 0.01, "Splats nearer are left out. [m]", 1e-4, 1e6)
        far = declare(self, "far", 1e6, "Splats farther are left out. [m]", 1e-3, 1e10)
        if not near < far:
            raise SceneError(f"parameters near, far: {near} is not less than {far}")
        pixels = read_mask(mask) if mask else None
        self._came = threading.Event()
        self._poses = declare_poses(self, [""], self._came.set)
        self._map = DrawnMap(self, self._came.set)
        self._comparer = Comparer(
            self._map.renderer, rectified=rectified, mask=pixels, near=near, far=far
        )
        self._residuals = ResidualMap(self, self._map) if attribute else None
        self._images: deque[tuple[float, Image]] = deque(maxlen=WAITING)
        self._info: CameraInfo | None = None
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
            self._comparer.mask = np.asarray(from_image(image).any(axis=-1))
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
        found = self._comparer.compare(image, self._info, pose)
        self._metrics.publish(found.figures)
        for publisher, pixels in (
            (self._rendered, found.rendered),
            (self._difference, comparison.heat(found.errors, found.mask)),
        ):
            picture = to_image(pixels, "rgb8")
            picture.header = image.header
            publisher.publish(picture)
        if self._residuals:
            self._residuals.add(found, self._comparer.near, self._comparer.far)
        stamp = image.header.stamp
        now = self.get_clock().now().nanoseconds
        latency = (now - stamp.sec * SECOND - stamp.nanosec) / SECOND
        self._health.well(latency, time.perf_counter() - began)


def main() -> None:
    """Runs the node until it is told to end; exit code 1 where a parameter makes no sense.

    With --bag, it is the program that compares all of a bag.
    """
    if any(word.startswith("--bag") for word in sys.argv[1:]):
        sys.exit(compare_bag.main())
    run("compare", _compare)


def _compare() -> None:
    node = Compare()
    with spinning(node):
        node.compare()


if __name__ == "__main__":
    main()
