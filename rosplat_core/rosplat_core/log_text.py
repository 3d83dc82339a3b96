"""Text from elsewhere, made safe for a line of a log."""

from __future__ import annotations


def shown(text: object, most: int = 100) -> str:
    """A peer's or an error's text, cut to `most` characters, with control characters escaped."""
    whole = str(text)
    escaped = (c if c.isprintable() else c.encode("unicode_escape").decode() for c in whole[:most])
    return "".join(escaped) + "…" * (len(whole) > most)


def counted(number: int, one: str, more: str) -> str:
    """A number and its noun: 1 batch, 2 batches."""
    return f"{number:,} {one if number == 1 else more}"
