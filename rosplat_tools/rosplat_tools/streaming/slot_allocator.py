"""Slots of a map, given out by whole pages and taken back. Knows no ROS."""

from __future__ import annotations

import heapq

import numpy as np
from numpy.typing import NDArray

from rosplat_sorter.slot_pages import MAX_SLOTS, SLOTS_PER_PAGE


class SlotAllocator:
    """Gives out the lowest pages that are free, so that holes are used before the map grows."""

    def __init__(self, pages: int = MAX_SLOTS // SLOTS_PER_PAGE) -> None:
        self._pages = pages
        self._used = 0  # pages below this have been given out once
        self._freed: list[int] = []  # a heap

    @property
    def slots(self) -> int:
        """How many slots are given out, with what is left of their pages."""
        return (self._used - len(self._freed)) * SLOTS_PER_PAGE

    def take(self, count: int) -> NDArray[np.uint32]:
        """(count,) slots, ascending, in pages of their own. Raises MemoryError; takes none then."""
        wanted = -(-count // SLOTS_PER_PAGE)
        if wanted > self._pages - self._used + len(self._freed):
            raise MemoryError(f"{count:,} slots: the map has no room for them")
        pages = [heapq.heappop(self._freed) for _ in range(min(wanted, len(self._freed)))]
        pages += range(self._used, self._used + wanted - len(pages))
        self._used = max(self._used, pages[-1] + 1 if pages else 0)
        first = np.array(pages, np.uint32)[:, None] * SLOTS_PER_PAGE
        slots: NDArray[np.uint32] = (first + np.arange(SLOTS_PER_PAGE, dtype=np.uint32)).ravel()
        return slots[:count]

    def give_back(self, slots: NDArray[np.uint32]) -> None:
        """Frees the pages of slots that were taken together."""
        for page in np.unique(slots // SLOTS_PER_PAGE).tolist():
            heapq.heappush(self._freed, page)
