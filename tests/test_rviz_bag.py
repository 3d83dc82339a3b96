"""A bag of rosbag2 in a real rviz2: played, paused, looped and sought in."""

from __future__ import annotations

import contextlib
import importlib.util
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from rviz_harness import (
    Rviz,
    World,
    blue,
    centre,
    configuration,
    disc,
    map_display,
    needs_rviz,
    red,
)

pytestmark = [
    *needs_rviz,
    pytest.mark.skipif(
        not importlib.util.find_spec("ros2bag"), reason="no rosbag2: no bag is played"
    ),
]

EXCLUDED = "/gaussians/(view|order)$"  # as docs/guides/record.md has it
SIMULATED_TIME = ["--ros-args", "-p", "use_sim_time:=true"]
BLUE_COMES, RED_GOES, END = 2.0, 4.0, 6.0  # [s]


def way(seconds: float) -> float:
    """Where the map's frame has come to [m]."""
    return 0.5 * seconds - 1.5


def qos() -> list[str]:
    from ament_index_python.packages import get_package_share_directory

    file = Path(get_package_share_directory("rosplat_msgs")) / "config/rosbag2.yaml"
    return ["--qos-profile-overrides-path", str(file)]


def record(bag: Path) -> int:
    """A red disc that moves, a blue one later, then only that; returns when it began [ns]."""
    from rosplat_msgs.msg import ViewCamera
    from rosplat_ros.program.processes import Processes

    with contextlib.closing(World()) as robot, Processes(bag.parent) as processes:
        robot.node.create_publisher(ViewCamera, "/gaussians/view", 1)
        # One batch comes before the recorder, which has to ask for what was before it.
        robot.map.replace(disc((1, 0, 0), y=-0.5, sigma=0.2))
        processes.start(
            "recorder",
            ["ros2", "bag", "record", "-o", str(bag), *qos(), "-a", "--exclude-regex", EXCLUDED],
        )
        node = robot.node
        robot.place(stamp=node.get_clock().now().to_msg())

        def heard() -> bool:
            processes.check()
            return all(map(node.count_subscribers, ("/gaussians", "/tf")))

        robot.spin_until(heard)
        begin = node.get_clock().now().nanoseconds
        edits = [
            (BLUE_COMES, lambda: robot.map.upsert(range(1, 2), disc((0, 0, 1), y=0.5, sigma=0.2))),
            (RED_GOES, lambda: robot.map.delete(range(1))),
        ]
        while (seconds := (node.get_clock().now().nanoseconds - begin) / 1e9) < END:
            robot.place(x=way(seconds), stamp=node.get_clock().now().to_msg())
            while edits and seconds > edits[0][0]:
                edits.pop(0)[1]()
            time.sleep(0.02)
    return begin


@pytest.fixture
def remote() -> Iterator[World]:
    """Who tells the player what to do. Its own map is another: it would answer for the bag's."""
    import rclpy

    rclpy.init()
    with contextlib.closing(World(namespace="remote")) as remote:
        yield remote
    rclpy.shutdown()


def seen(picture: np.ndarray) -> tuple[bool, bool]:
    """Whether the red disc is there, and the blue one."""
    return red(picture).sum() > 300, blue(picture).sum() > 300


def test_a_bag_is_played_paused_looped_and_sought_in(tmp_path: Path, remote: World) -> None:
    from builtin_interfaces.msg import Time
    from rosbag2_interfaces.srv import Pause, Resume, Seek, SetRate

    begin = record(tmp_path / "bag")
    recorded = (tmp_path / "bag/metadata.yaml").read_text()
    assert "name: /gaussians\n" in recorded
    assert "/gaussians/view" not in recorded

    def command(kind: type, name: str, **request: object) -> None:
        client = remote.node.create_client(kind, f"/rosbag2_player/{name}")
        remote.spin_until(client.service_is_ready)
        answer = client.call_async(kind.Request(**request))
        remote.spin_until(answer.done)

    rviz = Rviz(tmp_path, *SIMULATED_TIME, config=configuration(map_display()))
    try:
        rviz.processes.node("rosplat_sorter", "sorter", *SIMULATED_TIME)
        play = ["ros2", "bag", "play", str(tmp_path / "bag"), *qos()]
        rviz.processes.start(
            "player",
            [*play, "--clock", "50", "--rate", "0.5", "--loop", "--disable-keyboard-controls"],
        )
        for _ in range(2):
            rviz.until(lambda s: seen(s) == (True, False))
            rviz.until(lambda s: seen(s) == (True, True))
            rviz.until(lambda s: seen(s) == (False, True))
        rviz.until_status("Map", "Map", "Ok", "1 splats")
        rviz.until_status("Map", "Order", "Ok", "sidecar")

        rviz.until(lambda s: seen(s) == (True, True))
        command(Pause, "pause")
        rviz.until_still()
        rviz.until_status("Map", "Transform", "Ok")
        command(Resume, "resume")

        rviz.until(lambda s: seen(s) == (False, True))
        command(SetRate, "set_rate", rate=0.1)  # or a slow machine misses what comes next
        to = begin + 10**9
        command(Seek, "seek", time=Time(sec=to // 10**9, nanosec=to % 10**9))
        # From the middle, what was before is not played: the map lacks it until it begins again.
        rviz.until(lambda s: seen(s)[1] and centre(blue(s))[1] < s.shape[1] / 2 - 20)
        rviz.until_status("Map", "Map", "Warn", "missing")
        command(SetRate, "set_rate", rate=1.0)
        rviz.until(lambda s: seen(s) == (True, False))
        rviz.until_status("Map", "Map", "Ok", "1 splats")
        rviz.until_status("Map", "Transform", "Ok")
    finally:
        rviz.close()
