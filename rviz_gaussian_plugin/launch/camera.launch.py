"""Shows a map, a camera in it on an emulated robot, what compare makes of that, and obstacles."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from launch import Action, LaunchDescription
from launch.actions import GroupAction, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import PushRosNamespace, SetRemap

from rosplat_ros.program.launching import description, program, publisher

FOLDER = Path(__file__).parent
ARGUMENTS = {
    "scene": (
        "",
        "Scene file to show and to hold against the camera; empty: the map comes from elsewhere",
    ),
    "filmed": ("", "Scene file that the camera films in its place; empty: the same map"),
    "max_splats": (2_000_000, "The most splats of each streamed scene that a map holds"),
}


def generate_launch_description() -> LaunchDescription:
    """What `ros2 launch` reads."""
    view = IncludeLaunchDescription(
        PythonLaunchDescriptionSource(str(FOLDER / "view.launch.py")),
        launch_arguments={
            "scene": LaunchConfiguration("scene"),
            "frame_id": "map",  # as the other one
            "max_splats": LaunchConfiguration("max_splats"),
            "sensors": "true",  # their TF has the camera
            "obstacles": "true",
            "config": str(FOLDER.parent / "config" / "camera.rviz"),
        }.items(),
    )
    # Topics in a configuration begin with a slash: remap them to compare's, in its namespace.
    shown = [SetRemap(f"/{topic}", topic) for topic in ("rendered", "difference", "residuals")]
    return description(ARGUMENTS, _programs, GroupAction([*shown, view]))


def _programs(given: dict[str, Any]) -> list[Action]:
    filmed = given["filmed"]
    other = [("gaussians", "filmed/gaussians")] if filmed else []
    camera = program(
        "rosplat_tools", "camera", *other,
        cameras=["filmed"], **{"filmed.frame_id": "demo_camera_optical"},
    )  # fmt: skip
    pictures = [(name, f"filmed/{name}") for name in ("image_raw", "camera_info")]
    compare = program("rosplat_tools", "compare", *pictures, attribute=True)
    if not filmed:
        return [camera, compare]
    scene = publisher(filmed, "map", given["max_splats"])
    return [GroupAction([PushRosNamespace("filmed"), scene]), camera, compare]
