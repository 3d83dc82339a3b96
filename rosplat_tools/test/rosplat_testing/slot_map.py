"""A map of Gaussians by slot in plain NumPy: what a stream of edits adds up to."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rosplat_core.channels import joined
from rosplat_core.payload import Arrays
from rosplat_core.splats import Splats, concatenate, sh_coefficients
from rosplat_msgs.msg import GaussianArray
from rosplat_testing.messages import decode, is_usable, poses_of
from rosplat_testing.slot_pages import SLOTS_PER_PAGE, SlotPages


@dataclass(frozen=True, eq=False)
class Group:
    """The splats of one group of a map, in its frame, and their slots."""

    group: int
    slots: range | NDArray[np.uint32]
    splats: Splats


class SlotMap:
    """Numbered slots that edits fill and empty, kept by pages of neighbours, in groups with poses.

    A group's origin is that of its first splats, the map's filter that of its. What no receiver
    would take is left out: a splat with a value that is not finite, a negative scale, or no
    orientation. poses: where groups were placed, float64 (4, 4).
    """

    def __init__(self, splats: Splats | None = None) -> None:
        """A map with a copy of splats in slots 0 to n - 1."""
        self.reset(splats)

    def reset(self, splats: Splats | None = None) -> None:
        """Forgets all, then writes splats to slots 0 to n - 1."""
        self._pages = SlotPages()
        self._arrays = _no_splats()
        self._used = np.zeros(0, bool)
        self._origins: dict[int, NDArray[np.float64]] = {}
        self.poses: dict[int, NDArray[np.float64]] = {}
        if splats is not None:
            self._reserve(0, splats.sh_degree)
            self.write(range(len(splats)), splats)

    def __len__(self) -> int:
        """Number of slots in use."""
        return int(np.count_nonzero(self._used))

    @property
    def sh_degree(self) -> int:
        """Highest band of spherical harmonics that was ever written."""
        return self._arrays.sh_degree

    @property
    def splat_bytes(self) -> int:
        """Memory that a splat takes. [bytes]"""
        return self._arrays.nbytes // max(1, len(self._used))

    def used(self, slots: NDArray[np.integer]) -> NDArray[np.bool_]:
        """Which of some slots, of pages that were written once, are in use."""
        used: NDArray[np.bool_] = self._used[self._pages.find(slots)]
        return used

    def write(self, slots: range | NDArray[np.integer], splats: Splats, group: int = 0) -> int:
        """Puts the i-th splat into the i-th slot, in use or not; returns how many are left out.

        Raises ValueError where the splats are antialiased and the map is not, or the reverse,
        MixedGroupsError where a page holds splats of another group, and ChannelError for more
        channels than a map has.
        """
        if not len(slots):
            return 0
        begins = not len(self._pages)
        if not begins and splats.antialiased != self._arrays.antialiased:
            raise ValueError("can't mix antialiased splats with others: they are drawn differently")
        into = as_index(slots)
        pages = self._pages.touched(into)
        self._pages.check(pages, group, lambda rows: self._used[rows].any())
        channels = joined(tuple(self._arrays.channels), tuple(splats.channels))
        self._reserve(len(self._pages.lacking(pages)), splats.sh_degree)
        self._add(channels)
        self._pages.add(pages, group)
        if begins:
            self._arrays = replace(self._arrays, antialiased=splats.antialiased)
        mine = self._arrays
        rows = self._pages.find(into)
        origin = self._origins.setdefault(group, splats.origin)
        positions, shift = splats.positions, splats.origin - origin
        if shift.any():
            with np.errstate(over="ignore", invalid="ignore"):
                positions = (positions + shift).astype(np.float32)
        mine.positions[rows] = positions
        mine.orientations[rows] = splats.orientations
        mine.scales[rows] = splats.scales
        mine.opacities[rows] = splats.opacities
        k = splats.sh.shape[1]
        mine.sh[rows, :k] = splats.sh
        mine.sh[rows, k:] = 0
        for name, values in mine.channels.items():
            values[rows] = splats.channels.get(name, np.nan)
        usable = is_usable(
            Arrays(positions, splats.orientations, splats.scales, splats.opacities, splats.sh)
        )
        self._used[rows] = usable
        return len(usable) - int(np.count_nonzero(usable))

    def clear(self, slots: range | NDArray[np.integer]) -> None:
        """Empties slots; those beyond the map are empty already."""
        self._used[self._pages.find(as_index(slots))] = False

    def groups(self, among: NDArray[np.integer] | None = None) -> list[Group]:
        """A copy of the slots in use, ascending in each group, and of what is in them.

        Of those `among` some, if given. In the groups' own frames. There is always a first group,
        empty where there are no splats.
        """
        rows = np.arange(len(self._used))
        if among is not None:
            rows = rows[self._pages.find(among)]
        rows = rows[self._used[rows]]
        slots = self._pages.slots(rows)
        of = self._pages.groups_of(rows)
        if not self._pages.ascending or len(self._pages.groups) > 1:
            places = np.lexsort((slots, of))
            rows, slots, of = rows[places], slots[places], of[places]
        groups = []
        for which in np.unique(of).tolist():
            group = int(self._pages.groups[which])
            own = slice(*np.searchsorted(of, (which, which + 1)))
            splats = replace(self._arrays[rows[own]], origin=self._origins[group])
            groups.append(Group(group, _in_short(slots[own]), splats))
        return groups or [Group(0, range(0), self._arrays[rows])]

    def snapshot(self) -> tuple[range | NDArray[np.uint32], Splats]:
        """A copy of the slots in use, ascending, and of what is in them, in the map's frame."""
        parts = [
            replace(part, splats=part.splats.moved(self.poses[part.group]))
            if part.group in self.poses
            else part
            for part in self.groups()
        ]
        if len(parts) == 1:
            return parts[0].slots, parts[0].splats
        slots = np.concatenate([np.asarray(part.slots, np.uint32) for part in parts])
        places = np.argsort(slots)
        splats = concatenate([part.splats for part in parts])
        return _in_short(slots[places]), splats[places]

    def _add(self, channels: tuple[str, ...]) -> None:
        """Has a value for each of these channels and row. Raises MemoryError."""
        if len(channels) > len(self._arrays.channels):
            both = {name: self._arrays.channel(name) for name in channels}
            self._arrays = replace(self._arrays, channels=both)

    def _reserve(self, pages: int, sh_degree: int) -> None:
        """Makes room for more pages and bands. Raises MemoryError; the map is as it was."""
        arrays = self._arrays
        if sh_degree > arrays.sh_degree:
            sh = np.zeros((len(arrays), sh_coefficients(sh_degree), 3), np.float32)
            sh[:, : arrays.sh.shape[1]] = arrays.sh
            self._arrays = arrays = replace(arrays, sh=sh)
        rows = self._pages.rows + pages * SLOTS_PER_PAGE
        if rows > len(self._used):
            rows = max(rows, len(self._used) * 9 // 8)
            # Where they are: large ones are remapped, so that there are never two of them.
            for array in (*arrays.arrays, self._used):
                array.resize((rows, *array.shape[1:]), refcheck=False)


def _no_splats() -> Splats:
    return Splats(
        positions=np.zeros((0, 3), np.float32),
        orientations=np.zeros((0, 4), np.float32),
        scales=np.zeros((0, 3), np.float32),
        opacities=np.zeros(0, np.float32),
        sh=np.zeros((0, 1, 3), np.float32),
    )


def _in_short(slots: NDArray[np.uint32]) -> range | NDArray[np.uint32]:
    """Ascending slots without a gap as a range."""
    if not len(slots):
        return range(0)
    first, end = int(slots[0]), int(slots[-1]) + 1
    return range(first, end) if end - first == len(slots) else slots


def as_index(slots: range | NDArray[np.integer]) -> slice | NDArray[np.integer]:
    """Slots as arrays are indexed by them."""
    return slice(slots.start, slots.stop) if isinstance(slots, range) else slots


def apply(message: GaussianArray, slot_map: SlotMap) -> int:
    """Does to a map what a batch says; returns how many splats are left out.

    Raises ValueError, and leaves the map as it is, where a receiver would refuse the batch.
    """
    slots, splats = decode(message)
    if message.operation == GaussianArray.MOVE:
        slot_map.poses |= poses_of(message)
        return 0
    if message.operation == GaussianArray.DELETE:
        slot_map.clear(slots)
        return 0
    if message.operation == GaussianArray.REPLACE:
        slot_map.reset()
    return slot_map.write(slots, splats, message.group)
