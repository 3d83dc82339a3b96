"""Simulates a robot in a scene; with `scene` empty, in the map that somebody publishes."""

from __future__ import annotations

from launch import LaunchContext, LaunchDescription
from launch.actions import OpaqueFunction
from launch.substitutions import LaunchConfiguration

from rosplat_ros.program.launching import (
    declared,
    number,
    program,
    publisher,
    room_for_maps,
    whole_number,
)

ARGUMENTS = {
    "scene": ("", "Scene file of the map; empty: somebody publishes /gaussians already"),
    "robot": ("mobile", "mobile, arm, quadrotor, or an MJCF file"),
    "start": (
        "0 0 0",
        "x, y [m] and yaw [rad] upright, or the nearest place with room",
    ),
    "up": ("", "The scene's vertical, such as '0 -1 0'; empty: the file's, or else by its ground"),
    "rate": ("10", "Pictures of a camera in a second"),
    "speed": ("1", "Simulated seconds in a second; 0: as many as can be"),
    "frame_id": (
        "",
        "Frame of the scene as the file has it; by default 'scene', which stands "
        "upright in the frame 'map' by a transform that is published, too",
    ),
    "max_splats": ("2000000", "The most splats of a streamed scene"),
}


def generate_launch_description() -> LaunchDescription:
    """What `ros2 launch` reads."""
    return LaunchDescription([*declared(ARGUMENTS), OpaqueFunction(function=_programs)])


def _programs(context: LaunchContext) -> list[object]:
    given = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    simulate = program(
        "rosplat_tools",
        "simulate",
        robot=given["robot"],
        start=_numbers(given, "start"),
        rate=number(given, "rate"),
        speed=number(given, "speed"),
    )
    programs: list[object] = [*room_for_maps(context), simulate]
    if given["scene"]:
        most = whole_number(given, "max_splats")
        programs.append(publisher(given["scene"], given["frame_id"], most, up=given["up"]))
    return programs


def _numbers(given: dict[str, str], name: str) -> list[float]:
    """The numbers of an argument. Raises ValueError that names it."""
    try:
        return [float(part) for part in given[name].replace(",", " ").split()]
    except ValueError as error:
        raise ValueError(f"{name}: expected numbers, got '{given[name]}'") from error
