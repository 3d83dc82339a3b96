"""The map as edits leave it: what is in each slot, as far as sorting needs it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rosplat_sorter.depth import INVISIBLE
from rosplat_sorter.edits import DELETE, REPLACE, Edit, Slots


class SplatMap:
    """Positions and extents by slot.

    map_id, revision, frame_id: of the last edit; revision is 0 before any. origin: float64 (3,)
    [m]. missed: how many batches of this map never arrived.
    """

    def __init__(self) -> None:
        self._start("", np.zeros(3), 0)

    def _start(self, map_id: str, origin: NDArray[np.float64], slots: int) -> None:
        self._positions, self._extents = _empty(slots)  # or nothing changes
        self.map_id = map_id
        self.revision = 0
        self.frame_id = ""
        self.origin = origin
        self.missed = 0
        self._count = 0

    @property
    def positions(self) -> NDArray[np.float32]:
        """Means relative to the origin, float32 (n, 3) [m]; anything in an empty slot."""
        return self._positions[: self._count]

    @property
    def extents(self) -> NDArray[np.float32]:
        """Radii of the splats, float32 (n,) [m]; negative in an empty slot."""
        return self._extents[: self._count]

    def __len__(self) -> int:
        """One more than the highest slot that was written; slots below may be empty."""
        return self._count

    def apply(self, edit: Edit) -> Slots | None:
        """Applies an edit; answers which slots it changed, None for a snapshot of what is known.

        The slots by which the map grew count as changed even where the answer leaves them out.
        Raises MemoryError, without applying the edit, where the map can't grow so far.
        """
        begins = edit.map_id != self.map_id or self.revision == 0
        back = not begins and edit.revision <= self.revision
        if back and edit.snapshot and not self.missed:
            return None
        if begins:
            self._start(edit.map_id, edit.origin, 0 if edit.operation == DELETE else edit.end)
        if edit.operation != DELETE:
            self._reserve(edit.end)
        if back:  # played once more; not from its beginning, it lacks all before
            self.revision = self.missed = 0
        if edit.operation == REPLACE:  # what came before it is not missed
            self.extents[:] = INVISIBLE
            self._count = self.missed = 0
        else:
            self.missed += edit.revision - self.revision - 1
        self.revision = edit.revision
        self.frame_id = edit.frame_id
        changed = self._delete(edit) if edit.operation == DELETE else self._write(edit)
        return slice(0, self._count) if begins or edit.operation == REPLACE else changed

    def _write(self, edit: Edit) -> Slots:
        positions = edit.positions
        if (edit.origin != self.origin).any():  # in float64, before float32 loses the difference
            with np.errstate(over="ignore"):
                positions = (positions + (edit.origin - self.origin)).astype(np.float32)
        self._count = max(self._count, edit.end)
        self._positions[edit.slots] = positions
        self._extents[edit.slots] = edit.extents
        return edit.slots

    def _delete(self, edit: Edit) -> Slots:
        slots = edit.slots
        if isinstance(slots, slice):
            slots = slice(slots.start, min(slots.stop, self._count))
        else:
            slots = slots[slots < self._count]
        self._extents[slots] = INVISIBLE
        return slots

    def _reserve(self, slots: int) -> None:
        """Makes room for so many slots, at least doubling what there is."""
        if slots <= len(self._extents):
            return
        positions, extents = _empty(max(slots, 2 * len(self._extents)))
        positions[: self._count] = self.positions
        extents[: self._count] = self.extents
        self._positions, self._extents = positions, extents


def _empty(slots: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    return np.zeros((slots, 3), np.float32), np.full(slots, INVISIBLE, np.float32)
