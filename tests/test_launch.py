"""What the launch files start, without starting it."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, NamedTuple

import pytest
import yaml

from rosplat_ros.program.middleware import FAST_DDS_WISHES
from rosplat_testing import PATIENCE

if TYPE_CHECKING:
    from launch import LaunchContext
    from launch.actions import ExecuteProcess

pytest.importorskip("launch_ros")
ROOT = Path(__file__).resolve().parents[1]
VIEW = ROOT / "rviz_gaussian_plugin/launch/view.launch.py"
ROBOTS = ROOT / "rosplat_tools/launch/robots.launch.py"
CAMERA = ROOT / "rviz_gaussian_plugin/launch/camera.launch.py"
SIMULATE = ROOT / "rosplat_tools/launch/simulate.launch.py"
RECORD = ROOT / "rosplat_tools/launch/record.launch.py"
PROFILES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")  # to Jazzy, since
PROFILE = PROFILES[os.environ.get("ROS_DISTRO") not in ("humble", "jazzy")]


class Program(NamedTuple):
    """What a program is started with."""

    words: list[str]  # rviz2's own
    profile: str  # of Fast DDS
    sim_time: bool | None
    name: str  # of the node, with its namespace
    remappings: dict[str, str]
    parameters: dict[str, object]


def actions_of(
    launch: Path, namespace: str = "", **arguments: str
) -> Iterator[tuple[ExecuteProcess, LaunchContext]]:
    """What a launch file starts or listens to, with what holds there."""
    from launch import LaunchContext
    from launch.actions import (
        ExecuteProcess,
        GroupAction,
        IncludeLaunchDescription,
        RegisterEventHandler,
    )
    from launch.launch_description_sources import AnyLaunchDescriptionSource
    from launch_ros.actions import PushRosNamespace

    context = LaunchContext()
    context.launch_configurations.update(arguments)

    def visit(entity: Any) -> Iterator[tuple[Any, Any]]:
        if not isinstance(entity, ExecuteProcess | RegisterEventHandler):
            for part in entity.visit(context) or []:
                yield from visit(part)
        elif entity.condition is None or entity.condition.evaluate(context):
            yield entity, context

    included = IncludeLaunchDescription(AnyLaunchDescriptionSource(str(launch)))
    yield from visit(GroupAction([*([PushRosNamespace(namespace)] if namespace else []), included]))


def started(namespace: str = "", launch: Path = VIEW, **arguments: str) -> dict[str, Program]:
    """Each program by its name, in its namespace if it has one."""
    from launch.utilities import perform_substitutions

    programs = {}
    for entity, context in actions_of(launch, namespace, **arguments):
        name = entity.node_executable
        own = entity.cmd[1:4] if name == "rviz2" else []  # before what ROS adds
        words = [perform_substitutions(context, word) for word in own]
        entity._perform_substitutions(context)
        files = entity._Node__expanded_parameter_arguments or []
        parameters = [
            next(iter(yaml.full_load(Path(file).read_text()).values()))  # has tuples
            for file, _ in files
        ]
        programs[entity.node_name if launch in (ROBOTS, CAMERA) else name] = Program(
            words,
            context.environment.get(PROFILE, ""),
            dict(context.launch_configurations.get("global_params", [])).get("use_sim_time"),
            entity.node_name,
            dict(entity.expanded_remapping_rules or []),
            {k: v for each in parameters for k, v in each["ros__parameters"].items()},
        )
    return programs


def test_nothing_is_published_unasked() -> None:
    """Not even a topic of an empty scene, beside which a volatile publisher isn't heard."""
    assert set(started()) == {"rviz2"}
    assert set(started(scene="it's mine.ply")) == {"ply_publisher", "rviz2"}
    assert set(started(scene="town/lod-meta.json")) == {"stream_publisher", "rviz2"}
    assert "demo_sensors" in started(sensors="true")


def test_a_robot_comes_with_its_scene() -> None:
    programs = started(launch=SIMULATE, scene="playbot", robot="arm", start="1 -2 0.5", up="0 -1 0")
    assert set(programs) == {"simulate", "ply_publisher"}
    simulate = programs["simulate"].parameters
    assert list(simulate["start"]) == [1.0, -2.0, 0.5]
    assert (simulate["robot"], simulate["rate"], simulate["speed"]) == ("arm", 10.0, 1.0)
    assert programs["ply_publisher"].parameters["up"] == "0 -1 0"
    assert set(started(launch=SIMULATE)) == {"simulate"}


