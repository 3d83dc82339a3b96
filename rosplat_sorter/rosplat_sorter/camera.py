"""Cameras that ask for an order: ViewCamera messages, checked."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rosplat_core.posed_camera import CameraError, PosedCamera

if TYPE_CHECKING:
    from rosplat_msgs.msg import ViewCamera

PERSPECTIVE = 0
ORTHOGRAPHIC = 1


def decode(message: ViewCamera) -> PosedCamera:
    """The camera of a message. Raises CameraError for an unknown projection, or as PosedCamera."""
    if message.projection not in (PERSPECTIVE, ORTHOGRAPHIC):
        raise CameraError(f"projection is {message.projection}, known are 0 and 1")
    position, orientation = message.pose.position, message.pose.orientation
    return PosedCamera(
        position=(position.x, position.y, position.z),
        orientation=(orientation.x, orientation.y, orientation.z, orientation.w),
        fx=message.fx,
        fy=message.fy,
        cx=message.cx,
        cy=message.cy,
        width=message.width,
        height=message.height,
        near_clip=message.near_clip,
        far_clip=message.far_clip,
        orthographic=message.projection == ORTHOGRAPHIC,
        extent_scale=message.extent_scale,
    )
