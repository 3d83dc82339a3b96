"""Publishes the maps of several robots, each in the namespace and the frame of its robot."""

from __future__ import annotations

from typing import Any

import yaml
from launch import LaunchDescription
from launch.actions import GroupAction
from launch_ros.actions import PushRosNamespace, SetParameter

from rosplat_ros.program.launching import description, program, publisher

ARGUMENTS = {
    "scenes": (
        "",
        "The scene of each robot, by its namespace: {robot1: a.ply, robot2: town/lod-meta.json}. "
        "The map is in the frame NAMESPACE/map",
    ),
    "max_splats": (2_000_000, "The most splats of a streamed scene that a map holds"),
    "compression": ("none", "How splats travel: none, or quantised for a radio"),
    "sorter": (False, "Start a sorter for each map, for displays whose Order Source is Sidecar"),
    "use_sim_time": (False, "Take the time from /clock, as a simulator gives it"),
}


def generate_launch_description() -> LaunchDescription:
    """What `ros2 launch` reads."""
    return description(ARGUMENTS, _robots)


def _robots(given: dict[str, Any]) -> list[GroupAction]:
    def robot(name: str, scene: str) -> GroupAction:
        sorter = [program("rosplat_sorter", "sorter")] if given["sorter"] else []
        return GroupAction(
            [
                PushRosNamespace(name),
                SetParameter("use_sim_time", given["use_sim_time"]),
                publisher(
                    scene,
                    f"{name}/map",
                    given["max_splats"],
                    compression=given["compression"],
                ),
                *sorter,
            ]
        )

    return [robot(*each) for each in _scenes(given["scenes"]).items()]


def _scenes(text: str) -> dict[str, str]:
    """Scenes by namespaces. Raises ValueError where the text has none."""
    try:
        scenes = yaml.safe_load(text)
    except yaml.YAMLError:
        scenes = None
    if not isinstance(scenes, dict) or not scenes or None in scenes.values():
        raise ValueError(f"scenes: expected {{robot1: a.ply, robot2: b.ply}}, got '{text}'")
    return {str(name).strip("/"): str(scene) for name, scene in scenes.items()}
