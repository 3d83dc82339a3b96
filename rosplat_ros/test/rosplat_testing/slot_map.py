"""A map of Gaussians by slot in plain NumPy: what a stream of edits adds up to."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rosplat_core.channels import joined
from rosplat_core.payload import Arrays
from rosplat_core.slot_pages import MAX_SLOTS, SLOTS_PER_PAGE
from rosplat_core.splats import Splats, concatenate, sh_coefficients
from rosplat_msgs.msg import GaussianArray
from rosplat_testing.messages import decode, is_usable, poses_of

Slots = range | NDArray[np.integer]
_PAGE = np.arange(SLOTS_PER_PAGE)


@dataclass(frozen=True, eq=False)
class Group:
    """The splats of one group of a map, in its frame, and their slots."""

    group: int
    slots: NDArray[np.uint32]
    splats: Splats


class SlotMap:
    """Numbered slots that edits fill and empty, in groups with poses.

    A group's origin is that of its first splats, the map's filter that of its. What no receiver
    would take is left out: a splat with a value that is not finite, a negative scale, or no
    orientation. poses: where groups were placed, float64 (4, 4).
    """

    def __init__(self, splats: Splats | None = None) -> None:
        """A map with a copy of splats in slots 0 to n - 1."""
        self.reset()
        if splats is not None:
            self.write(range(len(splats)), splats)

    def reset(self) -> None:
        """Forgets all."""
        # Each slot that was ever written has a row; what is untouched of zeros takes no memory.
        self._places = np.zeros(MAX_SLOTS, np.uint32)  # one past a slot's row, or 0
        self._count = 0
        self._slots = np.zeros(0, np.uint32)  # of rows
        self._groups = np.zeros(0, np.uint32)
        self._used = np.zeros(0, bool)
        self._arrays = _no_splats()
        self._origins: dict[int, NDArray[np.float64]] = {}
        self.poses: dict[int, NDArray[np.float64]] = {}

    def __len__(self) -> int:
        """Number of slots in use."""
        return int(np.count_nonzero(self._used))

    def write(self, slots: Slots, splats: Splats, group: int = 0) -> int:
        """Puts the i-th splat into the i-th slot, in use or not; returns how many are left out.

        Raises ValueError where the splats' model is not the map's, where
        a page holds splats of another group, and for more channels than a map has.
        """
        if not len(slots):
            return 0
        if self._count and splats.model != self._arrays.model:
            raise ValueError("can't mix splats of different models: they are drawn differently")
        slots = np.asarray(slots, np.int64)
        self._check_pages(slots, group)
        channels = joined(tuple(self._arrays.channels), tuple(splats.channels))
        self._reserve(slots, splats.sh_degree)
        self._arrays = mine = replace(
            self._arrays,
            channels={name: self._arrays.channel(name) for name in channels},
            model=splats.model,
        )
        rows = self._rows(slots)
        positions, shift = (
            splats.positions,
            splats.origin - self._origins.setdefault(group, splats.origin),
        )
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
        self._groups[rows] = group
        return len(usable) - int(np.count_nonzero(usable))

    def clear(self, slots: Slots) -> None:
        """Empties slots; those beyond the map are empty already."""
        self._used[self._rows(slots)] = False

    def groups(self) -> list[Group]:
        """A copy of the slots in use, ascending in each group, and of what is in them.

        In the groups' own frames. There is always a first group, empty where there are no splats.
        """
        rows = np.flatnonzero(self._used)
        rows = rows[np.argsort(self._slots[rows])]
        groups = []
        for group in np.unique(self._groups[rows]).tolist():
            own = rows[self._groups[rows] == group]
            splats = replace(self._arrays[own], origin=self._origins[group])
            groups.append(Group(group, self._slots[own], splats))
        return groups or [Group(0, self._slots[rows], self._arrays[rows])]

    def snapshot(self) -> tuple[NDArray[np.uint32], Splats]:
        """A copy of the slots in use, ascending, and of what is in them, in the map's frame."""
        parts = self.groups()
        slots = np.concatenate([part.slots for part in parts])
        splats = concatenate(
            [
                part.splats.moved(self.poses[part.group])
                if part.group in self.poses
                else part.splats
                for part in parts
            ]
        )
        ascending = np.argsort(slots)
        return slots[ascending], splats[ascending]

    def _rows(self, slots: Slots) -> NDArray[np.int64]:
        """The rows of slots, in their order but without those that have none."""
        index = slice(slots.start, slots.stop) if isinstance(slots, range) else slots
        places = self._places[index]
        return places[places > 0].astype(np.int64) - 1

    def _check_pages(self, slots: NDArray[np.int64], group: int) -> None:
        """Raises ValueError where splats of a group may not be written to some slots."""
        for page in np.unique(slots // SLOTS_PER_PAGE).tolist():
            first = page * SLOTS_PER_PAGE
            rows = self._rows(range(first, first + SLOTS_PER_PAGE))
            others = self._groups[rows[self._used[rows]]]
            if (others != group).any():
                raise ValueError(
                    f"slots {first} to {first + SLOTS_PER_PAGE - 1} hold splats of group "
                    f"{others[0]}, this batch is of group {group}: delete them first"
                )

    def _reserve(self, slots: NDArray[np.int64], sh_degree: int) -> None:
        """Gives rows to slots that have none, and makes room for more bands."""
        arrays = self._arrays
        if sh_degree > arrays.sh_degree:
            sh = np.zeros((len(arrays), sh_coefficients(sh_degree), 3), np.float32)
            sh[:, : arrays.sh.shape[1]] = arrays.sh
            self._arrays = arrays = replace(arrays, sh=sh)
        fresh = np.unique(slots[self._places[slots] == 0])
        first, self._count = self._count, self._count + len(fresh)
        if self._count > len(self._used):
            rows = max(self._count, len(self._used) * 9 // 8)
            # Where they are: large ones are remapped, so that there are never two of them.
            for array in (*arrays.arrays, self._slots, self._groups, self._used):
                array.resize((rows, *array.shape[1:]), refcheck=False)
        self._slots[first : self._count] = fresh
        self._places[fresh] = np.arange(first, self._count) + 1


def _no_splats() -> Splats:
    return Splats(
        positions=np.zeros((0, 3), np.float32),
        orientations=np.zeros((0, 4), np.float32),
        scales=np.zeros((0, 3), np.float32),
        opacities=np.zeros(0, np.float32),
        sh=np.zeros((0, 1, 3), np.float32),
    )


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
