"""Slots of a map, given out by strips and taken back. Knows no ROS."""

from __future__ import annotations

import heapq
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from rosplat_core.slot_pages import MAX_SLOTS, SLOTS_PER_PAGE

SLOTS_PER_STRIP = 128  # a strip's unused slots are lost until it is given back
STRIPS_PER_PAGE = SLOTS_PER_PAGE // SLOTS_PER_STRIP

Number = TypeVar("Number", int, NDArray[np.int64])


def slots_for(count: Number) -> Number:
    """How many slots so many splats take: whole strips."""
    return -(-count // SLOTS_PER_STRIP) * SLOTS_PER_STRIP


class SlotAllocator:
    """Gives out whole pages, and for less than a page strips of shared pages.

    So pages hold neighbours, and few slots are lost to small sets of splats. The lowest free pages
    and strips come first: holes are used before the map grows.
    """

    def __init__(self, pages: int = MAX_SLOTS // SLOTS_PER_PAGE) -> None:
        self._pages = pages
        self._touched = 0  # pages below this have been given out once
        self._free_pages: list[int] = []  # a heap, as are the strips
        self._free_strips: list[int] = []  # of shared pages
        self._slots = 0

    @property
    def slots(self) -> int:
        """Number of slots that are given out, with the unused slots of their strips."""
        return self._slots

    def allocate(self, count: int) -> NDArray[np.uint32]:
        """(count,) slots in strips of their own. Raises MemoryError, and then takes none."""
        pages, rest = divmod(slots_for(count) // SLOTS_PER_STRIP, STRIPS_PER_PAGE)
        shared = rest > len(self._free_strips)  # whether one more page is shared from now on
        if pages + shared > self._pages - self._touched + len(self._free_pages):
            raise MemoryError(f"{count:,} slots: the map has no room for them")
        firsts = [STRIPS_PER_PAGE * self._page() for _ in range(pages)]
        strips = [first + strip for first in firsts for strip in range(STRIPS_PER_PAGE)]
        if shared:
            first = STRIPS_PER_PAGE * self._page()
            self._free_strips += range(first, first + STRIPS_PER_PAGE)
            heapq.heapify(self._free_strips)
        strips += [heapq.heappop(self._free_strips) for _ in range(rest)]
        self._slots += SLOTS_PER_STRIP * len(strips)
        starts = np.array(strips, np.uint32)[:, None] * SLOTS_PER_STRIP
        slots = starts + np.arange(SLOTS_PER_STRIP, dtype=np.uint32)
        return slots.astype(np.uint32).ravel()[:count]

    def give_back(self, slots: NDArray[np.uint32]) -> None:
        """Frees the strips of slots; of each allocate(), all slots or none."""
        strips = np.unique(slots // SLOTS_PER_STRIP)
        self._slots -= SLOTS_PER_STRIP * len(strips)
        pages, counts = np.unique(strips // STRIPS_PER_PAGE, return_counts=True)
        whole = pages[counts == STRIPS_PER_PAGE]
        for page in whole.tolist():
            heapq.heappush(self._free_pages, page)
        for strip in strips[~np.isin(strips // STRIPS_PER_PAGE, whole)].tolist():
            heapq.heappush(self._free_strips, strip)

    def _page(self) -> int:
        if self._free_pages:
            return heapq.heappop(self._free_pages)
        self._touched += 1
        return self._touched - 1