def test_a_sorter_comes_if_it_is_asked_for() -> None:
    assert set(started(sorter="true")) == {"sorter", "rviz2"}


def test_panels_of_sensors_come_with_sensors() -> None:
    def config(**arguments: str) -> Path:
        return Path(started(**arguments)["rviz2"].words[1])

    assert "/camera/image_raw" not in config().read_text()
    for yes in ("true", "True", "1"):
        assert "/camera/image_raw" in config(sensors=yes).read_text()
    assert config(sensors="true", config="mine.rviz") == Path("mine.rviz")


def test_obstacles_come_with_their_grid() -> None:
    shown = started("robot", obstacles="true", topic="map")
    assert set(shown) == {"occupancy", "rviz2"}
    config = Path(shown["rviz2"].words[1]).read_text()
    for name in ("occupancy", "voxels", "surface"):
        assert f"Value: /gaussians/{name}" in config
        assert shown["rviz2"].remappings[f"/gaussians/{name}"] == f"map/{name}"
    assert "/gaussians/occupancy" not in started()["rviz2"].remappings


def test_a_camera_comes_with_what_it_is_held_against_and_obstacles() -> None:
    def programs(**arguments: str) -> dict[str, Program]:
        found = started("robot", launch=CAMERA, **arguments)
        return {name.removeprefix("/robot/"): each for name, each in found.items()}

    shown = programs(scene="a.ply")
    assert set(shown) == {
        "ply_publisher", "demo_sensors", "occupancy", "rviz2", "camera", "compare",
    }  # fmt: skip
    displays = yaml.safe_load(Path(shown["rviz2"].words[1]).read_text())["Visualization Manager"]
    topics = {
        each["Name"]: each["Topic"]["Value"] if isinstance(each["Topic"], dict) else each["Topic"]
        for each in displays["Displays"]
        if "Topic" in each
    }
    assert topics == {
        "Gaussian Map": "/gaussians", "Residuals": "/residuals", "Rendered": "/rendered",
        "Difference": "/difference", "Obstacles": "/gaussians/occupancy",
    }  # fmt: skip
    for topic in topics.values():
        assert shown["rviz2"].remappings[topic] == topic.lstrip("/")  # in rviz2's namespace
    (name,) = shown["camera"].parameters["cameras"]
    assert shown["compare"].remappings == {
        each: f"{name}/{each}" for each in ("image_raw", "camera_info")
    }
    assert shown["camera"].parameters[f"{name}.frame_id"] == "demo_camera_optical"

    other = programs(scene="a.ply", filmed="b.ply")
    assert set(other) == {*shown, "filmed/ply_publisher"}
    assert other["filmed/ply_publisher"].parameters["path"] == "b.ply"
    assert other["camera"].remappings == {"gaussians": "filmed/gaussians"}
    assert "gaussians" not in other["compare"].remappings


def test_the_frame_of_the_scene_is_seen() -> None:
    """rviz2 keeps the configuration's Fixed Frame where it is given none."""
    assert started()["rviz2"].words[-1] == "--fixed-frame="
    assert started(frame_id="odom")["rviz2"].words[-1] == "--fixed-frame=odom"
    upright = started(frame_id="scene", fixed_frame="map")
    assert upright["rviz2"].words[-1] == "--fixed-frame=map"


def test_a_scene_stands_upright_unless_its_frame_is_named() -> None:
    stands = started(scene="a.ply", up="0 -1 0")["ply_publisher"].parameters
    names = ("frame_id", "upright_frame", "up")
    assert [stands[name] for name in names] == ["scene", "map", "0 -1 0"]
    stays = started(scene="a.ply", frame_id="odom")["ply_publisher"].parameters
    assert (stays["frame_id"], "upright_frame" in stays) == ("odom", False)


def test_topic_and_time_are_those_of_all() -> None:
    for program in started(scene="a.ply", sensors="true").values():
        assert program.remappings["gaussians"] == "gaussians"
        assert program.sim_time is False
    bag = started(topic="/robot/map", use_sim_time="true", sorter="true")
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
    for name in FAST_DDS_WISHES:
        monkeypatch.delenv(name, raising=False)
    for room, profile in ((2 << 30, "rosplat_msgs/config/fastdds.xml"), (64 << 20, "")):
        free = SimpleNamespace(free=room)
        monkeypatch.setattr("shutil.disk_usage", lambda path, free=free: free)
        for program in started(scene="a.ply").values():
            assert program.profile.endswith(profile)
            assert bool(program.profile) == bool(profile)
        assert PROFILE not in os.environ


