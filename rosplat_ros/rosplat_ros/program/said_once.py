"""Logs trouble when it begins, not each time."""

from __future__ import annotations

import re
from collections.abc import Callable


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
