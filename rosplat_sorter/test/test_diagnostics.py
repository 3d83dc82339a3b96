"""What nodes say of themselves on /diagnostics."""

from __future__ import annotations

import time
import uuid
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from rosplat_msgs.msg import GaussianArray, ViewCamera
from rosplat_ros import qos
from rosplat_ros.diagnostics import Diagnostics, Report
from rosplat_sorter.node import SorterNode

PATIENCE = 60.0  # [s]


@pytest.fixture
def node() -> Iterator[Node]:
    context = rclpy.Context()
    rclpy.init(context=context)
    made = rclpy.create_node("slam", namespace="/robot", context=context)
    yield made
    made.destroy_node()
    context.try_shutdown()


def spin(node: Node, until: Callable[[], object]) -> None:
    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    deadline = time.monotonic() + PATIENCE
    while not until():
        assert time.monotonic() < deadline
        executor.spin_once(0.1)
    executor.shutdown()


def test_a_report_is_a_status_each_second(node: Node) -> None:
    """In diagnostic_updater's form: names without a leading slash, levels, words and values."""
    heard: list[DiagnosticStatus] = []
    node.create_subscription(
        DiagnosticArray,
        "/diagnostics",
        lambda array: heard.extend(s for s in array.status if s.name == "robot/slam: camera"),
        10,
    )
    pictures = iter(range(9))
    diagnostics = Diagnostics(
        node,
        "camera",
        lambda: Report("draws", {"Pictures": (count := next(pictures))}, warns=count == 1),
    )
    spin(node, lambda: len(heard) == 2)
    first, second = heard
    assert (first.level, second.level) == (DiagnosticStatus.OK, DiagnosticStatus.WARN)
    assert first.message == "draws" and first.hardware_id
    values = {value.key: value.value for value in first.values}
    assert values["Pictures"] == "0"
    assert int(values["Memory (bytes)"]) > 1e6
    diagnostics.close()
    assert not node.count_publishers("/diagnostics")


def test_the_sorter_tells_of_its_work(make_batch: Callable[..., Any], make_look: Any) -> None:
    """What it lost is a warning in the second after, and a figure from then on."""
    name = f"/test_{uuid.uuid4().hex}"
    rclpy.init(args=["--ros-args", "-r", f"__ns:={name}"])
    sorter, peer = SorterNode(), rclpy.create_node("peer")
    heard: list[DiagnosticStatus] = []
    peer.create_subscription(
        DiagnosticArray, "/diagnostics", lambda array: heard.extend(array.status), 10
    )
    edits = peer.create_publisher(GaussianArray, "gaussians", qos.MAP)
    views = peer.create_publisher(ViewCamera, "gaussians/view", qos.VIEW)
    executor = SingleThreadedExecutor()
    for node in (sorter, peer):
        executor.add_node(node)

    def wait(message: str) -> dict[str, str]:
        deadline = time.monotonic() + PATIENCE
        while True:
            assert time.monotonic() < deadline, message
            executor.spin_once(0.1)
            for status in heard:
                if (status.name, status.message) == (
                    f"{name[1:]}/sorter: {name}/gaussians",
                    message,
                ):
                    heard.clear()
                    assert status.level == (b"\1" if "dropped" in message else b"\0")
                    return {value.key: value.value for value in status.values}

    try:
        assert wait("no view wants an order").keys() == {"Memory (bytes)"}
        edits.publish(make_batch(4, operation=GaussianArray.REPLACE))
        views.publish(make_look())
        while (values := wait("sorts"))["Splats"] != "4":
            pass
        assert (values["Map"], values["Revision"], values["Views"]) == ("map", "1", "1")
        assert values["Backend"] and float(values["Age (s)"]) < PATIENCE
        edits.publish(make_batch(2, revision=2, positions=[0.0]))
        assert wait("batches, splats or views were dropped")["Batches dropped"] == "1"
        assert wait("sorts")["Batches dropped"] == "1"
    finally:
        executor.shutdown()
        sorter.destroy_node()
        rclpy.shutdown()
