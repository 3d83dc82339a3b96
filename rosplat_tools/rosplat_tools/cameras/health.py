"""Troubles of a camera: logged when they begin, counted, and reported to /diagnostics."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager

from rosplat_core.log_text import shown
from rosplat_ros.diagnostics import Report
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
    """Counts troubles and pictures of one camera."""

    def __init__(self, name: str, warn: Callable[[str], object]) -> None:
        self.name = name
        self._problem = SaidOnce(lambda text: warn(f"{name}: {text}"))
        self.counts: Counter[str] = Counter()
        self.latency = self.drawing = 0.0  # of the last picture [s]
        self.figures: Mapping[str, object] = {}
        """Further values of the last picture, for /diagnostics."""

    def trouble(self, kind: str, text: object) -> None:
        """Counts a picture that can't be had, by the kind of reason, and logs the text."""
        self.counts[kind] += 1
        self._problem.say(str(text))

    def silence(self, text: str) -> None:
        """Logs that nothing has come to make a picture of; counts nothing."""
        self._problem.say(text)

    def well(self, latency: float, drawing: float) -> None:
        """Counts a picture. latency: since its stamp; drawing: since its drawing began. [s]"""
        self.counts["pictures"] += 1
        self.latency, self.drawing = latency, drawing
        self._problem.say("")

    def report(self) -> Report:
        """For /diagnostics."""
        figures = {
            "Latency (s)": round(self.latency, 4),
            "Drawing (s)": round(self.drawing, 4),
            **self.figures,
            **{kind.capitalize(): count for kind, count in self.counts.items()},
        }
        problem = self._problem.now
        return Report(problem or "pictures come", figures, warns=bool(problem))
