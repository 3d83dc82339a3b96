"""Where cameras are: by TF, or by topics of poses."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Protocol

from geometry_msgs.msg import Pose as PoseMessage
from geometry_msgs.msg import PoseStamped, TransformStamped
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.time import Time

from rosplat_core.log_text import shown
from rosplat_core.splats import SceneError
from rosplat_sorter.qos import overridable
from rosplat_tools.cameras.pose_history import SECOND, Pose, PoseError, PoseHistory
from rosplat_tools.poses import to_matrix, to_pose
from rosplat_tools.program.parameters import declare

# The wheels of PyPI don't have it.
try:
    import tf2_ros
except ImportError:
    tf2_ros = None

KEEPS = 10.0  # [s]
POSES = QoSProfile(depth=10)
NEVER = 0  # the time of what never moves [ns]


class Poses(Protocol):
    """Where cameras' optical frames are in the map's frame. PoseErrors say why that isn't known."""

    def newest(self, camera: str, frame: str, map_frame: str) -> tuple[int, Pose]:
        """The last pose and its time [ns], NEVER of one that holds."""

    def at(self, camera: str, frame: str, map_frame: str, stamp: int) -> Pose:
        """The pose at a time. [ns]"""


def declare_poses(node: Node, cameras: list[str], heard: Callable[[], None]) -> Poses:
    """Declares `poses`. heard: called for each pose that comes by a topic.

    Raises SceneError for a source that isn't known, or not here.
    """
    source = declare(
        node, "poses", "tf", "Where cameras are by: tf, or topic, a PoseStamped on NAME/pose."
    )
    if source == "topic":
        return TopicPoses(node, cameras, heard)
    if source != "tf":
        raise SceneError(f"parameter poses: expected tf or topic, got '{shown(source)}'")
    if tf2_ros is None:
        raise SceneError("parameter poses: tf2_ros is not installed; poses:=topic needs none")
    buffer = tf2_ros.Buffer(Duration(seconds=KEEPS))
    return TfPoses(buffer, tf2_ros.TransformListener(buffer, node))


class TopicPoses:
    """Poses as they come on `NAME/pose`, in the map's frame."""

    def __init__(self, node: Node, cameras: list[str], heard: Callable[[], None]) -> None:
        self._node, self._heard = node, heard
        self._lock = threading.Lock()
        self._histories = {camera: PoseHistory(KEEPS) for camera in cameras}
        self._frames = dict.fromkeys(cameras, "")
        for camera in cameras:
            topic = f"{camera}/pose" if camera else "pose"
            node.create_subscription(PoseStamped, topic, self._taker(camera), **overridable(POSES))

    def _taker(self, camera: str) -> Callable[[PoseStamped], None]:
        def take(message: PoseStamped) -> None:
            stamp = message.header.stamp.sec * SECOND + message.header.stamp.nanosec
            try:
                pose = matrix_of(message.pose)
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

        return take

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
        if frame not in ("", map_frame):
            raise PoseError(f"poses are in '{shown(frame)}', the map is in '{shown(map_frame)}'")


class TfPoses:
    """Poses of the cameras' frames by TF."""

    def __init__(self, buffer: tf2_ros.Buffer, listener: object = None) -> None:
        """listener: what fills the buffer; None: take() does."""
        self._buffer, self._listener = buffer, listener

    def take(self, transform: TransformStamped, static: bool) -> None:
        """A transform, of all times where it is static."""
        fill = self._buffer.set_transform_static if static else self._buffer.set_transform
        fill(transform, "")

    def newest(self, camera: str, frame: str, map_frame: str) -> tuple[int, Pose]:
        return self._look_up(frame, map_frame, Time())

    def at(self, camera: str, frame: str, map_frame: str, stamp: int) -> Pose:
        return self._look_up(frame, map_frame, Time(nanoseconds=stamp))[1]

    def _look_up(self, frame: str, map_frame: str, time: Time) -> tuple[int, Pose]:
        try:
            found = self._buffer.lookup_transform(map_frame, frame, time)
        except tf2_ros.TransformException as error:
            raise PoseError(shown(error, 300)) from error
        stamp, moved = found.header.stamp, found.transform
        pose = PoseMessage(orientation=moved.rotation)
        place = pose.position
        place.x, place.y, place.z = moved.translation.x, moved.translation.y, moved.translation.z
        try:
            return stamp.sec * SECOND + stamp.nanosec, matrix_of(pose)
        except ValueError as error:
            raise PoseError(f"{shown(frame)}: {error}") from error


def matrix_of(pose: PoseMessage) -> Pose:
    """The matrix (4, 4). Raises ValueError for a pose that is none."""
    return to_matrix(to_pose(pose))
