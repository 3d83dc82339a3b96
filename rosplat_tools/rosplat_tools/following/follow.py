"""Publishes maps that other programs write: a file, again and again, or their messages.

Parameter `path`: a scene file, or a pattern, whose newest match is read. A file that is still being
written is read when it is whole.
Topic `cloud`: sensor_msgs/PointCloud2 with a PLY's properties for fields. A message is a whole map.
Topic `splat_array`: gsplat_msgs/SplatArray, where that package is installed.
"""

from __future__ import annotations

from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import PointCloud2

from rosplat_core.log_text import shown
from rosplat_core.scenes import load_scene
from rosplat_core.splats import SceneError, Splats
from rosplat_ros.map_publisher import MapPublisher
from rosplat_ros.program.parameters import declare, declare_compression, declare_path
from rosplat_ros.program.running import Cancelled, run_node
from rosplat_tools.following.foreign_messages import from_point_cloud, from_splat_array
from rosplat_tools.following.watched_file import WatchedFile
from rosplat_tools.following.whole_maps import WholeMaps
from rosplat_tools.latched import LatchedSubscription

MAPS = QoSProfile(depth=1)  # of others' messages: only the newest counts


class Follow(Node):
    """Publishes on `gaussians` the map that it heard or read last."""

    def __init__(self) -> None:
        super().__init__("follow")
        path = declare_path(
            self, "path", "", "Scene file to follow, or a pattern: its newest match is read."
        )
        period = declare(self, "period", 0.5, "Time between two looks at the file. [s]", 0.05, 60.0)
        frame_id = declare(self, "frame_id", "", "Frame of the map; empty: the message's, or map.")
        self._frame_id = frame_id
        self._publisher = MapPublisher(
            self, frame_id=frame_id or "map", compression=declare_compression(self)
        )
        self._maps = WholeMaps(self._publisher)
        if path:
            self._file = WatchedFile(path)
            steady = Clock(clock_type=ClockType.STEADY_TIME)  # simulated time may stand still
            self.create_timer(period, self._look, clock=steady)
            doing = "following" if self._file.is_there() else "waiting for"
            self.get_logger().info(f"{doing} {shown(path)}")
        else:
            cloud = self.resolve_topic_name("cloud")
            self.get_logger().info(f"no path is given: waiting for {cloud}")
        LatchedSubscription(self, PointCloud2, "cloud", self._on_cloud, MAPS)
        try:
            from gsplat_msgs.msg import SplatArray
        except ImportError:
            pass
        else:
            LatchedSubscription(self, SplatArray, "splat_array", self._on_array, MAPS)

    def _look(self) -> None:
        version = self._file.poll()
        if version is None:
            return
        try:
            splats = load_scene(str(version.path), self._go_on, self.get_logger().warning)
        except SceneError as error:
            self._refuse(error)  # a file that is being written isn't whole
            return
        if self._file.is_still(version):
            self._show(splats, "", str(version.path))

    def _go_on(self, _: float) -> None:
        if not self.context.ok():
            raise Cancelled

    def _on_cloud(self, message: PointCloud2) -> None:
        self._take(message.header.frame_id, from_point_cloud, message, "cloud")

    def _on_array(self, message: Any) -> None:
        frame = message.splats[0].pose.header.frame_id if message.splats else ""
        self._take(frame, from_splat_array, message, "splat_array")

    def _take(self, frame_id: str, read: Any, message: Any, topic: str) -> None:
        try:
            name = self.resolve_topic_name(topic)
            self._show(read(message, name, self.get_logger().warning), frame_id, name)
        except SceneError as error:
            self._refuse(error)

    def _show(self, splats: Splats, frame_id: str, source: str) -> None:
        before = self._publisher.frame_id
        self._publisher.frame_id = self._frame_id or frame_id or "map"
        try:
            sent = self._maps.show(splats)
        except (ValueError, MemoryError) as error:
            self._publisher.frame_id = before
            self._refuse(f"{source}: {error or 'too large for this machine'}")
            return
        self.get_logger().info(f"{shown(source)}: {len(splats):,} splats, {sent:,} of them sent")

    def _refuse(self, why: object) -> None:
        self.get_logger().warning(
            f"the map stays: {shown(str(why), 500)}", throttle_duration_sec=1.0
        )


def main() -> None:
    """Runs the node until it is told to end."""
    run_node("follow", Follow)


if __name__ == "__main__":
    main()
