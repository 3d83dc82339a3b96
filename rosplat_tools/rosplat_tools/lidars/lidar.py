"""Measures a map with a lidar where TF, or a topic of poses, has one.

Hears `gaussians`. Publishes `points` (PointCloud2 with intensity, ring and time) and `scan`
(LaserScan), while somebody hears them, at the time of the pose.
"""

from __future__ import annotations

import numpy as np
from rclpy.node import Node
from rclpy.time import Time
from std_msgs.msg import Header

from rosplat_ros.program.parameters import declare
from rosplat_ros.program.running import run_node
from rosplat_tools.cameras.drawn_map import DrawnMap
from rosplat_tools.cameras.health import drawn
from rosplat_tools.cameras.pose_history import Pose
from rosplat_tools.cameras.posed_sensor import PosedSensor
from rosplat_tools.cameras.poses import declare_poses
from rosplat_tools.lidars.lidar_messages import ScanTopics, declare_lidar

NAME = "lidar"  # of its pose's topic


class LidarNode(Node):
    """One lidar. Callbacks only hand data over; measure() measures."""

    def __init__(self) -> None:
        super().__init__("lidar")
        self._lidar, rate = declare_lidar(self)
        self._frame_id: str = declare(self, "frame_id", "lidar", "Its frame: x forward, z up.")
        self._map = DrawnMap(self)
        poses = declare_poses(self, [NAME], self._map.came.set)[NAME]
        self._sensor = PosedSensor(
            self, NAME, self._frame_id, poses, self._map, rate, self._measure
        )
        self._topics = ScanTopics(self, self._lidar, rate)

    def measure(self) -> None:
        """Measures until ROS ends."""
        for _ in self._map.turns():
            self._sensor.turn()

    def _measure(self, stamp: int, pose: Pose) -> bool:
        if not self._topics.heard():
            return False
        with drawn("not measured"):
            scan = self._lidar.scan(self._map.renderer, np.linalg.inv(pose).astype(np.float64))
        header = Header(stamp=Time(nanoseconds=stamp).to_msg(), frame_id=self._frame_id)
        self._topics.publish(header, scan)
        return True


def main() -> None:
    run_node("lidar", LidarNode, LidarNode.measure)
