"""The map as edits leave it: what is in each slot, as far as sorting needs it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rosplat_core.channels import joined
from rosplat_core.slot_pages import SLOTS_PER_PAGE, Rows, SlotPages
from rosplat_sorter.edits import EMPTY, MOVE, REPLACE, Edit
from rosplat_sorter.map_pull import Arrival


class SplatMap:
    """Positions and extents of the slots in use, in the rows of their pages.

    map_id, revision, frame_id: of the last edit; revision is 0 before any. origins: of each group
    that was written, that of its first splats, float64 (3,) [m]. poses: where groups were placed,
    float64 (4, 4). missed: how many batches of this map never arrived, and weren't pulled later.
    rejected: how many splats of the last edit were left out. channels: the names of those that
    splats have come with.
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
        self._positions, self._extents = _room(pages.rows)
        self._extents[:] = EMPTY
        self.pages = pages
        self.origins: dict[int, NDArray[np.float64]] = {}
        self.poses: dict[int, NDArray[np.float64]] = {}
        self.channels: tuple[str, ...] = ()
        self._frames: NDArray[np.float64] | None = None
        self._end = 0

    @property
    def positions(self) -> NDArray[np.float32]:
        """Means relative to their group's origin, float32 (rows, 3) [m]; anything in an empty slot.

        What lies between them and the map's frame is in frames.
        """
        return self._positions[: self.pages.rows]

    @property
    def extents(self) -> NDArray[np.float32]:
        """Radii of the splats, float32 (rows,) [m]; negative where nothing can be seen."""
        return self._extents[: self.pages.rows]

    @property
    def slots(self) -> NDArray[np.uint32]:
        """The slot of each row, uint32 (rows,)."""
        return self.pages.slots(np.arange(self.pages.rows))

    @property
    def groups(self) -> NDArray[np.int64]:
        """The place in frames of each row's group, int64 (rows,)."""
        return self.pages.groups_of(np.arange(self.pages.rows))

    @property
    def frames(self) -> NDArray[np.float64]:
        """From what positions of a group are relative to into the map's frame, float64 (g, 4, 4).

        For each of pages.groups.
        """
        if self._frames is None:
            identity, nowhere = np.eye(4), np.zeros(3)
            frames = np.zeros((len(self.pages.groups), 4, 4))
            with np.errstate(over="ignore", invalid="ignore"):  # a view tells of it
                for frame, group in zip(frames, self.pages.groups.tolist(), strict=True):
                    frame[:] = self.poses.get(group, identity)
                    frame[:3, 3] += frame[:3, :3] @ self.origins.get(group, nowhere)
            self._frames = frames
        return self._frames

    def __len__(self) -> int:
        """One more than the highest slot that was written; slots below may be empty."""
        return self._end

    def apply(self, edit: Edit) -> Rows:
        """Applies an edit; answers which rows it changed.

        The rows by which the map grew count as changed even where the answer leaves them out.
        Raises, without applying the edit, MemoryError where the map can't grow so far,
        MixedGroupsError for splats in a page that holds those of another group, and ChannelError
        for more channels than a map has.
        """
        begins = edit.map_id != self.map_id or self.revision == 0
        heard = edit.arrival is Arrival.HEARD
        back = heard and not begins and edit.revision <= self.revision
        clears = begins or edit.operation == REPLACE
        pages = SlotPages() if clears else self.pages
        channels = () if clears else self.channels
        if edit.writes:
            touched = pages.touched(edit.slots)
            pages.check(touched, edit.group, lambda rows: (self._extents[rows] != EMPTY).any())
            if len(edit.positions):
                channels = joined(channels, edit.channels)
            if not clears:
                self._reserve(pages.rows + len(pages.lacking(touched)) * SLOTS_PER_PAGE)
            pages.add(touched, edit.group)
        if clears:
            self._clear(pages)
        if begins or back:  # played once more; not from its beginning, it lacks all before
            self.revision = self.missed = 0
        if edit.operation == REPLACE or edit.arrival is Arrival.LAST:
            self.missed = 0  # of what came before
        elif heard:
            self.missed += edit.revision - self.revision - 1
        self._frames = None
        self.channels = channels
        self.map_id = edit.map_id
        self.revision = edit.revision
        self.rejected = edit.rejected
        self.frame_id = edit.frame_id
        if edit.writes:
            changed = self._write(edit)
        elif edit.operation == MOVE:
            self.poses.update(edit.poses)
            changed = slice(0, 0)
        else:
            changed = self._delete(edit)
        return slice(0, self.pages.rows) if clears else changed

    def _write(self, edit: Edit) -> Rows:
        if len(edit.positions):
            self.origins.setdefault(edit.group, edit.origin)
        origin = self.origins.get(edit.group, edit.origin)
        positions, extents = edit.positions, edit.extents
        if (edit.origin != origin).any():  # in float64, before float32 loses the difference
            with np.errstate(over="ignore", invalid="ignore"):
                positions = (positions + (edit.origin - origin)).astype(np.float32)
            beyond = (extents != EMPTY) & ~np.isfinite(positions).all(axis=1)
            extents = np.where(beyond, EMPTY, extents)
            self.rejected += int(np.count_nonzero(beyond))
        rows = self.pages.find(edit.slots)
        self._end = max(self._end, edit.end)
        self._positions[rows] = positions
        self._extents[rows] = extents
        return rows

    def _delete(self, edit: Edit) -> Rows:
        rows = self.pages.find(edit.slots)
        self._extents[rows] = EMPTY
        return rows

    def _reserve(self, rows: int) -> None:
        """Makes room for so many rows, at least doubling what there is; what is new is empty.

        Room beyond them takes no memory before it is written.
        """
        if rows > len(self._extents):
            positions, extents = _room(max(rows, 2 * len(self._extents)))
            positions[: self.pages.rows] = self.positions
            extents[: self.pages.rows] = self.extents
            self._positions, self._extents = positions, extents
        self._extents[self.pages.rows : rows] = EMPTY


def _room(rows: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    return np.zeros((rows, 3), np.float32), np.zeros(rows, np.float32)
