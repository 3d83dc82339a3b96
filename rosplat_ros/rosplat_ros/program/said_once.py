"""Logs trouble when it begins, or now and then, not each time."""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from typing import Any

THROTTLE = 5.0  # least time between two lines of the log of one kind [s]


def words_of(text: str) -> str:
    """A text without its numbers."""
    return re.sub(r"[0-9.,-]+", "", text)


class SaidOnce:
    """Logs what is wrong. The same words, whatever their numbers, are logged once until all is
    well.
    """

    def __init__(self, warn: Callable[[str], object]) -> None:
        self.now = ""
        """What is wrong now; empty: nothing."""
        self._warn = warn
        self._said: set[str] = set()

    def say(self, text: str) -> None:
        """Takes what is wrong; empty: all is well."""
        self.now = text
        words = words_of(text)
        if not text:
            self._said.clear()
        elif words not in self._said:
            self._said.add(words)
            self._warn(text)


class Throttled:
    """Logs a line of each kind at most once in THROTTLE. (rclpy throttles by the line of code.)"""

    def __init__(self, logger: Any) -> None:
        self._logger = logger
        self._said: dict[str, float] = {}

    def inform(self, kind: str, text: str) -> None:
        """Logs a line, unless one of its kind was just logged."""
        if self._take_turn(f"info {kind}"):
            self._logger.info(text)

    def warn(self, kind: str, text: str) -> None:
        """Logs a warning, likewise."""
        if self._take_turn(kind):
            self._logger.warning(text)

    def _take_turn(self, kind: str) -> bool:
        """Returns whether a kind may be logged now; it then rests."""
        now = time.monotonic()
        rests = now - self._said.get(kind, -THROTTLE) < THROTTLE
        if not rests:
            self._said[kind] = now
        return not rests
