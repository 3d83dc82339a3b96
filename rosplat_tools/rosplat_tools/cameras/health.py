"""Troubles of a camera: logged when they begin, counted, and reported to /diagnostics."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

from rclpy.node import Node

from rosplat_core.log_text import shown
from rosplat_ros.diagnostics import Diagnostics, Report
from rosplat_ros.program.said_once import SaidOnce


class NoPicture(Exception):
    """Why there is no picture: a kind of reason to count, and a line to log."""

    def __init__(self, kind: str, text: object) -> None:
        super().__init__(str(text))
        self.kind = kind


@contextmanager
def drawn(kind: str = "not drawn") -> Iterator[None]:
    """Within, what can't be drawn raises NoPicture of this kind."""
    try:
        yield
    except (ValueError, RuntimeError, MemoryError) as error:
        raise NoPicture(kind, shown(error, 300) or "out of memory") from error


class Health:
    """Counts troubles and pictures of one camera, and reports them to /diagnostics."""

    def __init__(self, node: Node, name: str) -> None:
        self._node = node
        self._problem = SaidOnce(lambda text: node.get_logger().warning(f"{name}: {text}"))
        self.counts: Counter[str] = Counter()
        self._latency = self._drawing = 0.0  # of the last picture [s]
        self.figures: Mapping[str, object] = {}
        """Further values of the last picture, for /diagnostics."""
        Diagnostics(node, name, self._report)

    def trouble(self, kind: str, text: object) -> None:
        """Counts a picture that can't be had, by the kind of reason, and logs the text."""
        self.counts[kind] += 1
        self._problem.say(str(text))

    def silence(self, text: str) -> None:
        """Logs that nothing has come to make a picture of; counts nothing."""
        self._problem.say(text)

    def well(self, stamp: int, began: float) -> None:
        """Counts a picture. began: when its drawing did, of time.perf_counter()."""
        self.counts["pictures"] += 1
        self._drawing = time.perf_counter() - began
        self._latency = 1e-9 * (self._node.get_clock().now().nanoseconds - stamp)
        self._problem.say("")

    def _report(self) -> Report:
        figures = {
            "Latency (s)": round(self._latency, 4),
            "Drawing (s)": round(self._drawing, 4),
            **self.figures,
            **{kind.capitalize(): count for kind, count in self.counts.items()},
        }
        problem = self._problem.now
        return Report(problem or "pictures come", figures, warns=bool(problem))
