"""What view.launch.xml starts, without starting it."""

from __future__ import annotations

import os
from pathlib import Path
from types import SimpleNamespace

import pytest

pytest.importorskip("launch_xml")
LAUNCH = Path(__file__).resolve().parents[1] / "rosplat_tools/launch/view.launch.xml"
PROFILE = "FASTRTPS_DEFAULT_PROFILES_FILE"


def started(**arguments: str) -> dict[str, tuple[list[str], str]]:
    """Each program by its name, with rviz2's arguments and Fast DDS's profile."""
    from launch import LaunchContext
    from launch.actions import IncludeLaunchDescription
    from launch.launch_description_sources import AnyLaunchDescriptionSource
    from launch.utilities import perform_substitutions
    from launch_ros.actions import Node

    context = LaunchContext()
    context.launch_configurations.update(arguments)
    programs = {}

    def visit(entity: object) -> None:
        if not isinstance(entity, Node):
            for part in entity.visit(context) or []:
                visit(part)
        elif entity.condition is None or entity.condition.evaluate(context):
            name = perform_substitutions(context, entity.node_executable)
            own = entity.cmd[1:4] if name == "rviz2" else []  # before what ROS adds
            words = [perform_substitutions(context, word) for word in own]
            programs[name] = words, context.environment.get(PROFILE, "")

    visit(IncludeLaunchDescription(AnyLaunchDescriptionSource(str(LAUNCH))))
    return programs


def test_nothing_is_published_unasked() -> None:
    """Not even a topic of an empty scene, beside which a volatile publisher isn't heard."""
    assert set(started()) == {"sorter", "rviz2"}
    assert set(started(scene="it's mine.ply")) == {"ply_publisher", "sorter", "rviz2"}
    assert "demo_sensors" in started(sensors="true")


def test_the_sorter_can_be_left_out() -> None:
    assert set(started(sorter="false")) == {"rviz2"}


def test_the_frame_of_the_scene_is_seen() -> None:
    """rviz2 keeps the configuration's Fixed Frame where it is given none."""
    assert started()["rviz2"][0][-1] == "--fixed-frame="
    assert started(frame_id="odom")["rviz2"][0][-1] == "--fixed-frame=odom"
    upright = started(frame_id="scene", fixed_frame="map")
    assert upright["rviz2"][0][-1] == "--fixed-frame=map"


def test_fast_dds_gets_room_where_there_is_any_and_only_here(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for name in ("FASTDDS_BUILTIN_TRANSPORTS", "FASTDDS_DEFAULT_PROFILES_FILE", PROFILE):
        monkeypatch.delenv(name, raising=False)
    for room, profile in ((2 << 30, "rosplat_msgs/config/fastdds.xml"), (64 << 20, "")):
        free = SimpleNamespace(free=room)
        monkeypatch.setattr("shutil.disk_usage", lambda path, free=free: free)
        for _, environment in started(scene="a.ply").values():
            assert environment.endswith(profile)
            assert bool(environment) == bool(profile)
        assert PROFILE not in os.environ
