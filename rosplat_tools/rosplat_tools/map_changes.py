"""What has changed in a map since when: what a client that pulls it lacks. Knows no ROS."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rosplat_sorter.slot_pages import PAGES, SLOTS_PER_PAGE, slots_of
from rosplat_tools.slot_map import Group, SlotMap


@dataclass(frozen=True, eq=False)
class Changed:
    """A part of what has changed: slots to empty first, uint32 (n,), then groups to write.

    next_page: the one to go on with, 0 where there are no more.
    """

    emptied: NDArray[np.uint32]
    groups: list[Group]
    next_page: int


class MapChanges:
    """The revision of the last change to each page of slots, and to each group's pose.

    Knows a map since a REPLACE, whose revision is `begun`: older clients need all of it.
    """

    def __init__(self, begun: int = 0) -> None:
        self.begun = begun
        self._written = np.zeros(PAGES, np.uint64)
        self._regrouped = np.zeros(PAGES, np.uint64)
        self._groups = np.full(PAGES, -1, np.int32)  # of each page, -1 before any
        self._placed: dict[int, int] = {}

    def write(self, slots: range | NDArray[np.integer], revision: int, group: int) -> None:
        """Notes that splats of a group were written."""
        pages = _pages(slots)
        others = (self._groups[pages] >= 0) & (self._groups[pages] != group)
        self._regrouped[pages[others]] = revision
        self._groups[pages] = group
        self._written[pages] = revision

    def clear(self, slots: range | NDArray[np.integer], revision: int) -> None:
        """Notes that slots were emptied."""
        self._written[_pages(slots)] = revision

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
        used = slot_map.used_by_page()
        wanted = (used >= 0) & (self._written > after) if after else used > 0
        pages = np.flatnonzero(wanted[first_page:]) + first_page
        sizes = used[pages] * slot_map.splat_bytes
        if after:
            sizes += 4 * (SLOTS_PER_PAGE - used[pages])
        some = max(1, int(np.searchsorted(np.cumsum(sizes), most_bytes, "right")))
        next_page = int(pages[some]) if some < len(pages) else 0
        pages = pages[:some]
        emptied = np.zeros(0, np.uint32)
        if after:
            regrouped = slots_of(pages[self._regrouped[pages] > after])
            emptied = np.union1d(slot_map.unused(pages), regrouped).astype(np.uint32)
        return Changed(emptied, slot_map.groups(pages), next_page)


def _pages(slots: range | NDArray[np.integer]) -> NDArray[np.intp]:
    if not len(slots):
        return np.zeros(0, np.intp)
    if isinstance(slots, range):
        return np.arange(slots.start // SLOTS_PER_PAGE, (slots.stop - 1) // SLOTS_PER_PAGE + 1)
    return np.flatnonzero(np.bincount(slots // SLOTS_PER_PAGE))
