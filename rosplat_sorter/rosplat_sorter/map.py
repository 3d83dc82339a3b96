"""The map after its edits, as far as sorting needs it."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from rosplat_core._core import SortMap
from rosplat_core.slot_pages import SLOTS_PER_PAGE

# An index for NumPy: a range of rows, or an array of them.
Rows: TypeAlias = "slice | NDArray[np.int64]"

_WITHIN = np.arange(SLOTS_PER_PAGE, dtype=np.uint32)


class SplatMap(SortMap):
    """Positions and extents of splats, in rows, as the C++ map keeps them.

    Each page of neighbouring slots that was ever written has a row for each of its slots. Arrays
    are views of the map's memory, valid until the next batch.
    """

    @property
    def rows(self) -> int:
        """How many rows there are."""
        return len(self.extents)

    @property
    def changed_rows(self) -> Rows:
        """The rows that the last batch changed."""
        first, count = self.changed.T
        if len(first) == 1:
            return slice(int(first[0]), int(first[0] + count[0]))
        before = np.cumsum(count) - count
        rows: NDArray[np.int64] = np.arange(count.sum()) + np.repeat(first - before, count)
        return rows

    def by_place(self) -> tuple[NDArray[np.uint32], NDArray[np.uint32]]:
        """Each page's first slot and its group's index in frames, by place, uint32 (p,) each."""
        first_slots, groups = np.empty((2, len(self.pages)), np.uint32)
        slot, place, group = self.pages.T
        first_slots[place], groups[place] = slot, group
        return first_slots, groups

    def slots_and_groups(self) -> tuple[NDArray[np.uint32], NDArray[np.uint32]]:
        """Each row's slot and its group's index in frames, uint32 (rows,) each."""
        first_slots, groups = self.by_place()
        slots = (first_slots[:, None] + _WITHIN).ravel()
        return slots, np.repeat(groups, SLOTS_PER_PAGE)
