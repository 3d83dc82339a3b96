"""How a program's memory is given back."""

from __future__ import annotations

import ctypes
import os
from pathlib import Path

_M_MMAP_THRESHOLD = -3  # of malloc.h
_LARGE = 1 << 20  # [bytes]


def give_back_large_blocks() -> None:
    """Has what is larger than a mebibyte go back to the system when it is freed. For programs.

    As it comes, glibc keeps blocks as large as the largest that was freed so far in heaps, where
    small ones between messages of megabytes hold them: programs grow for as long as they run.
    """
    ctypes.CDLL(None).mallopt(_M_MMAP_THRESHOLD, _LARGE)


def resident_bytes() -> int:
    """Memory that this process has in RAM."""
    pages = Path("/proc/self/statm").read_text().split()[1]  # proc(5)
    return int(pages) * os.sysconf("SC_PAGE_SIZE")
