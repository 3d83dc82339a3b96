"""The map as edits leave it: what is in each slot, as far as sorting needs it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rosplat_sorter.depth import INVISIBLE
from rosplat_sorter.edits import DELETE, REPLACE, Edit
from rosplat_sorter.slot_pages import SLOTS_PER_PAGE, Rows, SlotPages


class SplatMap:
    """Positions and extents of the slots in use, in the rows of their pages.

    map_id, revision, frame_id: of the last edit; revision is 0 before any. origin: float64 (3,)
    [m], of the first splats. missed: how many batches of this map never arrived. rejected: how many
    splats of the last edit were left out.
    """

    def __init__(self) -> None:
        self.map_id = ""
        self.revision = 0
        self.frame_id = ""
        self.missed = 0
        self.rejected = 0
        self._clear(SlotPages())

    def _clear(self, pages: SlotPages) -> None:
        """Begins anew with these pages. Raises MemoryError, and changes nothing, without room."""
        self._positions, self._extents = _empty(pages.rows)
        self.pages = pages
        self.origin = np.zeros(3)
        self._has_origin = False
        self._end = 0

    @property
    def positions(self) -> NDArray[np.float32]:
        """Means relative to the origin, float32 (rows, 3) [m]; anything in an empty slot."""
        return self._positions[: self.pages.rows]

    @property
    def extents(self) -> NDArray[np.float32]:
        """Radii of the splats, float32 (rows,) [m]; negative in an empty slot."""
        return self._extents[: self.pages.rows]

    @property
    def slots(self) -> NDArray[np.uint32]:
        """The slot of each row, uint32 (rows,)."""
        return self.pages.slots(np.arange(self.pages.rows))

    def __len__(self) -> int:
        """One more than the highest slot that was written; slots below may be empty."""
        return self._end

    def apply(self, edit: Edit) -> Rows | None:
        """Applies an edit; answers which rows it changed, None for a snapshot of what is known.

        The rows by which the map grew count as changed even where the answer leaves them out.
        Raises MemoryError, without applying the edit, where the map can't grow so far.
        """
        begins = edit.map_id != self.map_id or self.revision == 0
        back = not begins and edit.revision <= self.revision
        if back and edit.snapshot and not self.missed:
            return None
        clears = begins or edit.operation == REPLACE
        if clears:
            pages = SlotPages()
            if edit.operation != DELETE:
                pages.add(pages.lacking(edit.slots))
            self._clear(pages)
        elif edit.operation != DELETE:
            self._reserve(self.pages.lacking(edit.slots))
        if begins or back:  # played once more; not from its beginning, it lacks all before
            self.revision = self.missed = 0
        if edit.operation == REPLACE:  # what came before it is not missed
            self.missed = 0
        else:
            self.missed += edit.revision - self.revision - 1
        self.map_id = edit.map_id
        self.revision = edit.revision
        self.rejected = edit.rejected
        self.frame_id = edit.frame_id
        changed = self._delete(edit) if edit.operation == DELETE else self._write(edit)
        return slice(0, self.pages.rows) if clears else changed

    def _write(self, edit: Edit) -> Rows:
        if len(edit.positions) and not self._has_origin:
            self.origin, self._has_origin = edit.origin, True
        positions, extents = edit.positions, edit.extents
        if (edit.origin != self.origin).any():  # in float64, before float32 loses the difference
            with np.errstate(over="ignore", invalid="ignore"):
                positions = (positions + (edit.origin - self.origin)).astype(np.float32)
            beyond = np.isfinite(edit.positions).all(axis=1) & ~np.isfinite(positions).all(axis=1)
            extents = np.where(beyond, INVISIBLE, extents)
            self.rejected += int(np.count_nonzero(beyond))
        rows = self.pages.find(edit.slots)
        self._end = max(self._end, edit.end)
        self._positions[rows] = positions
        self._extents[rows] = extents
        return rows

    def _delete(self, edit: Edit) -> Rows:
        rows = self.pages.find(edit.slots)
        self._extents[rows] = INVISIBLE
        return rows

    def _reserve(self, pages: NDArray[np.int64]) -> None:
        """Makes room for more pages, at least doubling what there is."""
        rows = self.pages.rows + len(pages) * SLOTS_PER_PAGE
        if rows > len(self._extents):
            positions, extents = _empty(max(rows, 2 * len(self._extents)))
            positions[: self.pages.rows] = self.positions
            extents[: self.pages.rows] = self.extents
            self._positions, self._extents = positions, extents
        self.pages.add(pages)


def _empty(rows: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    return np.zeros((rows, 3), np.float32), np.full(rows, INVISIBLE, np.float32)
