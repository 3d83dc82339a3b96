"""Converts poses between messages and matrices, and checks them."""

from __future__ import annotations

import numpy as np
from geometry_msgs.msg import Point, Pose, Quaternion
from numpy.typing import ArrayLike, NDArray

from rosplat_core.quaternions import from_matrices
from rosplat_core.rigid import rigid
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
    x, y, z, w = orientation.tolist()
    px, py, pz = position.tolist()
    return Pose(position=Point(x=px, y=py, z=pz), orientation=Quaternion(x=x, y=y, z=z, w=w))


def to_matrix(pose: Pose) -> NDArray[np.float64]:
    """The rigid transform (4, 4) of a pose."""
    return frame_at(*pose_values(pose))
