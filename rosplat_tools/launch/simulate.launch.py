"""Simulates a robot in a scene; with `scene` empty, in the map that somebody publishes."""

from __future__ import annotations

from typing import Any

from launch import Action, LaunchDescription

from rosplat_ros.program.launching import SCENE, description, program, scene_publisher

ARGUMENTS = {
    **SCENE,
    "robot": ("mobile", "mobile, arm, quadrotor, or an MJCF file"),
    "start": (
        [0.0, 0.0, 0.0],
        "x, y [m] and yaw [rad] upright, or the nearest place with room",
    ),
    "objects": (
        "",
        "Scene files with commas between them: each is a body that moves freely, in the scene's "
        "coordinates; rviz2 shows them as the map /objects",
    ),
    "rate": (10.0, "Pictures of a camera in a second"),
    "speed": (1.0, "Simulated seconds in a second; 0: as many as can be"),
}


def generate_launch_description() -> LaunchDescription:
    """What `ros2 launch` reads."""
    return description(ARGUMENTS, _programs)


def _programs(given: dict[str, Any]) -> list[Action]:
    simulate = program(
        "rosplat_tools",
        "simulate",
        robot=given["robot"],
        start=given["start"],
        objects=given["objects"].split(","),
        rate=given["rate"],
        speed=given["speed"],
    )
    return [simulate, *scene_publisher(given)]
