"""Converts poses between messages and numbers, and checks them."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from geometry_msgs.msg import Point, Pose, Quaternion, Vector3
from numpy.typing import ArrayLike, NDArray

from rosplat_core.quaternions import from_matrices
from rosplat_core.rigid import rigid
from rosplat_core.splats import check_kind
from rosplat_core.view import frame_at
from rosplat_ros.batches import pose_values


def to_pose(pose: Pose | ArrayLike, name: str = "pose") -> Pose:
    """A Pose with a unit quaternion, of a Pose or a rigid transform (4, 4), as `rigid` takes it.

    Raises ValueError, whose text begins with name, for anything else.
    """
    if isinstance(pose, Pose):
        position, orientation = (np.array(values) for values in pose_values(pose))
        if not np.isfinite([*position, *orientation]).all() or not orientation.any():
            raise ValueError(f"{name}: not finite, or a quaternion of length zero")
        orientation /= np.abs(orientation).max()  # or squares overflow, or vanish
        orientation /= np.linalg.norm(orientation)
    else:
        matrix = rigid(pose, name)
        position, orientation = matrix[:3, 3], from_matrices(matrix[:3, :3])
    return pose_of(position, orientation)


def pose_of(position: Iterable[float], orientation: Iterable[float]) -> Pose:
    """The message of x, y, z and of a quaternion x, y, z, w."""
    return Pose(position=to_point(position), orientation=to_quaternion(orientation))


def to_point(values: Iterable[float]) -> Point:
    """The message of x, y, z."""
    x, y, z = map(float, values)
    return Point(x=x, y=y, z=z)


def to_vector(values: Iterable[float]) -> Vector3:
    """The message of x, y, z."""
    x, y, z = map(float, values)
    return Vector3(x=x, y=y, z=z)


def to_quaternion(values: Iterable[float]) -> Quaternion:
    """The message of x, y, z, w."""
    x, y, z, w = map(float, values)
    return Quaternion(x=x, y=y, z=z, w=w)


def to_matrix(pose: Pose) -> NDArray[np.float64]:
    """The rigid transform (4, 4) of a pose."""
    check_kind(pose, Pose, "pose")
    return frame_at(*pose_values(pose))
