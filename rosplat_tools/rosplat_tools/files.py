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


def write_below(path: Path, above: str, mark: str, text: str) -> None:
    """Writes mark and text in place of what a text file in UTF-8 has from the mark on.

    What stands above it there, written by hand, stays; without file or mark, `above` does.
    """
    if path.is_file():
        before, found, _ = path.read_text(encoding="utf-8").partition(mark)
        above = before if found else above
    write_text(path, above + mark + text)
