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


def poses(bag: str, topic: str) -> list[NDArray[np.float64]]:
    """Poses (4, 4) of a topic. An empty topic stands for the only one that has poses.

    Raises InputError, naming bag and topic.
    """
    how = f"it as {bag}:TOPIC"
    topic, kind = bags.topic(bag, topic, how, PoseArray, PoseStamped, Odometry)
    try:
        found = [
            to_matrix(to_pose(pose))
            for _, message in bags.messages(bag, {topic: kind})
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
