"""What nodes say on /diagnostics, and what the reference says of it."""

from __future__ import annotations

import re
import time
from pathlib import Path

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.executors import SingleThreadedExecutor

from rosplat_core.generated import generate
from rosplat_msgs.msg import ViewCamera
from rosplat_ros.map_publisher import MapPublisher
from rosplat_ros.qos import VIEW
from rosplat_sorter.node import SorterNode
from rosplat_tools.obstacles.occupancy import Occupancy

ROOT = Path(__file__).resolve().parents[1]
PATIENCE = 60.0  # [s]
OF_THE_DISPLAY = {"GPU memory (bytes)"}  # whose words test_rviz_status.py holds to the same


def test_all_use_the_words_of_the_reference_and_no_others() -> None:
    rclpy.init()
    sorter, occupancy, slam = SorterNode(), Occupancy(), rclpy.create_node("slam")
    heard: dict[str, set[str]] = {}

    def hear(array: DiagnosticArray) -> None:
        for status in array.status:
            heard.setdefault(status.name, set()).update(value.key for value in status.values)

    slam.create_subscription(DiagnosticArray, "/diagnostics", hear, 10)
    views = slam.create_publisher(ViewCamera, "gaussians/view", VIEW)
    executor = SingleThreadedExecutor()
    for node in (sorter, occupancy, slam):
        executor.add_node(node)
    try:
        with MapPublisher(slam) as publisher:
            publisher.replace(generate(100))
            until = time.monotonic() + PATIENCE
            while "Backend" not in heard.get("sorter: /gaussians", ()) or len(heard) < 3:
                assert time.monotonic() < until
                views.publish(ViewCamera(view_id="view", sequence=1))
                executor.spin_once(0.1)
    finally:
        executor.shutdown()
        sorter.destroy_node()
        occupancy.destroy_node()
        rclpy.shutdown()
    section = (ROOT / "docs/reference.md").read_text().partition("## Diagnostics")[2]
    rows = re.findall(r"^\| ([A-Z][^|]+) \|", section.partition("\n## ")[0], re.MULTILINE)
    words = {word for row in rows for word in row.split(", ")}
    assert words == set().union(*heard.values(), OF_THE_DISPLAY)
