"""Converts poses between messages and matrices, and checks them."""

from __future__ import annotations

import numpy as np
from geometry_msgs.msg import Point, Pose, Quaternion
from numpy.typing import ArrayLike, NDArray

from rosplat_core.quaternions import from_matrices
from rosplat_core.view import frame_at
from rosplat_ros.batches import pose_values

# How far a matrix may be from a rotation, as SLAM back ends keep it in float32.
TOLERANCE = 1e-4


def to_pose(pose: Pose | ArrayLike, name: str = "pose") -> Pose:
    """A Pose with a unit quaternion, of a Pose or a rigid transform (4, 4).

    Raises ValueError, whose text begins with name, for anything else.
    """
    if isinstance(pose, Pose):
        position, orientation = (np.array(values) for values in pose_values(pose))
        if not np.isfinite([*position, *orientation]).all() or not orientation.any():
            raise ValueError(f"{name}: not finite, or a quaternion of length zero")
        orientation /= np.abs(orientation).max()  # or squares overflow, or vanish
        orientation /= np.linalg.norm(orientation)
    else:
        matrix = np.asarray(pose, np.float64)
        if matrix.shape != (4, 4):
            raise ValueError(f"{name}: expected a Pose or a matrix (4, 4), got {matrix.shape}")
        rotation, position = matrix[:3, :3], matrix[:3, 3]
        if (
            not np.isfinite(matrix).all()
            or (matrix[3] != (0, 0, 0, 1)).any()
            or not np.allclose(rotation @ rotation.T, np.eye(3), rtol=0, atol=TOLERANCE)
            or np.linalg.det(rotation) < 0
        ):
            raise ValueError(f"{name}: expected a rotation and a translation")
        orientation = from_matrices(rotation)
    x, y, z, w = orientation.tolist()
    px, py, pz = position.tolist()
    return Pose(position=Point(x=px, y=py, z=pz), orientation=Quaternion(x=x, y=y, z=z, w=w))


def to_matrix(pose: Pose) -> NDArray[np.float64]:
    """The rigid transform (4, 4) of a pose."""
    return frame_at(*pose_values(pose))
