"""Poses of cameras: from TF, or from topics of poses."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any, Protocol

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
from rosplat_tools.frames import KEEPS, FrameError, Frames, on_restart

POSES = QoSProfile(depth=10)


def nanoseconds(stamp: Time) -> int:
    """A message's time. [ns]"""
    return int(stamp.sec * SECOND + stamp.nanosec)


class Poses(Protocol):
    """Poses of cameras' optical frames in the map's. PoseErrors say why one isn't known."""

    def newest(self, camera: str, frame: str, map_frame: str) -> tuple[int, Pose]:
        """Time [ns] and value of the last pose; the time is LATEST if the pose never changes."""

    def at(self, camera: str, frame: str, map_frame: str, stamp: int) -> Pose:
        """The pose at a time. [ns]"""


def declare_poses(node: Node, cameras: list[str], heard: Callable[[], None]) -> Poses:
    """Declares `poses`. heard: called for each pose that comes by a topic.

    Raises InputError for a source that is unknown, or not installed.
    """
    about = "Source of cameras' poses; topic: PoseStampeds on NAME/pose"
    if declare(node, "poses", "tf", about, choices=("tf", "topic")) == "topic":
        return TopicPoses(node, cameras, heard)
    try:
        return TfPoses(Frames(node))
    except InputError as error:
        raise InputError(f"parameter poses: {error}: install it, or set poses:=topic") from error


class TopicPoses:
    """Poses as they come on `NAME/pose`, in the map's frame."""

    def __init__(self, node: Node, cameras: list[str], heard: Callable[[], None]) -> None:
        self._node, self._heard = node, heard
        self._lock = threading.Lock()
        self._histories = {camera: PoseHistory(KEEPS) for camera in cameras}
        self._frames = dict.fromkeys(cameras, "")
        self._jumps = on_restart(node, self._forget)
        for camera in cameras:
            topic = f"{camera}/pose" if camera else "pose"
            node.create_subscription(
                PoseStamped, topic, self._callback_of(camera), **overridable(POSES)
            )

    def _forget(self) -> None:
        with self._lock:
            for history in self._histories.values():
                history.clear()

    def _callback_of(self, camera: str) -> Callable[[PoseStamped], None]:
        def on_pose(message: PoseStamped) -> None:
            stamp = nanoseconds(message.header.stamp)
            try:
                pose = to_matrix(to_pose(message.pose))
            except ValueError as error:
                self._node.get_logger().warning(
                    f"{camera or 'the camera'}: a pose is left out: {error}",
                    throttle_duration_sec=5.0,
                )
                return
            with self._lock:
                self._frames[camera] = message.header.frame_id
                self._histories[camera].add(stamp, pose)
            self._heard()

        return on_pose

    def newest(self, camera: str, frame: str, map_frame: str) -> tuple[int, Pose]:
        with self._lock:
            found = self._histories[camera].newest()
            self._check_frame(camera, map_frame)
            return found

    def at(self, camera: str, frame: str, map_frame: str, stamp: int) -> Pose:
        with self._lock:
            found = self._histories[camera].at(stamp)
            self._check_frame(camera, map_frame)
            return found

    def _check_frame(self, camera: str, map_frame: str) -> None:
        frame = self._frames[camera]
        if not is_frame(frame, map_frame):
            raise PoseError(f"poses are in '{shown(frame)}', the map is in '{shown(map_frame)}'")


class TfPoses:
    """Poses of the cameras' frames by TF."""

    def __init__(self, frames: Frames) -> None:
        self._frames = frames

    def newest(self, camera: str, frame: str, map_frame: str) -> tuple[int, Pose]:
        return self._look_up(frame, map_frame)

    def at(self, camera: str, frame: str, map_frame: str, stamp: int) -> Pose:
        return self._look_up(frame, map_frame, stamp)[1]

    def _look_up(self, *asked: Any) -> tuple[int, Pose]:
        try:
            return self._frames.pose(*asked)
        except FrameError as error:
            raise PoseError(str(error)) from error
