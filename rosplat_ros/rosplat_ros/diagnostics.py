"""A node's reports on /diagnostics, one each second.

They have the form that diagnostic_updater, which isn't on PyPI, gives them. All nodes use the same
words for the same figures: docs/reference.md lists them.
"""

from __future__ import annotations

import platform
from collections.abc import Callable, Mapping
from typing import NamedTuple

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.exceptions import InvalidHandle
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions

from rosplat_core.program.machine import resident_bytes

PERIOD = 1.0  # [s]


class Report(NamedTuple):
    """The state of a node, or of a part of it."""

    message: str
    """In a few words."""
    values: Mapping[str, object]
    """Figures by name, with the unit in the name: {"Splats": 500, "Age (s)": 0.25}."""
    warns: bool = False
    """Whether somebody should look into it."""


class Diagnostics:
    """Publishes what `report` says, as the status "<node>: <task>".

    In a node's __init__: Diagnostics(self, "camera", lambda: Report("draws", {"Pictures": 12})).
    """

    def __init__(
        self, node: Node, task: str, report: Callable[[], Report], spun: Node | None = None
    ) -> None:
        """spun: the node whose executor asks for reports, where that isn't `node` itself."""
        self._node, self._report, self._spun = node, report, spun or node
        name = node.get_fully_qualified_name().lstrip("/")
        self._status = DiagnosticStatus(name=f"{name}: {task}", hardware_id=platform.node())
        self._publisher = node.create_publisher(
            DiagnosticArray,
            "/diagnostics",
            QoSProfile(depth=1),
            qos_overriding_options=QoSOverridingOptions.with_default_policies(),
        )
        steady = Clock(clock_type=ClockType.STEADY_TIME)  # simulated time may stand still
        self._timer = self._spun.create_timer(PERIOD, self._on_timer, clock=steady)

    def close(self) -> None:
        """Ends the reports. Call it while the spun node's executor can't be at one."""
        self._spun.destroy_timer(self._timer)
        self._node.destroy_publisher(self._publisher)

    def _on_timer(self) -> None:
        try:
            self._publish()
        except InvalidHandle:  # the node was destroyed
            self._timer.cancel()
        except Exception:
            if self._node.context.ok():  # else ROS has ended meanwhile
                raise

    def _publish(self) -> None:
        message, values, warns = self._report()
        self._status.level = DiagnosticStatus.WARN if warns else DiagnosticStatus.OK
        self._status.message = message
        figures = {**values, "Memory (bytes)": resident_bytes()}
        self._status.values = [KeyValue(key=key, value=str(figures[key])) for key in figures]
        array = DiagnosticArray(status=[self._status])
        array.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(array)
