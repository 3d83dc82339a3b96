"""What view.launch.xml starts, without starting it."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("launch_xml")
LAUNCH = Path(__file__).resolve().parents[1] / "rosplat_tools/launch/view.launch.xml"


def started(**arguments: str) -> dict[str, list[str]]:
    """Each program by its name, with rviz2's arguments."""
    from launch import LaunchContext
    from launch.frontend import Parser
    from launch.utilities import perform_substitutions
    from launch_ros.actions import Node

    context = LaunchContext()
    context.launch_configurations.update(arguments)
    root, parser = Parser.load(str(LAUNCH))
    programs = {}
    for entity in parser.parse_description(root).entities:
        if not isinstance(entity, Node):
            entity.visit(context)
        elif entity.condition is None or entity.condition.evaluate(context):
            name = perform_substitutions(context, entity.node_executable)
            own = entity.cmd[1:4] if name == "rviz2" else []  # before what ROS adds
            programs[name] = [perform_substitutions(context, word) for word in own]
    return programs


def test_nothing_made_up_is_published_unasked() -> None:
    assert set(started()) == {"ply_publisher", "sorter", "rviz2"}
    assert "demo_sensors" in started(sensors="true")


def test_the_frame_of_the_scene_is_seen() -> None:
    """rviz2 keeps the configuration's Fixed Frame where it is given none."""
    assert started()["rviz2"][-1] == "--fixed-frame="
    assert started(frame_id="odom")["rviz2"][-1] == "--fixed-frame=odom"
