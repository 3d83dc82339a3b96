"""Poses of frames, from TF and for it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from geometry_msgs.msg import Point, Pose, Transform, TransformStamped, Vector3
from numpy.typing import NDArray
from rclpy.clock import JumpHandle, JumpThreshold
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.time import Time
from std_msgs.msg import Header

from rosplat_core.log_text import shown
from rosplat_core.splats import InputError
from rosplat_ros.messages import plain_frame
from rosplat_ros.poses import to_matrix, to_pose
from rosplat_ros.qos import LATCHED, overridable
from rosplat_tools.cameras.pose_history import PoseError

# Some wheels of PyPI lack these.
try:
    import tf2_ros
except ImportError:
    tf2_ros = None
try:
    from tf2_msgs.msg import TFMessage
except ImportError:
    TFMessage = None

TF = QoSProfile(depth=100)  # of publishers, as tf2_ros has it

LATEST = 0  # asks for the last pose; also the time of a pose that never changes [ns]
KEEPS = 10.0  # how far back poses are kept [s]
AHEAD = 60.0  # a stamp so far ahead of the clock is a mistake [s]


def transform(header: Header, child: str, pose: Pose) -> TransformStamped:
    """Where a child's frame is in the header's frame."""
    place = pose.position
    return TransformStamped(
        header=header,
        child_frame_id=child,
        transform=Transform(
            translation=Vector3(x=place.x, y=place.y, z=place.z), rotation=pose.orientation
        ),
    )


def tf_publishers(node: Node) -> tuple[Publisher | None, Publisher | None]:
    """Of /tf and /tf_static; None, with a line in the log, where there is no tf2_msgs."""
    if not TFMessage:
        node.get_logger().info("no tf2_msgs here: TF is left out")
        return None, None
    return (
        node.create_publisher(TFMessage, "/tf", **overridable(TF)),
        node.create_publisher(TFMessage, "/tf_static", **overridable(LATCHED)),
    )


def on_restart(node: Node, forget: Callable[[], None]) -> JumpHandle:
    """Calls forget whenever a node's clock goes back or becomes another, while the result lives."""
    back = JumpThreshold(
        min_forward=None, min_backward=Duration(nanoseconds=-1), on_clock_change=True
    )
    return node.get_clock().create_jump_callback(back, post_callback=lambda _: forget())


class Frames:
    """Poses of frames, from a node's TF or from add()."""

    def __init__(self, node: Node | None = None, keeps: float = KEEPS) -> None:
        """keeps: how far back [s]. Raises InputError where there is no TF."""
        if tf2_ros is None:
            raise InputError("tf2_ros is not installed")
        self._buffer = tf2_ros.Buffer(Duration(seconds=keeps))
        self._node = node
        if node:
            self._listener = tf2_ros.TransformListener(self._buffer, node)
            # A buffer without a node doesn't see it, and refuses what is older than it keeps.
            self._jumps = on_restart(node, self._buffer.clear)

    def add(self, transform: TransformStamped, static: bool) -> None:
        """Adds a transform; a static one holds at all times."""
        fill = self._buffer.set_transform_static if static else self._buffer.set_transform
        fill(transform, "")

    def pose(self, frame: str, within: str, stamp: int = LATEST) -> tuple[int, NDArray[np.float64]]:
        """Time [ns] and pose (4, 4) [m] of a frame in another one. Raises PoseError.

        A transform of the far future would have TF take all others for outdated: such a one is
        named, and TF begins anew.
        """
        frame, within = plain_frame(frame), plain_frame(within)
        try:
            found = self._buffer.lookup_transform(within, frame, Time(nanoseconds=stamp))
        except tf2_ros.TransformException as error:
            self._check_time(self._latest(frame, within), frame, within)
            raise PoseError(shown(error, 300)) from error
        moved, when = found.transform, Time.from_msg(found.header.stamp)
        self._check_time(when.nanoseconds, frame, within)
        place = moved.translation
        try:
            pose = Pose(position=Point(x=place.x, y=place.y, z=place.z), orientation=moved.rotation)
            return when.nanoseconds, to_matrix(to_pose(pose))
        except ValueError as error:
            raise PoseError(f"'{shown(frame)}' in '{shown(within)}': {error}") from error

    def _latest(self, frame: str, within: str) -> int:
        try:
            latest: int = self._buffer.get_latest_common_time(within, frame).nanoseconds
        except tf2_ros.TransformException:
            return LATEST
        return latest

    def _check_time(self, when: int, frame: str, within: str) -> None:
        now = self._node.get_clock().now().nanoseconds if self._node else 0
        ahead = 1e-9 * (when - now)
        if now and ahead > AHEAD:
            self._buffer.clear()
            raise PoseError(
                f"'{shown(frame)}' in '{shown(within)}': TF has a stamp {ahead:,.0f} s ahead of "
                "the clock, which outdates all others; TF begins anew"
            )
