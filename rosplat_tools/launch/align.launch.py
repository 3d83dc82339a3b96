"""Refines the poses of a camera's pictures against a map, and with `scene` publishes that map."""

from __future__ import annotations

from typing import Any

from launch import Action, LaunchDescription

from rosplat_ros.program.launching import SCENE, description, program, scene_publisher

ARGUMENTS = {
    "image": ("image_raw", "Topic of the camera's pictures"),
    "camera_info": ("camera_info", "Topic of its calibration"),
    "rectified": (False, "Whether pictures are rectified"),
    "broadcast": ("", "Frame that TF has at the refined pose; empty: none"),
    **SCENE,
    "frame_id": ("map", "Frame of the scene's coordinates"),
}


def generate_launch_description() -> LaunchDescription:
    """What `ros2 launch` reads."""
    return description(ARGUMENTS, _programs)


def _programs(given: dict[str, Any]) -> list[Action]:
    align = program(
        "rosplat_tools", "align",
        ("image_raw", given["image"]), ("camera_info", given["camera_info"]),
        rectified=given["rectified"], broadcast=given["broadcast"],
    )  # fmt: skip
    return [align, *scene_publisher(given)]
