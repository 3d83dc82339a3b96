"""A picture's pose, refined against a map."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseWithCovariance
from numpy.typing import NDArray

from rosplat_core.alignment import Alignment, align
from rosplat_core.lens_warps import Straightened
from rosplat_core.quaternions import from_matrices
from rosplat_core.rendering import CpuRenderer
from rosplat_ros.poses import to_pose
from rosplat_tools.cameras.health import drawn
from rosplat_tools.cameras.pose_history import Pose
from rosplat_tools.cameras.taken_pictures import Taken


@dataclass(frozen=True, eq=False)
class Refined:
    """A camera's pose as found by its picture."""

    alignment: Alignment
    pose: Pose
    """(4, 4) of the optical frame in the map's. [m]"""
    start: Pose

    @classmethod
    def of(cls, found: Alignment, taken: Taken[Any]) -> Refined:
        """What was found for a picture."""
        pose = np.asarray(np.linalg.inv(found.world_to_camera) @ taken.rotation, np.float64)
        return cls(found, pose, taken.pose)

    def in_map(self) -> PoseWithCovariance:
        """The pose in the map's frame."""
        return _message(self.pose, self.alignment.covariance)

    def correction(self) -> PoseWithCovariance:
        """The refined pose in the optical frame of the start."""
        back = np.linalg.inv(self.start)
        turned = np.kron(np.eye(2), back[:3, :3])
        return _message(back @ self.pose, turned @ self.alignment.covariance @ turned.T)

    def figures(self) -> dict[str, float]:
        """How far off the start was, for /diagnostics."""
        off = np.linalg.inv(self.start) @ self.pose
        sine = min(float(np.linalg.norm(from_matrices(off[:3, :3])[:3])), 1.0)
        return {
            "Off (m)": round(float(np.linalg.norm(off[:3, 3])), 5),
            "Off (degrees)": round(math.degrees(2 * math.asin(sine)), 4),
        }


def refined(
    renderer: CpuRenderer,
    taken: Taken[Any],
    straightened: Straightened,
    patience: float = math.inf,
) -> Refined:
    """Refines a picture's pose; patience: as of align(). Raises NoPicture."""
    colours, counts = straightened.picture(taken.colours, taken.counts)
    camera = taken.camera(straightened.camera)
    with drawn():
        found = align(renderer, colours, camera, counts, patience=patience)
    return Refined.of(found, taken)


def _message(pose: Pose, covariance: NDArray[np.float64]) -> PoseWithCovariance:
    return PoseWithCovariance(pose=to_pose(pose), covariance=covariance.ravel())
