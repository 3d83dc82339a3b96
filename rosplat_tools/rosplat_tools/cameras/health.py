"""What goes wrong with a camera: said when it begins, counted, and told to /diagnostics."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable

from rclpy.clock import Clock, ClockType
from rclpy.node import Node

# The wheels of PyPI don't have it.
try:
    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
except ImportError:
    DiagnosticArray = None

PERIOD = 1.0  # [s]


class NoPicture(Exception):
    """Why there is none: a kind of reason to count, and a line to say."""

    def __init__(self, kind: str, text: object) -> None:
        super().__init__(str(text))
        self.kind = kind


class Health:
    """Of one camera. What goes wrong in one way again and again is said once, until it goes well.

    One way: the same words, whatever numbers are in them.
    """

    def __init__(self, name: str, warn: Callable[[str], None]) -> None:
        self.name, self._warn = name, warn
        self.problem = ""
        self._said: set[str] = set()
        self.counts: Counter[str] = Counter()
        self.latency = self.drawing = 0.0  # of the last picture [s]

    def trouble(self, kind: str, text: object) -> None:
        """There is no picture, for a kind of reason."""
        self.counts[kind] += 1
        self.problem = str(text)
        words = re.sub(r"[0-9.,-]+", "", self.problem)
        if words not in self._said:
            self._said.add(words)
            self._warn(f"{self.name}: {text}")

    def well(self, latency: float, drawing: float) -> None:
        """A picture went out, so long after its moment, and after it began to be drawn. [s]"""
        self.counts["pictures"] += 1
        self.latency, self.drawing = latency, drawing
        self.problem = ""
        self._said.clear()


class Diagnostics:
    """Publishes the health of cameras on /diagnostics, once a second."""

    def __init__(self, node: Node, cameras: list[Health]) -> None:
        self._node, self._cameras = node, cameras
        if DiagnosticArray is None:
            node.get_logger().info("no diagnostic_msgs here: /diagnostics is left out")
            return
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", 10)
        node.create_timer(PERIOD, self._publish, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _publish(self) -> None:
        message = DiagnosticArray(status=[self._status(camera) for camera in self._cameras])
        message.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(message)

    def _status(self, camera: Health) -> DiagnosticStatus:
        values = {"latency [ms]": f"{camera.latency * 1e3:.1f}"}
        values |= {"drawing [ms]": f"{camera.drawing * 1e3:.1f}"}
        values |= {kind: str(count) for kind, count in camera.counts.items()}
        return DiagnosticStatus(
            level=DiagnosticStatus.WARN if camera.problem else DiagnosticStatus.OK,
            name=f"{self._node.get_name()}: {camera.name}",
            message=camera.problem or "pictures come",
            values=[KeyValue(key=key, value=value) for key, value in values.items()],
        )
