"""Measures a map with a lidar where TF, or a topic of poses, has one.

Hears `gaussians`. Publishes `points` (PointCloud2 with intensity, ring and time) and `scan`
(LaserScan), while somebody hears them, at the time of the pose.
"""

from __future__ import annotations

import time

import numpy as np
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.time import Time
from sensor_msgs.msg import LaserScan, PointCloud2
from std_msgs.msg import Header

from rosplat_ros.diagnostics import Diagnostics
from rosplat_ros.program.parameters import declare
from rosplat_ros.program.running import run_node
from rosplat_ros.qos import overridable
from rosplat_tools.cameras.drawn_map import DrawnMap
from rosplat_tools.cameras.health import Health, NoPicture, drawn
from rosplat_tools.cameras.pose_history import SECOND, PoseError
from rosplat_tools.cameras.poses import declare_poses
from rosplat_tools.frames import LATEST
from rosplat_tools.lidars.lidar_messages import declare_lidar, points_message, scan_message
from rosplat_tools.lidars.scanning import Scan

SCANS = QoSProfile(depth=5)  # reliable, which serves best-effort subscribers, too
NAME = "lidar"  # of its pose's topic


class LidarNode(Node):
    """One lidar. Callbacks only hand data over; measure() measures."""

    def __init__(self) -> None:
        super().__init__("lidar")
        self._lidar, rate = declare_lidar(self)
        self._frame_id: str = declare(self, "frame_id", "lidar", "Its frame: x forward, z up.")
        self._period = round(SECOND / rate)
        self._map = DrawnMap(self)
        self._poses = declare_poses(self, [NAME], self._map.came.set)
        self._points = self.create_publisher(PointCloud2, "points", **overridable(SCANS))
        self._scan = self.create_publisher(LaserScan, "scan", **overridable(SCANS))
        self._last = 0  # of the last scan [ns]
        self._rests_until = 0.0  # after trouble [s]
        self._health = Health(NAME, self.get_logger().warning)
        Diagnostics(self, NAME, self._health.report)

    def measure(self) -> None:
        """Measures until ROS ends."""
        for _ in self._map.turns():
            if time.monotonic() < self._rests_until:
                continue
            try:
                self._measure()
            except NoPicture as none:
                self._health.trouble(none.kind, none)
                self._rests_until = time.monotonic() + self._period / SECOND

    def _measure(self) -> None:
        began = time.perf_counter()
        if problem := self._map.problem():
            raise NoPicture("without a map", problem)
        try:
            stamp, pose = self._poses.newest(NAME, self._frame_id, self._map.frame_id)
        except PoseError as error:
            raise NoPicture("without a pose", error) from error
        now = self.get_clock().now().nanoseconds
        stamp = now if stamp == LATEST else stamp
        if stamp < self._last - SECOND:  # a run has begun again
            self._last = 0
        if stamp < self._last + self._period * 3 // 4:  # of jitter
            return
        self._last = stamp
        listened = [p.get_subscription_count() > 0 for p in (self._points, self._scan)]
        if not any(listened):
            return
        with drawn("not measured"):
            scan = self._lidar.scan(self._map.renderer, np.linalg.inv(pose).astype(np.float64))
        self._publish(scan, Header(stamp=Time(nanoseconds=stamp).to_msg(), frame_id=self._frame_id))
        latency = (self.get_clock().now().nanoseconds - stamp) / SECOND
        self._health.well(latency, time.perf_counter() - began)

    def _publish(self, scan: Scan, header: Header) -> None:
        pattern, period = self._lidar.pattern, self._period / SECOND
        self._points.publish(points_message(header, pattern, scan, period))
        self._scan.publish(scan_message(header, pattern, scan, self._lidar.limits, period))


def main() -> None:
    run_node("lidar", LidarNode, LidarNode.measure)
