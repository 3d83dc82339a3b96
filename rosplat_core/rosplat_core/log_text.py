"""Text from elsewhere, made safe for a line of a log."""

from __future__ import annotations


def shown(text: object, most: int = 100) -> str:
    """A peer's or an error's text, cut to `most` characters, with control characters escaped."""
    whole = str(text)
    line = "".join(c if c.isprintable() else _escaped(c) for c in whole[:most])
    return line + "…" * (len(whole) > most)


def counted(number: int, one: str, more: str) -> str:
    """A number and its noun: 1 batch, 2 batches."""
    return f"{number:,} {one if number == 1 else more}"


def _escaped(character: str) -> str:
    return character.encode("unicode_escape").decode()
