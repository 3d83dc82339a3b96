"""What goes into a line of a log."""

from __future__ import annotations


def shown(text: object, most: int = 100) -> str:
    """What a peer sent, or an error says of it: cut, and without control characters."""
    whole = str(text)
    line = "".join(c if c.isprintable() else _escaped(c) for c in whole[:most])
    return line + "…" * (len(whole) > most)


def _escaped(character: str) -> str:
    return character.encode("unicode_escape").decode()
