"""Cameras as messages."""

from __future__ import annotations

from geometry_msgs.msg import Point, Pose, Quaternion

from rosplat_core.cameras import Camera
from rosplat_msgs.msg import ViewCamera


def view_camera(camera: Camera) -> ViewCamera:
    """The message for a camera."""
    position = dict(zip("xyz", camera.position.tolist(), strict=True))
    orientation = dict(zip("xyzw", camera.orientation.tolist(), strict=True))
    return ViewCamera(
        pose=Pose(position=Point(**position), orientation=Quaternion(**orientation)),
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
