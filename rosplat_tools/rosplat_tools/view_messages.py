"""Cameras as messages."""

from __future__ import annotations

import numpy as np
from geometry_msgs.msg import Point, Pose, Quaternion
from numpy.typing import NDArray

from rosplat_msgs.msg import ViewCamera
from rosplat_tools.cameras import Camera


def view_camera(camera: Camera) -> ViewCamera:
    """The message for a camera."""
    x, y, z = camera.position
    return ViewCamera(
        pose=Pose(position=Point(x=x, y=y, z=z), orientation=_quaternion(camera.camera_to_world)),
        projection=ViewCamera.ORTHOGRAPHIC if camera.orthographic else ViewCamera.PERSPECTIVE,
        fx=float(camera.fx),
        fy=float(camera.fy),
        cx=float(camera.cx),
        cy=float(camera.cy),
        width=camera.width,
        height=camera.height,
        near_clip=float(camera.near),
        far_clip=float(camera.far),
    )


def _quaternion(pose: NDArray[np.float64]) -> Quaternion:
    """Of a rotation matrix: the eigenvector of the largest eigenvalue (Bar-Itzhack 2000)."""
    (a, b, c), (d, e, f), (g, h, i) = pose[:3, :3]
    symmetric = np.array(
        [
            [a - e - i, b + d, c + g, h - f],
            [b + d, e - a - i, f + h, c - g],
            [c + g, f + h, i - a - e, d - b],
            [h - f, c - g, d - b, a + e + i],
        ]
    )
    x, y, z, w = np.linalg.eigh(symmetric)[1][:, -1]
    return Quaternion(x=float(x), y=float(y), z=float(z), w=float(w))
