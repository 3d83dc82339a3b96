"""Simulates a robot in a scene; with `scene` empty, in the map that somebody publishes."""

from __future__ import annotations

from launch import Action, LaunchDescription

from rosplat_ros.program.launching import SCENE, description, number, program, scene_publisher

ARGUMENTS = {
    **SCENE,
    "robot": ("mobile", "mobile, arm, quadrotor, or an MJCF file"),
    "start": (
        "0 0 0",
        "x, y [m] and yaw [rad] upright, or the nearest place with room",
    ),
    "objects": (
        "",
        "Scene files with commas between them: each is a body that moves freely, in the scene's "
        "coordinates; rviz2 shows them as the map /objects",
    ),
    "rate": ("10", "Pictures of a camera in a second"),
    "speed": ("1", "Simulated seconds in a second; 0: as many as can be"),
}


def generate_launch_description() -> LaunchDescription:
    """What `ros2 launch` reads."""
    return description(ARGUMENTS, _programs)


def _programs(given: dict[str, str]) -> list[Action]:
    simulate = program(
        "rosplat_tools",
        "simulate",
        robot=given["robot"],
        start=_numbers(given, "start"),
        objects=given["objects"].split(","),
        rate=number(given, "rate"),
        speed=number(given, "speed"),
    )
    return [simulate, *scene_publisher(given)]


def _numbers(given: dict[str, str], name: str) -> list[float]:
    """The numbers of an argument. Raises ValueError that names it."""
    try:
        return [float(part) for part in given[name].replace(",", " ").split()]
    except ValueError as error:
        raise ValueError(f"{name}: expected numbers, got '{given[name]}'") from error
