"""Cameras of views as ViewCamera messages, in and out."""

from __future__ import annotations

from typing import Any

from rosplat_core.cameras import Camera
from rosplat_core.posed_camera import CameraError, PosedCamera
from rosplat_msgs.msg import ViewCamera
from rosplat_ros.batches import pose_values
from rosplat_ros.poses import pose_of


def view_camera(camera: Camera) -> ViewCamera:
    """The message for a camera."""
    flat = ViewCamera.ORTHOGRAPHIC if camera.orthographic else ViewCamera.PERSPECTIVE
    return ViewCamera(
        pose=pose_of(camera.position, camera.orientation),
        projection=ViewCamera.EQUIRECTANGULAR if camera.model else flat,
        fx=float(camera.fx),
        fy=float(camera.fy),
        cx=float(camera.cx),
        cy=float(camera.cy),
        width=camera.width,
        height=camera.height,
        near_clip=float(camera.near),
        far_clip=float(camera.far),
    )


def decode(message: ViewCamera) -> PosedCamera:
    """The camera of a message. Raises CameraError for an unknown projection, or as PosedCamera."""
    if message.projection not in (ViewCamera.PERSPECTIVE, ViewCamera.ORTHOGRAPHIC):
        raise CameraError(f"projection is {message.projection}, known are 0 and 1")
    return PosedCamera(*(*numbers(message), message.extent_scale))


def numbers(camera: ViewCamera) -> tuple[Any, ...]:
    """A camera's numbers as SplatCamera takes them, and set_camera after a view and a sequence."""
    position, orientation = pose_values(camera.pose)
    return (
        position, orientation, camera.projection, camera.fx, camera.fy, camera.cx, camera.cy,
        camera.width, camera.height, camera.near_clip, camera.far_clip,
    )  # fmt: skip
