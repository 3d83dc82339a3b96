"""What a node says of mistakes that ROS ignores."""

from __future__ import annotations

import time
from typing import Any

import pytest
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from std_msgs.msg import String

from rosplat_msgs.msg import GaussianArray
from rosplat_ros import qos
from rosplat_ros.program import mistakes

PATIENCE = 60.0  # [s]


@pytest.mark.parametrize("simulated", [False, True])
def test_mistakes_are_said_once_each(simulated: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mistakes, "PERIOD", 0.05)
    context = rclpy.Context()
    rclpy.init(context=context)
    node = rclpy.create_node(
        "slam",
        namespace="/robot",
        context=context,
        parameter_overrides=[
            Parameter("pth", value="a.ply"),
            Parameter("qos_overrides./a.publisher.depth", value=3),
            Parameter("use_sim_time", value=simulated),
        ],
    )
    said: list[str] = []

    class Logger:
        warning = staticmethod(said.append)

    monkeypatch.setattr(node, "get_logger", Logger)
    node.declare_parameter("path", "")
    node.create_subscription(GaussianArray, "gaussians", lambda _: None, qos.MAP)
    node.create_publisher(GaussianArray, "gaussians", qos.MAP)
    watch: Any = mistakes.Mistakes(node)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)

    def spin(seconds: float, lines: int) -> None:
        deadline = time.monotonic() + PATIENCE
        while len(said) < lines:
            assert time.monotonic() < deadline
            executor.spin_once(0.1)
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            executor.spin_once(0.1)

    unknown = ["parameter pth: not known, ignored; known are path, use_sim_time"]
    clock = ["use_sim_time is true, but nobody publishes /clock"] * simulated
    spin(0.3, len(unknown + clock))
    assert said == unknown + clock
    other = rclpy.Context()  # a process has one type for a topic
    rclpy.init(context=other)
    talker = rclpy.create_node("talker", namespace="/robot", context=other)
    talker.create_publisher(String, "gaussians", 1)
    spin(0.3, len(unknown + clock) + 1)
    assert said[len(unknown + clock) :] == [
        "/robot/gaussians: somebody publishes std_msgs/msg/String, which isn't heard; "
        "expected rosplat_msgs/msg/GaussianArray"
    ]
    del watch
    executor.shutdown()
    for each in (node, talker):
        each.destroy_node()
        each.context.try_shutdown()