def test_each_robot_s_map_is_in_its_namespace_and_its_frame() -> None:
    scenes = "{robot1: 'it is mine.ply', /team/robot2: town/lod-meta.json}"
    robots = started(launch=ROBOTS, scenes=scenes, sorter="true", compression="quantised")
    assert set(robots) == {
        "/robot1/ply_publisher", "/robot1/sorter", "/team/robot2/stream_publisher",
        "/team/robot2/sorter",
    }  # fmt: skip
    assert robots["/robot1/ply_publisher"].parameters == {
        "path": "it is mine.ply", "frame_id": "robot1/map", "compression": "quantised",
    }  # fmt: skip
    streamed = robots["/team/robot2/stream_publisher"].parameters
    assert (streamed["frame_id"], streamed["max_splats"]) == ("team/robot2/map", 2000000)
    assert set(started(launch=ROBOTS, scenes="{a: 7}")) == {"/a/ply_publisher"}


@pytest.mark.parametrize("scenes", ["", "a.ply", "{robot1: }", "{robot1"])
def test_scenes_of_no_robot_are_an_error(scenes: str) -> None:
    with pytest.raises(ValueError, match=r"scenes: expected \{robot1: a.ply"):
        started(launch=ROBOTS, scenes=scenes)


def test_a_recorder_keeps_all_of_the_map_and_has_it_sent_once() -> None:
    from launch.events.process import ProcessStderr
    from launch.utilities import perform_substitutions

    (told, _), (recorder, context) = actions_of(RECORD, topic="/robot1/gaussians", output="bag")
    words = [perform_substitutions(context, word) for word in recorder.cmd]
    assert words[:3] == ["ros2", "bag", "record"]
    assert words[words.index("--output") + 1] == "bag"
    excluded = re.compile(next(word for word in words if "view|order" in word))
    for left_out in ("/robot1/gaussians/view", "/robot1/gaussians/order", "/gaussians/order"):
        assert excluded.search(left_out)
    for kept in ("/robot1/gaussians", "/camera/view", "/planner/order"):
        assert not excluded.search(kept)
    qos = yaml.safe_load(Path(words[words.index("--qos-profile-overrides-path") + 1]).read_text())
    assert qos.keys() == {"/robot1/gaussians"}
    assert (qos["/robot1/gaussians"]["depth"], qos["/robot1/gaussians"]["durability"]) == (
        1000, "transient_local",
    )  # fmt: skip

    def said(text: str) -> list[str]:
        event = ProcessStderr(
            text=text.encode(), action=recorder, name="", cmd=[], cwd=None, env=None, pid=1
        )
        assert told.event_handler.matches(event)
        calls = told.event_handler.handle(event, context) or []
        return [perform_substitutions(context, word) for call in calls for word in call.cmd]

    assert not said("[INFO] [rosbag2_recorder]: Subscribed to topic '/robot1/gaussians/picked'")
    subscribed = "[INFO] [rosbag2_recorder]: Subscribed to topic '/robot1/gaussians'"
    assert said(subscribed)[:4] == ["ros2", "service", "call", "/robot1/gaussians/repeat"]
    assert not said(subscribed)
    assert len(list(actions_of(RECORD, repeat="false"))) == 1


@pytest.mark.parametrize("said", [{"sorter": "perhaps"}, {"max_splats": "many"}])
def test_an_argument_that_makes_no_sense_is_named(said: dict[str, str]) -> None:
    ((name, value),) = said.items()
    with pytest.raises(ValueError, match=f"{name}: expected .*, got '{value}'"):
        started(launch=ROBOTS, scenes="{robot1: a.ply}", **said)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_what_a_launch_starts_ends_with_it(number: signal.Signals) -> None:
    command = ["ros2", "launch", str(ROBOTS), "scenes:={ended: 'procedural:100'}"]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as launch:
        children = Path(f"/proc/{launch.pid}/task/{launch.pid}/children")

        def publishers() -> list[Path]:
            of = [Path(f"/proc/{pid}") for pid in children.read_text().split()]
            return [each for each in of if b"ply_publisher" in (each / "cmdline").read_bytes()]

        try:
            until(publishers)
            (publisher,) = publishers()
        finally:
            launch.send_signal(number)
            launch.wait(PATIENCE)
    until(lambda: not publisher.exists())


def until(reached: Callable[[], object]) -> None:
    deadline = time.monotonic() + PATIENCE
    while not reached():
        assert time.monotonic() < deadline
        time.sleep(0.05)
