"""The stand-in for the command ros2."""

from __future__ import annotations

import subprocess
import sys
import time
from argparse import Namespace
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo
from std_msgs.msg import Float64MultiArray

from rosplat_core.splats import InputError
from rosplat_ros.program import ros2
from rosplat_ros.program.parameters import declare
from rosplat_ros.program.running import spinning
from rosplat_testing import PATIENCE


def said(*words: str) -> str:
    """What the command prints, in a process of its own."""
    command = [sys.executable, "-c", "from rosplat_ros.program.ros2 import main; exit(main())"]
    done = subprocess.run(
        [*command, *words], capture_output=True, text=True, timeout=PATIENCE, check=False
    )
    return done.stdout + done.stderr


def said_at_last(expected: str, words: tuple[str, ...]) -> str:
    """What the command prints once that has what is expected: a loaded machine discovers slowly."""
    end = time.monotonic() + PATIENCE
    while expected not in (printed := said(*words)) and time.monotonic() < end:
        pass
    assert expected in printed
    return printed


def test_run_becomes_a_package_s_program() -> None:
    assert said("run", "rosplat_tools", "inspect", "--help").startswith("usage: inspect ")
    assert "it has" in said("run", "rosplat_tools", "nothing")
    assert "nothing is not installed" in said("run", "nothing", "inspect")


def test_topics_nodes_and_parameters_are_told() -> None:
    import rclpy

    rclpy.init()
    node = Node("told")
    declare(node, "size", 7, "How large it is. [m]", 1, 9)
    publisher = node.create_publisher(Float64MultiArray, "numbers", 1)
    asked = {
        ("topic", "list", "-t"): "/numbers [std_msgs/msg/Float64MultiArray]",
        ("node", "list"): "/told",
        ("param", "list", "told"): "size",
        ("param", "get", "/told", "size"): "7",
        ("param", "describe", "told", "size"): "How large it is. [m]",
        ("param", "get", "told", "none"): "has no parameter",
        ("topic", "echo", "--once", "/numbers"): "data: <20 elements>",
    }
    with spinning(node), ThreadPoolExecutor(len(asked)) as pool:  # each waits for what is there
        node.create_timer(0.1, lambda: publisher.publish(Float64MultiArray(data=[1.0] * 20)))
        told = dict(zip(asked, pool.map(said_at_last, asked.values(), asked), strict=True))
    assert "size" in told["param", "list", "told"].splitlines()
    assert told["param", "get", "/told", "size"] == "7\n"
    assert told["topic", "echo", "--once", "/numbers"].rstrip().endswith("---")
    assert "nobody publishes /silence" in said("topic", "echo", "/silence")


def test_what_there_is_not_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        ros2.main(["--help"])
    assert "come with an installed ROS 2" in capsys.readouterr().out
    assert ros2.main(["launch", "rviz_gaussian_plugin", "view.launch.py"]) == 2
    assert "ros2: launch: it and others come with an installed" in capsys.readouterr().err


def test_a_topic_of_a_type_that_is_not_installed_is_named() -> None:
    graph: Any = SimpleNamespace(
        get_topic_names_and_types=lambda: [("/odd", ["gone_msgs/msg/Gone"])],
        get_publishers_info_by_topic=lambda topic: [],
    )
    with pytest.raises(InputError, match="gone_msgs/msg/Gone is of gone_msgs, which isn't install"):
        ros2.echo_topic(graph, Namespace(topic="odd", once=True))


def test_messages_are_lines_of_names_and_values() -> None:
    values = [KeyValue(key="fx", value="1"), KeyValue(key="fy", value="2")]
    status = DiagnosticStatus(level=DiagnosticStatus.OK, name="camera", values=values)
    lines = ros2.text_of(DiagnosticArray(status=[status])).splitlines()
    assert [line for line in lines if "level" in line or "key" in line] == [
        "- level: b'\\x00'", "  - key: fx", "  - key: fy",
    ]  # fmt: skip
    assert "r: [0.0, 0.0, " in ros2.text_of(CameraInfo())
