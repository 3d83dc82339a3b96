"""What view.launch.py starts, without starting it."""

from __future__ import annotations

import os
import re
from pathlib import Path
from types import SimpleNamespace
from typing import NamedTuple

import pytest

pytest.importorskip("launch_ros")
LAUNCH = Path(__file__).resolve().parents[1] / "rviz_gaussian_plugin/launch/view.launch.py"
PROFILE = "FASTRTPS_DEFAULT_PROFILES_FILE"


class Program(NamedTuple):
    """What a program is started with."""

    words: list[str]  # rviz2's own
    profile: str  # of Fast DDS
    sim_time: bool
    name: str  # of the node, with its namespace
    remappings: dict[str, str]


def started(namespace: str = "", **arguments: str) -> dict[str, Program]:
    """Each program by its name."""
    from launch import LaunchContext
    from launch.actions import GroupAction, IncludeLaunchDescription
    from launch.launch_description_sources import AnyLaunchDescriptionSource
    from launch.utilities import perform_substitutions
    from launch_ros.actions import Node, PushRosNamespace

    context = LaunchContext()
    context.launch_configurations.update(arguments)
    programs = {}

    def visit(entity: object) -> None:
        if not isinstance(entity, Node):
            for part in entity.visit(context) or []:
                visit(part)
        elif entity.condition is None or entity.condition.evaluate(context):
            name = entity.node_executable
            own = entity.cmd[1:4] if name == "rviz2" else []  # before what ROS adds
            words = [perform_substitutions(context, word) for word in own]
            entity._perform_substitutions(context)
            programs[name] = Program(
                words,
                context.environment.get(PROFILE, ""),
                dict(context.launch_configurations["global_params"])["use_sim_time"],
                entity.node_name,
                dict(entity.expanded_remapping_rules or []),
            )

    included = IncludeLaunchDescription(AnyLaunchDescriptionSource(str(LAUNCH)))
    visit(GroupAction([*([PushRosNamespace(namespace)] if namespace else []), included]))
    return programs


def test_nothing_is_published_unasked() -> None:
    """Not even a topic of an empty scene, beside which a volatile publisher isn't heard."""
    assert set(started()) == {"sorter", "rviz2"}
    assert set(started(scene="it's mine.ply")) == {"ply_publisher", "sorter", "rviz2"}
    assert set(started(scene="town/lod-meta.json")) == {"stream_publisher", "sorter", "rviz2"}
    assert "demo_sensors" in started(sensors="true")


def test_the_sorter_can_be_left_out() -> None:
    assert set(started(sorter="false")) == {"rviz2"}


def test_panels_of_sensors_come_with_sensors() -> None:
    def config(**arguments: str) -> Path:
        return Path(started(**arguments)["rviz2"].words[1])

    assert "/camera/image_raw" not in config().read_text()
    for yes in ("true", "True", "1"):
        assert "/camera/image_raw" in config(sensors=yes).read_text()
    assert config(sensors="true", config="mine.rviz") == Path("mine.rviz")


def test_obstacles_come_with_their_grid() -> None:
    shown = started("robot", obstacles="true", topic="map")
    assert set(shown) == {"occupancy", "sorter", "rviz2"}
    config = Path(shown["rviz2"].words[1]).read_text()
    for name in ("occupancy", "voxels", "surface"):
        assert f"Value: /gaussians/{name}" in config
        assert shown["rviz2"].remappings[f"/gaussians/{name}"] == f"map/{name}"
    assert "/gaussians/occupancy" not in started()["rviz2"].remappings


def test_the_frame_of_the_scene_is_seen() -> None:
    """rviz2 keeps the configuration's Fixed Frame where it is given none."""
    assert started()["rviz2"].words[-1] == "--fixed-frame="
    assert started(frame_id="odom")["rviz2"].words[-1] == "--fixed-frame=odom"
    upright = started(frame_id="scene", fixed_frame="map")
    assert upright["rviz2"].words[-1] == "--fixed-frame=map"


def test_topic_and_time_are_those_of_all() -> None:
    for program in started(scene="a.ply", sensors="true").values():
        assert program.remappings["gaussians"] == "gaussians"
        assert program.sim_time is False
    bag = started(topic="/robot/map", use_sim_time="true")
    assert len(bag) == 2
    for program in bag.values():
        assert program.remappings["gaussians"] == "/robot/map"
        assert program.sim_time is True
    assert bag["rviz2"].remappings["/gaussians"] == "/robot/map"


def test_in_a_namespace_all_meet() -> None:
    """rviz2's configuration has whole names, which are led to the others' there."""
    robot = started("robot", scene="a.ply", sensors="true")
    for name, program in robot.items():
        assert program.name == f"/robot/{name}"
    shown = started("robot", sensors="true")["rviz2"]
    config = Path(shown.words[1]).read_text()
    topics = set(re.findall(r"(?:Topic|Value): /([\w/]+)", config))
    assert {"gaussians", "imu/data", "camera/image_raw"} <= topics
    for topic in topics:
        assert shown.remappings[f"/{topic}"] == topic  # in rviz2's namespace
    assert "/imu/data" not in started("robot")["rviz2"].remappings  # a real robot's


def test_fast_dds_gets_room_where_there_is_any_and_only_here(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for name in ("FASTDDS_BUILTIN_TRANSPORTS", "FASTDDS_DEFAULT_PROFILES_FILE", PROFILE):
        monkeypatch.delenv(name, raising=False)
    for room, profile in ((2 << 30, "rosplat_msgs/config/fastdds.xml"), (64 << 20, "")):
        free = SimpleNamespace(free=room)
        monkeypatch.setattr("shutil.disk_usage", lambda path, free=free: free)
        for program in started(scene="a.ply").values():
            assert program.profile.endswith(profile)
            assert bool(program.profile) == bool(profile)
        assert PROFILE not in os.environ
