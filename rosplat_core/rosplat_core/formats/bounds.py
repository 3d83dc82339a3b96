"""Shared by readers: checks of a file's claims against its size, and errors of its fields."""

from __future__ import annotations

import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from rosplat_core.log_text import shown
from rosplat_core.slot_pages import MAX_SLOTS
from rosplat_core.splats import InputError

MAX_RATIO = 100  # of unpacked to packed size; real scenes unpack to 2 to 10 times their file
FREE = 1 << 24  # any file may unpack to this, however small it is [bytes]


def size_of(path: Path) -> int:
    """Size of a file [bytes]. Raises InputError for a pipe, a device or a folder: no file."""
    found = path.stat()
    if not stat.S_ISREG(found.st_mode):
        raise InputError(f"{path}: not a file")
    return found.st_size


def claim(path: Path, count: int, unpacked: int, held: int) -> None:
    """Raises InputError for more splats than a map can have, or than a file can hold.

    unpacked: size of `count` splats once decompressed, before they are decoded [bytes]. held: their
    size in the file [bytes].
    """
    if count > MAX_SLOTS:
        raise InputError(f"{path}: {count:,} splats; a map has at most {MAX_SLOTS:,}")
    if unpacked > unpackable(held):
        raise InputError(f"{path}: {count:,} splats can't be packed in {held:,} bytes")


@contextmanager
def refusing(what: str) -> Iterator[None]:
    """Turns errors that a field of a wrong kind causes into an InputError: `what` begins it."""
    try:
        with np.errstate(all="ignore"):  # what isn't finite is found later
            yield
    except InputError:
        raise
    except (
        ValueError, LookupError, TypeError, AttributeError, RecursionError, ArithmeticError,
    ) as error:  # fmt: skip
        kind = "it has no" if isinstance(error, KeyError) else f"{type(error).__name__}:"
        raise InputError(f"{what}: {shown(f'{kind} {error}')}") from error


@contextmanager
def naming_the_file(path: Path) -> Iterator[None]:
    """Turns errors of the system, or for want of memory, into an InputError that names the file."""
    if "\0" in str(path):  # Python's own functions fail on it in many ways
        raise InputError(f"{str(path)!r}: no name of a file")
    try:
        yield
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}") from error
    except MemoryError as error:
        raise InputError(f"{path}: too large for this machine's memory") from error


def unpackable(held: int) -> int:
    """The most bytes that so many may unpack to; a file that claims more is damaged, or a bomb."""
    return max(FREE, MAX_RATIO * held)
