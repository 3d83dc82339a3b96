"""Messages as the renderer takes them."""

from __future__ import annotations

from typing import Any

from rosplat_msgs.msg import ViewCamera


def numbers(camera: ViewCamera) -> tuple[Any, ...]:
    """A camera's numbers, as Camera takes them, and set_camera after a view and a sequence."""
    position, orientation = camera.pose.position, camera.pose.orientation
    return (
        (position.x, position.y, position.z),
        (orientation.x, orientation.y, orientation.z, orientation.w), camera.projection,
        camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height,
        camera.near_clip, camera.far_clip,
    )  # fmt: skip
