"""How a program takes less memory."""

from __future__ import annotations

import ctypes

_M_MMAP_THRESHOLD = -3  # of malloc.h
_LARGE = 1 << 20  # [bytes]


def give_back_large_blocks() -> None:
    """Makes blocks larger than 1 MiB go back to the system when they are freed. For programs.

    By default, glibc puts blocks up to the largest one freed so far into heaps, where small blocks
    between messages of megabytes keep these from going back: programs grow as long as they run.
    """
    ctypes.CDLL(None).mallopt(_M_MMAP_THRESHOLD, _LARGE)
