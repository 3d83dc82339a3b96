"""Shows a map in rviz2. Publishes it where a scene is given."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from launch import Action, LaunchDescription
from launch.actions import Shutdown
from launch_ros.actions import Node, SetParameter, SetRemap

from rosplat_ros.program.launching import (
    ENDS_WITH_LAUNCH,
    SCENE,
    description,
    program,
    scene_publisher,
)

# By name: the default, and what it means. Names of topics are in the namespace that the launch file
# is included in, unless they begin with a slash.
ARGUMENTS = {
    **SCENE,
    "topic": (
        "gaussians",
        "Topic of the map; those of its views, orders and pictures begin with it",
    ),
    "fixed_frame": ("", "rviz2's Fixed Frame; by default frame_id, or the configuration's: map"),
    "sorter": (False, "Start a sorter, for displays whose Order Source is Sidecar"),
    "backend": ("auto", "What sorts: auto, cupy, torch, native, numpy"),
    "sensors": (
        False,
        "Start a simulated robot that circles the map, with an IMU and a camera; don't use it "
        "beside a real one",
    ),
    "obstacles": (
        False,
        "Start occupancy with its default parameters, and show its grid",
    ),
    "use_sim_time": (False, "Take the time from /clock, as a bag or a simulator gives it"),
    "config": (
        "",
        "rviz2 configuration; by default one that shows the map, and the sensors, or else the "
        "obstacles, if they are started",
    ),
}

# Topics of demo_sensors that sensors.rviz shows.
SENSORS = ("imu/data", "camera/image_raw", "camera/camera_info", "camera/pose", "camera/path")
# Topics of occupancy that obstacles.rviz shows, below the map's topic.
OBSTACLES = ("occupancy", "voxels", "surface")


def generate_launch_description() -> LaunchDescription:
    """What `ros2 launch` reads."""
    return description(ARGUMENTS, _programs)


def _programs(given: dict[str, Any]) -> list[Action]:
    # First: where there is no rviz2, nothing else begins.
    programs = [_rviz(given)]
    # No publisher without a scene: beside it, displays don't hear a SLAM node's volatile one.
    programs += scene_publisher(given)
    if given["sorter"]:
        programs.append(program("rosplat_sorter", "sorter", backend=given["backend"]))
    if given["sensors"]:
        programs.append(program("rosplat_tools", "demo_sensors"))
    if given["obstacles"]:
        programs.append(program("rosplat_tools", "occupancy"))
    return [
        SetParameter("use_sim_time", given["use_sim_time"]),
        SetRemap("gaussians", given["topic"]),
        *programs,
    ]


def _rviz(given: dict[str, Any]) -> Node:
    sensors, obstacles = given["sensors"], given["obstacles"]
    fixed_frame = given["fixed_frame"] or given["frame_id"]
    name = "sensors.rviz" if sensors else "obstacles.rviz" if obstacles else "rosplat.rviz"
    config = given["config"] or str(Path(__file__).parents[1] / "config" / name)
    # Topics in a configuration begin with a slash: remap them into the other nodes' namespace.
    shown = {"gaussians": given["topic"]} | {topic: topic for topic in SENSORS if sensors}
    shown |= {f"gaussians/{name}": f"{given['topic']}/{name}" for name in OBSTACLES if obstacles}
    return Node(
        package="rviz2",
        executable="rviz2",
        name="rviz2",
        arguments=["-d", config, f"--fixed-frame={fixed_frame}"],
        remappings=[(f"/{topic}", meant) for topic, meant in shown.items()],
        prefix=ENDS_WITH_LAUNCH,
        exec_name="rviz2",
        output="screen",
        on_exit=[Shutdown(reason="rviz2 was closed")],
    )
