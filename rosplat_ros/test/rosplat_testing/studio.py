"""For tests of cameras in the map: poses, calibrations and pictures, and what programs say."""

from __future__ import annotations

import subprocess
import threading
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped, TransformStamped
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, Image

from rosplat_ros.poses import to_pose
from rosplat_testing import Listener


class Studio:
    """Poses and calibrations for a camera's program, and what it publishes."""

    def __init__(self, node: Node, listener: Listener, name: str = "camera") -> None:
        self.node, self.listener, self.name = node, listener, name
        self.heard: dict[str, list[Any]] = {}
        self._poses = node.create_publisher(PoseStamped, _in(name, "pose"), 10)
        self._infos = node.create_publisher(CameraInfo, _in(name, "calibration"), 10)

    def hear(self, topic: str, kind: Any = Image) -> None:
        messages: list[Any] = self.heard.setdefault(topic, [])
        self.node.create_subscription(kind, _in(self.name, topic), messages.append, 10)

    def pose(
        self, world_to_camera: np.ndarray, seconds: int = 0, frame: str = "map", nanosec: int = 0
    ) -> None:
        """seconds and nanosec: 0, the pose holds."""
        message = PoseStamped(pose=to_pose(np.linalg.inv(world_to_camera)))
        message.header.frame_id, message.header.stamp.sec = frame, seconds
        message.header.stamp.nanosec = nanosec
        self.listener.wait(lambda: self._poses.get_subscription_count())
        self._poses.publish(message)

    def calibrate(self, info: CameraInfo) -> None:
        self.listener.wait(lambda: self._infos.get_subscription_count())
        self._infos.publish(info)

    def next(self, topic: str = "image_raw") -> Any:
        """A message that comes from now on."""
        count = len(self.heard[topic])
        self.listener.wait(lambda: len(self.heard[topic]) > count)
        return self.heard[topic][count]


def _in(name: str, topic: str) -> str:
    return f"{name}/{topic}" if name else topic


class Log:
    """What a program says."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        assert process.stdout
        self.lines: list[str] = []
        threading.Thread(target=self.lines.extend, args=(process.stdout,), daemon=True).start()

    def has(self, text: str) -> bool:
        return any(text in line for line in self.lines)

    @property
    def warnings(self) -> list[str]:
        return [line for line in self.lines if "[INFO]" not in line]


def transform(parent: str, child: str, pose: np.ndarray, seconds: int = 0) -> TransformStamped:
    """Where a child's frame is in its parent's."""
    made = TransformStamped(child_frame_id=child)
    made.header.frame_id, made.header.stamp.sec = parent, seconds
    place = to_pose(pose)
    made.transform.rotation = place.orientation
    for axis in "xyz":
        setattr(made.transform.translation, axis, getattr(place.position, axis))
    return made
