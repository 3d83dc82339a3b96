"""Orders in shared memory, as SplatOrder.msg describes them: the sorter's side."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import mmap
import os
import secrets
import struct
import uuid
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rosplat_core import _core

FOLDER = Path("/dev/shm")
PREFIX = "rosplat_order_"
MAGIC, VERSION = b"ROSPLAT\0", 1
HEADER_BYTES = 4096


class Memory(mmap.mmap):
    """A segment's memory, which a device may borrow for as long as the segment exists."""

    def __init__(self, *_: object) -> None:
        self.lent = contextlib.ExitStack()  # close() takes the memory back from devices


def memory_of(slots: NDArray[np.uint32]) -> Memory | None:
    """The memory of an array that Segment.begin() returned; None for any other array."""
    base = getattr(slots.base, "obj", slots.base)  # through a memoryview
    return base if isinstance(base, Memory) else None


class Segment:
    """A file in shared memory that holds one order at a time.

    The file appears whole and locked, and stays locked for as long as its sorter lives, so that the
    next sorter can tell what a crash has left behind.
    """

    def __init__(self, key: int, capacity: int) -> None:
        """Makes room for capacity slots. Raises OSError where there is none."""
        size = HEADER_BYTES + 4 * capacity
        room = os.statvfs(FOLDER)
        if room.f_bavail * room.f_frsize < 2 * size:  # DDS and others need some as well
            raise OSError(errno.ENOSPC, f"no room for {size >> 20} MiB in {FOLDER}")
        self.name = f"{PREFIX}{uuid.uuid4().hex}"
        self.capacity = capacity
        self._generation = 0
        self._file = os.open(FOLDER, os.O_TMPFILE | os.O_RDWR | os.O_CLOEXEC, 0o600)
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            os.posix_fallocate(self._file, 0, size)  # later, a full /dev/shm would kill the writer
            self._memory = Memory(self._file, size)
            self._memory[:24] = struct.pack("=8sIIQ", MAGIC, VERSION, 0, key)
            # An absolute path has no use for src_dir_fd, but without it Python links the symlink.
            os.link(f"/proc/self/fd/{self._file}", FOLDER / self.name, src_dir_fd=self._file)
        except OSError:
            os.close(self._file)
            raise

    def begin(self, count: int) -> NDArray[np.uint32]:
        """The array for the next order, uint32 (count,); the order before it becomes void."""
        _core.mark_segment(self._memory, self._generation + 1)
        return np.frombuffer(self._memory, np.uint32, count, HEADER_BYTES)

    def finish(self) -> int:
        """Marks the order as written; returns its generation."""
        self._generation += 2
        _core.mark_segment(self._memory, self._generation)
        return self._generation

    def remove(self) -> None:
        """Removes the file, and takes its memory from devices. Open readers may still read it."""
        self._memory.lent.close()
        (FOLDER / self.name).unlink(missing_ok=True)
        os.close(self._file)


class SharedOrders:
    """The segments of one run of a sorter, and the key in them that viewers read and send back."""

    def __init__(self) -> None:
        """Raises OSError where there is no shared memory."""
        remove_stale()
        self.key = secrets.randbits(63) + 1
        self._segments: list[Segment] = []
        self.probe = self.segment(0).name  # by which viewers find out whether they can read any

    def segment(self, capacity: int) -> Segment:
        """A new segment. Raises OSError where there is no room for it."""
        segment = Segment(self.key, capacity)
        self._segments.append(segment)
        return segment

    def remove(self, segment: Segment) -> None:
        """Removes a segment."""
        self._segments.remove(segment)
        segment.remove()

    def close(self) -> None:
        """Removes all segments."""
        for segment in self._segments:
            segment.remove()
        self._segments.clear()


class OrderBuffer:
    """The memory of one view's orders: two segments, written in turn.

    So an order stays while the next one is written, and a viewer has that time to copy it.
    """

    def __init__(self, orders: SharedOrders) -> None:
        self._orders = orders
        self._segments: list[Segment | None] = [None, None]
        self._turn = 0

    def begin(self, count: int) -> NDArray[np.uint32]:
        """The array for the view's next order, uint32 (count,). Raises OSError without room."""
        segment = self._segments[self._turn]
        if segment is None or segment.capacity < count:
            self._segments[self._turn] = None
            if segment:
                self._orders.remove(segment)
            segment = self._segments[self._turn] = self._orders.segment(count + count // 4)
        return segment.begin(count)

    def finish(self) -> tuple[str, int]:
        """Marks the order as written; returns its segment's name, and its generation."""
        segment = self._segments[self._turn]
        assert segment, "finish follows begin"
        self._turn = 1 - self._turn
        return segment.name, segment.finish()

    def close(self) -> None:
        """Removes the segments."""
        for segment in filter(None, self._segments):
            self._orders.remove(segment)


def remove_stale() -> None:
    """Removes the segments of sorters that ended without doing so."""
    for path in FOLDER.glob(f"{PREFIX}*"):
        with contextlib.suppress(OSError):  # another user's, or its sorter lives
            file = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                path.unlink()
            finally:
                os.close(file)
