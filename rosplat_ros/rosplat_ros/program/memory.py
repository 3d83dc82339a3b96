"""How a program takes less memory."""

from __future__ import annotations

import ctypes
import os
from pathlib import Path

_M_MMAP_THRESHOLD = -3  # of malloc.h
_LARGE = 1 << 20  # [bytes]


def give_back_large_blocks() -> None:
    """Makes blocks larger than 1 MiB go back to the system when they are freed. For programs.

    By default, glibc puts blocks up to the largest one freed so far into heaps, where small blocks
    between messages of megabytes keep these from going back: programs grow as long as they run.
    """
    ctypes.CDLL(None).mallopt(_M_MMAP_THRESHOLD, _LARGE)


def resident_bytes() -> int:
    """Memory that this process has in RAM. [bytes]"""
    pages = Path("/proc/self/statm").read_text().split()[1]  # proc(5)
    return int(pages) * os.sysconf("SC_PAGE_SIZE")
