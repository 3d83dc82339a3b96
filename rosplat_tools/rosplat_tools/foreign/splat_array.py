"""gsplat_msgs/SplatArray, of RVizSplat: a message for each splat, its shape a covariance.

An array is a whole map, in the frame of its first splat. Its opacities have 8 bits.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from geometry_msgs.msg import Point, Pose, PoseWithCovariance, PoseWithCovarianceStamped
from std_msgs.msg import Header

from rosplat_core.formats.decoded import Columns, IntoSplats, Warn
from rosplat_core.splats import MAX_SH_DEGREE, InputError, Splats, sh_coefficients
from rosplat_ros.messages import as_array, message_class, plain_frame
from rosplat_tools.foreign import MapReader
from rosplat_tools.foreign.covariances import from_covariances, to_covariances

TYPE = "gsplat_msgs/msg/SplatArray"
TOPIC = "splat_array"
DEPTH = 1
FIELDS = ("splats",)


class Reader(MapReader):
    """The map of the last array."""

    def add(self, message: Any) -> bool:
        """Raises InputError for an array that contradicts itself."""
        self._splats = _splats(message, self._name, self._warn)
        if message.splats:
            self.frame_id = plain_frame(message.splats[0].pose.header.frame_id)
        return True


def messages(kind: Any, splats: Splats, header: Header) -> Iterator[Any]:
    """One array."""
    splat_kind = message_class("gsplat_msgs/msg/Splat")
    positions = (splats.positions + splats.origin).tolist()
    poses = np.zeros((len(splats), 6, 6))
    poses[:, :3, :3] = to_covariances(splats)
    opacities = np.rint(255 * np.clip(splats.opacities, 0, 1)).astype(int).tolist()
    array = kind()
    array.splats = [
        splat_kind(
            pose=PoseWithCovarianceStamped(
                header=header,
                pose=PoseWithCovariance(
                    pose=Pose(position=Point(x=x, y=y, z=z)), covariance=pose.ravel()
                ),
            ),
            opacity=opacity,
            harmonics_deg=splats.sh_degree,
            spherical_harmonics=as_array("f", sh),
        )
        for (x, y, z), pose, opacity, sh in zip(positions, poses, opacities, splats.sh, strict=True)
    ]
    yield array


def _splats(message: Any, name: str, warn: Warn) -> Splats:
    n = len(message.splats)
    degree = message.splats[0].harmonics_deg if n else 0
    if degree > MAX_SH_DEGREE:
        raise InputError(f"{name}: harmonics_deg: {degree}, at most {MAX_SH_DEGREE}")
    k = sh_coefficients(degree)
    positions = np.empty((n, 3))
    covariances = np.empty((n, 3, 3))
    opacities = np.empty(n, np.float32)
    sh = np.empty((n, k, 3), np.float32)
    for i, splat in enumerate(message.splats):
        pose = splat.pose.pose
        if (have := len(splat.spherical_harmonics)) != 3 * k:
            raise InputError(
                f"{name}: splats[{i}].spherical_harmonics: {have} numbers, expected {3 * k}"
            )
        positions[i] = pose.pose.position.x, pose.pose.position.y, pose.pose.position.z
        covariances[i] = np.reshape(pose.covariance, (6, 6))[:3, :3]
        opacities[i] = splat.opacity / 255
        sh[i] = np.reshape(splat.spherical_harmonics, (k, 3))
    columns = Columns(positions, *from_covariances(covariances), opacities, sh)
    return IntoSplats().make(Path(name), warn, columns)
