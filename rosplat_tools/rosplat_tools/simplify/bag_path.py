"""The path of a camera in a bag: poses of a topic. Needs ROS 2."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseArray, PoseStamped
from nav_msgs.msg import Odometry
from numpy.typing import NDArray

from rosplat_core.splats import InputError
from rosplat_ros.poses import to_matrix, to_pose
from rosplat_tools import bags

KINDS: dict[str, type] = {
    "geometry_msgs/msg/PoseArray": PoseArray,
    "geometry_msgs/msg/PoseStamped": PoseStamped,
    "nav_msgs/msg/Odometry": Odometry,
}


def poses(bag: str, topic: str) -> list[NDArray[np.float64]]:
    """Poses (4, 4) of a topic. An empty topic stands for the only one that has poses.

    Raises InputError, naming bag and topic.
    """
    known = {name: KINDS[kind] for name, kind in bags.topics(bag).items() if kind in KINDS}
    if not topic and len(known) == 1:
        topic = next(iter(known))
    if topic not in known:
        listed = ", ".join(sorted(known)) or "none"
        raise InputError(f"{bag}: give a topic of poses, as {bag}:TOPIC; it has {listed}")
    try:
        found = [
            to_matrix(to_pose(pose))
            for _, message in bags.messages(bag, {topic: known[topic]})
            for pose in _poses_of(message)
        ]
    except ValueError as error:
        raise InputError(f"{bag}: {topic}: {error}") from error
    if not found:
        raise InputError(f"{bag}: {topic} holds no poses")
    return found


def _poses_of(message: Any) -> Iterator[Any]:
    if isinstance(message, PoseArray):
        yield from message.poses
    else:
        yield message.pose.pose if isinstance(message, Odometry) else message.pose
