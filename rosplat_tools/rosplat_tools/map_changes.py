"""What has changed in a map since when: what a client that pulls it lacks. Knows no ROS."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rosplat_core.slot_pages import PAGES, SLOTS_PER_PAGE, SlotPages, slots_of
from rosplat_tools.slot_map import Group, SlotMap, as_index


@dataclass(frozen=True, eq=False)
class Changed:
    """A part of what has changed: slots to empty first, uint32 (n,), then groups to write.

    next_page: the one to go on with, 0 where there are no more.
    """

    emptied: NDArray[np.uint32]
    groups: list[Group]
    next_page: int


class MapChanges:
    """The revision of the last change to each slot, and to each group's pose.

    Knows a map since a REPLACE, whose revision is `begun`: older clients need all of it.
    """

    def __init__(self, begun: int = 0) -> None:
        self.begun = begun
        self._pages = SlotPages()
        self._changed = np.zeros(0, np.uint32)  # of each row; no map sees 2^32 edits
        self._written = np.zeros(PAGES, np.uint32)  # the last of each page
        self._regrouped = np.zeros(PAGES, np.uint64)
        self._groups = np.full(PAGES, -1, np.int32)  # of each page, -1 before any
        self._placed: dict[int, int] = {}

    def write(self, slots: range | NDArray[np.integer], revision: int, group: int) -> None:
        """Notes that splats of a group were written."""
        pages = self._pages.touched(as_index(slots))
        self._pages.add(pages, 0)
        if self._pages.rows > len(self._changed):
            self._changed.resize(max(self._pages.rows, len(self._changed) * 9 // 8), refcheck=False)
        others = (self._groups[pages] >= 0) & (self._groups[pages] != group)
        self._regrouped[pages[others]] = revision
        self._groups[pages] = group
        self.clear(slots, revision)

    def clear(self, slots: range | NDArray[np.integer], revision: int) -> None:
        """Notes that slots were emptied."""
        self._changed[self._pages.find(as_index(slots))] = revision
        self._written[self._pages.touched(as_index(slots))] = revision

    def place(self, groups: list[int], revision: int) -> None:
        """Notes that groups were placed."""
        self._placed |= dict.fromkeys(groups, revision)

    def placed(self, after: int) -> list[int]:
        """The groups that were placed after a revision."""
        return [group for group, revision in self._placed.items() if revision > after]

    def since(self, after: int, first_page: int, slot_map: SlotMap, most_bytes: int) -> Changed:
        """What changed after a revision, in pages from first_page on, and is as slot_map has it.

        As many pages as take most_bytes, but one at least. For a client that has nothing, after 0,
        no slots are emptied.
        """
        size, next_page, changed = 0, 0, [np.zeros(0, np.int64)]
        for page in (np.flatnonzero(self._written[first_page:] > after) + first_page).tolist():
            first = page * SLOTS_PER_PAGE
            rows = self._pages.find(slice(first, first + SLOTS_PER_PAGE))
            within = np.flatnonzero(self._changed[rows] > after)
            size += len(within) * slot_map.splat_bytes
            if size > most_bytes and len(changed) > 1:
                next_page = page
                break
            changed.append(first + within)
        slots = np.concatenate(changed)
        used = slot_map.used(slots)
        emptied = np.zeros(0, np.uint32)
        if after:
            pages = np.unique(slots // SLOTS_PER_PAGE)
            regrouped = slots_of(pages[self._regrouped[pages] > after])
            emptied = np.union1d(slots[~used], regrouped).astype(np.uint32)
        return Changed(emptied, slot_map.groups(slots[used]), next_page)
