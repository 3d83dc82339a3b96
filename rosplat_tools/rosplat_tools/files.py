"""Files that are there whole or not at all, whatever interrupts the writing."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Where the block is to write what then takes the path's place: a file beside it.

    A reader sees the old file or the new one. Where the block raises, the old one stays.
    """
    partial = path.with_name(f".{path.name}.part")
    try:
        yield partial
        partial.replace(path)
    finally:
        with contextlib.suppress(OSError):  # it was replaced, or its place is none
            partial.unlink()


def write_text(path: Path, text: str) -> None:
    """Writes a text in UTF-8 in place of the file, if any."""
    with replacing(path) as partial:
        partial.write_text(text, encoding="utf-8")
