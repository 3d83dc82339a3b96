"""Messages as the renderer takes them."""

from __future__ import annotations

from typing import Any

from rosplat_msgs.msg import ViewCamera


def numbers(camera: ViewCamera) -> tuple[Any, ...]:
    """A camera's, as Camera takes them, and Renderer.set_camera after the view's own."""
    position, orientation = camera.pose.position, camera.pose.orientation
    return (
        (position.x, position.y, position.z),
        (orientation.x, orientation.y, orientation.z, orientation.w), camera.projection,
        camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height,
        camera.near_clip, camera.far_clip,
    )  # fmt: skip
