"""Publishes the parts of a large scene that viewers look at.

Chunks of a streamed SOG come and go at the level of detail that each view needs, within a budget.
"""

from __future__ import annotations

import contextlib
import threading
import time
from pathlib import Path

from rclpy.node import Node

from rosplat_core.formats.streamed_sog import open_streamed, read_coarsest
from rosplat_core.log_text import shown
from rosplat_core.posed_camera import CameraError, PosedCamera
from rosplat_core.splats import InputError
from rosplat_msgs.msg import GaussianArray, ViewCamera
from rosplat_ros.map_publisher import MapPublisher
from rosplat_ros.program.parameters import declare, declare_compression, declare_path
from rosplat_ros.program.running import run_node
from rosplat_ros.qos import VIEW, overridable
from rosplat_ros.view_cameras import decode
from rosplat_tools.first_views import FirstViews
from rosplat_tools.streaming.followed_view import FollowedView
from rosplat_tools.streaming.streamed_map import StreamedMap

FORGET_AFTER = 10.0  # views come once a second; one that doesn't is gone [s]
MAX_VIEWS = 32
TELL_EVERY = 2.0  # [s]


class StreamPublisher(Node):
    """Publishes its parameter `path` on `gaussians`, for the views heard on `gaussians/view`."""

    def __init__(self) -> None:
        super().__init__("stream_publisher")
        path = declare_path(self, "path", "", "Streamed SOG to publish: a lod-meta.json.")
        frame_id = declare(self, "frame_id", "map", "Frame that the scene's coordinates are in.")
        most = declare(
            self, "max_splats", 2_000_000, "The most splats that the map holds.",
            1, GaussianArray.MAX_SLOTS,
        )  # fmt: skip
        target = declare(
            self, "error", 1.0, "Chunks are refined while their splats are farther apart. [px]",
            1e-3, 1e3,
        )  # fmt: skip
        first_views = FirstViews(self, frame_id)
        compression = declare_compression(self)
        if not path:
            raise InputError("parameter path: expected a streamed SOG's lod-meta.json, got none")
        scene = open_streamed(Path(path))
        self._views: dict[str, FollowedView] = {}
        self._view_came = threading.Event()
        try:
            coarsest = read_coarsest(scene, self.get_logger().warning)
            first_views.offer(first_views.find(path, coarsest))
        except InputError as error:  # of one chunk: the others are shown
            self.get_logger().warning(f"no first view is found: {error}")
        publisher = MapPublisher(self, frame_id=frame_id, compression=compression)
        self._map = StreamedMap(
            scene, publisher, budget=most, target=target, warn=self.get_logger().warning
        )
        if most < self._map.least:
            self.get_logger().warning(
                f"max_splats {most:,} is too few for all of {shown(path)}: its "
                f"{len(scene.chunks):,} chunks take {self._map.least:,} splats at their coarsest, "
                "so some are missing"
            )
        topic = self.resolve_topic_name("gaussians")  # remapping it remaps the views
        self.create_subscription(ViewCamera, f"{topic}/view", self._on_view, **overridable(VIEW))

    def stream(self) -> None:
        """Follows the views until ROS ends. Call it from a thread that runs no callbacks."""
        resting = False
        with contextlib.closing(self._map):  # whose threads read
            while self.context.ok():
                self._view_came.clear()
                try:
                    changed = self._map.step(self._recent_views())
                except InputError as error:
                    self.get_logger().error(f"a chunk is left out: {error}")
                    continue
                if changed:
                    self.get_logger().info(str(self._map), throttle_duration_sec=TELL_EVERY)
                elif not resting:
                    self.get_logger().info(f"at rest: {self._map}")
                resting = not changed
                if resting:
                    self._view_came.wait(0.5)

    def _recent_views(self) -> list[PosedCamera]:
        """The cameras of views that are still there; if none is, of the last views."""
        views = dict(self._views)
        now = time.monotonic()
        there = {name: view for name, view in views.items() if view.heard > now - FORGET_AFTER}
        for name in (views.keys() - there.keys()) if there else ():
            self._views.pop(name, None)
        return [camera for view in (there or views).values() for camera in view.cameras(now)]

    def _on_view(self, message: ViewCamera) -> None:
        try:
            camera = decode(message)
        except CameraError as error:
            self.get_logger().warning(
                f"view {shown(message.view_id)} is left out: {error}", throttle_duration_sec=5.0
            )
            return
        now = time.monotonic()
        view = self._views.pop(message.view_id, None) or FollowedView(camera, now)
        view.move_to(camera, now)
        self._views[message.view_id] = view
        while len(self._views) > MAX_VIEWS:
            self._views.pop(next(iter(self._views)), None)
        self._view_came.set()


def main() -> None:
    run_node("stream_publisher", StreamPublisher, StreamPublisher.stream)
