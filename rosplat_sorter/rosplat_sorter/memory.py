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


def take_little_shared_memory() -> None:
    """Has Fast DDS take 4 MB, not 32, by the profile of rosplat_msgs. For programs without a map.

    Before ROS begins: that is when a process takes all of what it may send by.
    """
    for name in ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE"):
        profile = Path(os.environ.get(name, ""))
        if profile.name == "fastdds.xml" and profile.with_stem("fastdds_small").exists():
            os.environ[name] = str(profile.with_stem("fastdds_small"))


def resident_bytes() -> int:
    """Memory that this process has in RAM."""
    pages = Path("/proc/self/statm").read_text().split()[1]  # proc(5)
    return int(pages) * os.sysconf("SC_PAGE_SIZE")
