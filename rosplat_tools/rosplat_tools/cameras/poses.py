"""Poses of cameras: from TF, or from topics of poses."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable
from typing import Protocol

from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from rclpy.qos import QoSProfile

from rosplat_core.log_text import shown
from rosplat_core.splats import InputError
from rosplat_ros.messages import is_frame
from rosplat_ros.poses import to_matrix, to_pose
from rosplat_ros.program.parameters import declare
from rosplat_ros.qos import overridable
from rosplat_tools.cameras.pose_history import SECOND, Pose, PoseError, PoseHistory
from rosplat_tools.frames import KEEPS, LATEST, Frames, on_restart

POSES = QoSProfile(depth=10)


def nanoseconds(stamp: Time) -> int:
    """A message's time. [ns]"""
    return int(stamp.sec * SECOND + stamp.nanosec)


class Poses(Protocol):
    """Poses of frames: Frames, or TopicPoses."""

    def pose(self, frame: str, within: str, stamp: int = LATEST) -> tuple[int, Pose]:
        """Time [ns] and value of the last pose, or of the one at a time; the time is LATEST if the
        pose never changes. Raises PoseError where it isn't known.
        """


def declare_poses(
    node: Node, cameras: Iterable[str], heard: Callable[[], None]
) -> dict[str, Poses]:
    """Declares `poses`; returns those of each camera. heard: called for each that comes by a topic.

    Raises InputError for a source that is unknown, or not installed.
    """
    about = "Source of cameras' poses; topic: PoseStampeds on NAME/pose"
    if declare(node, "poses", "tf", about, choices=("tf", "topic")) == "topic":
        return {camera: TopicPoses(node, camera, heard) for camera in cameras}
    try:
        return dict.fromkeys(cameras, Frames(node))
    except InputError as error:
        raise InputError(f"parameter poses: {error}: install it, or set poses:=topic") from error


class TopicPoses:
    """Poses of a camera as they come on `NAME/pose`, in the map's frame."""

    def __init__(self, node: Node, camera: str, heard: Callable[[], None]) -> None:
        self._node, self._camera, self._heard = node, camera, heard
        self._lock = threading.Lock()
        self._history, self._frame = PoseHistory(KEEPS), ""
        self._jumps = on_restart(node, self._forget)
        topic = f"{camera}/pose" if camera else "pose"
        node.create_subscription(PoseStamped, topic, self._on_pose, **overridable(POSES))

    def _forget(self) -> None:
        with self._lock:
            self._history.clear()

    def _on_pose(self, message: PoseStamped) -> None:
        try:
            pose = to_matrix(to_pose(message.pose))
        except ValueError as error:
            self._node.get_logger().warning(
                f"{self._camera or 'the camera'}: a pose is left out: {error}",
                throttle_duration_sec=5.0,
            )
            return
        with self._lock:
            self._frame = message.header.frame_id
            self._history.add(nanoseconds(message.header.stamp), pose)
        self._heard()

    def pose(self, frame: str, within: str, stamp: int = LATEST) -> tuple[int, Pose]:
        with self._lock:
            at_stamp = (stamp, self._history.at(stamp)) if stamp else self._history.newest()
            if not is_frame(self._frame, within):
                raise PoseError(
                    f"poses are in '{shown(self._frame)}', the map is in '{shown(within)}'"
                )
            return at_stamp
