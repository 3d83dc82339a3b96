"""A map of Gaussians by slot: what a stream of edits adds up to. Knows no ROS."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from rosplat_sorter.edits import is_usable
from rosplat_sorter.slot_pages import SLOTS_PER_PAGE, SlotPages
from rosplat_tools.splats import Splats, sh_coefficients

_ARRAYS = ("positions", "orientations", "scales", "opacities", "sh")


class SlotMap:
    """Numbered slots that edits fill and empty, kept by pages of neighbours.

    Its origin and filter are those of the first splats. What no receiver would take is left out: a
    splat with a value that is not finite, a negative scale, or no orientation.
    """

    def __init__(self, splats: Splats | None = None) -> None:
        """A map with a copy of splats in slots 0 to n - 1."""
        self._pages = SlotPages()
        self._arrays = _no_splats()
        self._used = np.zeros(0, bool)
        if splats is not None:
            self._reserve(np.zeros(0, np.int64), splats.sh_degree)
            self.write(range(len(splats)), splats)

    def __len__(self) -> int:
        """Number of slots in use."""
        return int(np.count_nonzero(self._used))

    @property
    def sh_degree(self) -> int:
        """Highest band of spherical harmonics that was ever written."""
        return self._arrays.sh_degree

    @property
    def nbytes(self) -> int:
        """Memory that a snapshot's splats take. [bytes]"""
        return self._arrays.nbytes // max(1, len(self._used)) * len(self)

    def write(self, slots: range | NDArray[np.integer], splats: Splats) -> int:
        """Puts the i-th splat into the i-th slot, in use or not; returns how many are left out.

        Raises ValueError where the splats are antialiased and the map is not, or the reverse.
        """
        if not len(slots):
            return 0
        begins = not len(self._pages)
        if not begins and splats.antialiased != self._arrays.antialiased:
            raise ValueError("can't mix antialiased splats with others: they are drawn differently")
        into = _index(slots)
        self._reserve(self._pages.lacking(into), splats.sh_degree)
        mine = self._arrays
        if begins:
            mine = replace(mine, origin=splats.origin, antialiased=splats.antialiased)
            self._arrays = mine
        rows = self._pages.find(into)
        positions, shift = splats.positions, splats.origin - mine.origin
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
        usable = is_usable(
            positions,
            splats.orientations,
            splats.scales,
            splats.opacities,
            splats.sh.reshape(len(splats), -1),
        )
        self._used[rows] = usable
        return len(usable) - int(np.count_nonzero(usable))

    def clear(self, slots: range | NDArray[np.integer]) -> None:
        """Empties slots; those beyond the map are empty already."""
        self._used[self._pages.find(_index(slots))] = False

    def snapshot(self) -> tuple[range | NDArray[np.uint32], Splats]:
        """A copy of the slots in use, ascending, and of what is in them."""
        rows = np.flatnonzero(self._used)
        slots = self._pages.slots(rows)
        if not self._pages.ascending:
            places = np.argsort(slots)
            rows, slots = rows[places], slots[places]
        splats = self._arrays[rows]
        return (range(len(slots)) if np.all(slots == np.arange(len(slots))) else slots), splats

    def _reserve(self, pages: NDArray[np.int64], sh_degree: int) -> None:
        """Makes room for more pages and bands. Raises MemoryError; the map is as it was."""
        arrays = self._arrays
        if sh_degree > arrays.sh_degree:
            sh = np.zeros((len(arrays), sh_coefficients(sh_degree), 3), np.float32)
            sh[:, : arrays.sh.shape[1]] = arrays.sh
            self._arrays = arrays = replace(arrays, sh=sh)
        rows = self._pages.rows + len(pages) * SLOTS_PER_PAGE
        if rows > len(self._used):
            rows = max(rows, len(self._used) * 9 // 8)
            # Where they are: large ones are remapped, so that there are never two of them.
            for array in (*(getattr(arrays, name) for name in _ARRAYS), self._used):
                array.resize((rows, *array.shape[1:]), refcheck=False)
        self._pages.add(pages)


def _no_splats() -> Splats:
    return Splats(
        positions=np.zeros((0, 3), np.float32),
        orientations=np.zeros((0, 4), np.float32),
        scales=np.zeros((0, 3), np.float32),
        opacities=np.zeros(0, np.float32),
        sh=np.zeros((0, 1, 3), np.float32),
    )


def _index(slots: range | NDArray[np.integer]) -> slice | NDArray[np.integer]:
    return slice(slots.start, slots.stop) if isinstance(slots, range) else slots
