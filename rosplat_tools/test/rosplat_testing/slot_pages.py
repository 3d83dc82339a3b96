"""Where a map's slots are kept. Authors number them as they like, keyframe << 12 | i say."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from rosplat_core.slot_pages import MAX_SLOTS, SLOTS_PER_PAGE

PAGES = MAX_SLOTS // SLOTS_PER_PAGE

# As NumPy indexes with them: a range, or one by one.
Slots: TypeAlias = "slice | NDArray[np.integer]"
Rows: TypeAlias = "slice | NDArray[np.int64]"

_WITHIN = np.arange(SLOTS_PER_PAGE)


class MixedGroupsError(ValueError):
    """Splats of one group for a page that holds splats of another."""


class SlotPages:
    """Pages of neighbouring slots, of which at least one was written, and where each is kept.

    Whoever holds a map has a row for each slot of these pages alone, page by page as they came. Of
    a map whose slots are filled one after the other, row i is slot i. All splats of a page are of
    one group.
    """

    def __init__(self) -> None:
        self._places = np.full(PAGES, -1, np.int64)  # of each page, or -1
        self._groups = np.zeros(len(self._places), np.uint32)
        self._count = 0
        self._list()

    def __len__(self) -> int:
        return self._count

    @property
    def rows(self) -> int:
        """How many rows the pages take."""
        return self._count * SLOTS_PER_PAGE

    def touched(self, slots: Slots) -> NDArray[np.int64]:
        """The pages of slots, ascending."""
        if isinstance(slots, slice):
            return np.arange(*_span(slots))
        wanted = np.zeros(len(self._places), bool)
        wanted[slots // SLOTS_PER_PAGE] = True
        return np.flatnonzero(wanted)

    def lacking(self, pages: NDArray[np.int64]) -> NDArray[np.int64]:
        """Those of some pages that there are no rows for yet."""
        return pages[self._places[pages] < 0]

    def check(
        self, pages: NDArray[np.int64], group: int, holds: Callable[[slice], np.bool_]
    ) -> None:
        """Raises MixedGroupsError where splats of a group may not be written to some pages.

        holds: whether there is a splat in any of a page's rows.
        """
        for page in pages[(self._places[pages] >= 0) & (self._groups[pages] != group)].tolist():
            row = int(self._places[page]) * SLOTS_PER_PAGE
            if holds(slice(row, row + SLOTS_PER_PAGE)):
                first = page * SLOTS_PER_PAGE
                raise MixedGroupsError(
                    f"slots {first} to {first + SLOTS_PER_PAGE - 1} hold splats of group "
                    f"{self._groups[page]}, this batch is of group {group}: delete them first"
                )

    def add(self, pages: NDArray[np.int64], group: int) -> None:
        """Gives some pages to a group, and rows to those that have none, behind those there are."""
        fresh = self.lacking(pages)
        if not len(fresh) and (self._groups[pages] == group).all():
            return
        self._places[fresh] = np.arange(self._count, self._count + len(fresh))
        self._groups[pages] = group
        self._count += len(fresh)
        self._list()

    def _list(self) -> None:
        pages = np.flatnonzero(self._places >= 0)
        places = self._places[pages]
        first_slots = (pages * SLOTS_PER_PAGE).astype(np.uint32)
        self.groups, which = np.unique(self._groups[pages], return_inverse=True)
        """The groups that have pages, ascending, uint32 (g,)."""
        self.table = np.stack([first_slots, places, which], axis=1).astype(np.uint32)
        """By ascending slots: each page's first slot, its place, and which of groups it is of,
        uint32 (p, 3)."""
        self.first_slots = np.empty(self._count, np.uint32)
        """The first slot of each page by place, uint32 (p,)."""
        self.first_slots[places] = first_slots
        self.group_of = np.empty(self._count, np.int64)
        """Which of groups each page is of by place, int64 (p,)."""
        self.group_of[places] = which
        self.ascending = bool((np.diff(places) == 1).all())
        """Whether rows ascend with slots."""

    def find(self, slots: Slots) -> Rows:
        """The rows of slots, in their order but without those that have none."""
        if isinstance(slots, slice):
            return self._find_range(slots)
        return self._rows(slots[self._places[slots // SLOTS_PER_PAGE] >= 0])

    def _rows(self, slots: NDArray[np.integer]) -> NDArray[np.int64]:
        rows: NDArray[np.int64] = self._places[slots // SLOTS_PER_PAGE] * SLOTS_PER_PAGE
        rows += slots % SLOTS_PER_PAGE
        return rows

    def _find_range(self, slots: slice) -> Rows:
        if slots.start >= slots.stop:
            return slice(0, 0)
        first, end = _span(slots)
        places = self._places[first:end]
        if (places >= 0).all() and (np.diff(places) == 1).all():
            row = int(places[0]) * SLOTS_PER_PAGE + slots.start % SLOTS_PER_PAGE
            return slice(row, row + slots.stop - slots.start)
        named = slots_of(np.arange(first, end)[places >= 0])
        kept = (named >= slots.start) & (named < slots.stop)
        return self._rows(named[kept])

    def groups_of(self, rows: NDArray[np.int64]) -> NDArray[np.int64]:
        """Which of groups rows are of."""
        return self.group_of[rows // SLOTS_PER_PAGE]

    def slots(self, rows: NDArray[np.int64]) -> NDArray[np.uint32]:
        """The slots of rows."""
        within = (rows % SLOTS_PER_PAGE).astype(np.uint32)
        return self.first_slots[rows // SLOTS_PER_PAGE] + within


def slots_of(pages: NDArray[np.integer]) -> NDArray[np.integer]:
    """All slots of some pages."""
    slots: NDArray[np.integer] = (pages[:, None] * SLOTS_PER_PAGE + _WITHIN).ravel()
    return slots


def _span(slots: slice) -> tuple[int, int]:
    """The first page of a range of slots, and one past the last."""
    if slots.start >= slots.stop:
        return 0, 0
    return slots.start // SLOTS_PER_PAGE, (slots.stop - 1) // SLOTS_PER_PAGE + 1
