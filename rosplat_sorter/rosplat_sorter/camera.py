"""Cameras that ask for an order: ViewCamera messages, checked."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rosplat_core.posed_camera import CameraError, PosedCamera
from rosplat_sorter.batches import pose_values

if TYPE_CHECKING:
    from rosplat_msgs.msg import ViewCamera

PERSPECTIVE = 0
ORTHOGRAPHIC = 1


def decode(message: ViewCamera) -> PosedCamera:
    """The camera of a message. Raises CameraError for an unknown projection, or as PosedCamera."""
    if message.projection not in (PERSPECTIVE, ORTHOGRAPHIC):
        raise CameraError(f"projection is {message.projection}, known are 0 and 1")
    return PosedCamera(*(*numbers(message), message.extent_scale))


def numbers(camera: ViewCamera) -> tuple[Any, ...]:
    """A camera's numbers as SplatCamera takes them, and set_camera after a view and a sequence."""
    position, orientation = pose_values(camera.pose)
    return (
        position, orientation, camera.projection, camera.fx, camera.fy, camera.cx, camera.cy,
        camera.width, camera.height, camera.near_clip, camera.far_clip,
    )  # fmt: skip
