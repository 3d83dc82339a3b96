"""Shows a scene, a camera in it that an emulated robot carries, and what compare makes of that."""

from __future__ import annotations

from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

FOLDER = Path(__file__).parent


def generate_launch_description() -> LaunchDescription:
    """What `ros2 launch` reads."""
    view = IncludeLaunchDescription(
        PythonLaunchDescriptionSource(str(FOLDER / "view.launch.py")),
        launch_arguments={
            "scene": LaunchConfiguration("scene"),
            "sensors": "true",  # whose TF has the camera
            "config": str(FOLDER.parent / "config" / "camera.rviz"),
        }.items(),
    )
    camera = Node(
        package="rosplat_tools",
        executable="camera",
        name="camera",
        parameters=[{"cameras": ["filmed"], "filmed.frame_id": "demo_camera_optical"}],
        output="screen",
    )
    compare = Node(
        package="rosplat_tools",
        executable="compare",
        name="compare",
        parameters=[{"attribute": True}],
        remappings=[(name, f"filmed/{name}") for name in ("image_raw", "camera_info")],
        output="screen",
    )
    scene = DeclareLaunchArgument("scene", description="Scene file, as of view.launch.py")
    return LaunchDescription([scene, view, camera, compare])
