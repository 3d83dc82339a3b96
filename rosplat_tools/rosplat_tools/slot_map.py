"""A map of Gaussians by slot: what a stream of edits adds up to. Knows no ROS."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from rosplat_tools.splats import Splats


class SlotMap:
    """Numbered slots that edits fill and empty, in arrays that double as they grow."""

    def __init__(self, splats: Splats) -> None:
        """A map with a copy of splats in slots 0 to n - 1. They decide its origin and filter."""
        self._arrays = splats[np.arange(len(splats))]
        self._used = np.ones(len(splats), bool)

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
        return self._arrays.nbytes * len(self) // max(1, len(self._used))

    def write(self, slots: range | NDArray[np.integer], splats: Splats) -> None:
        """Puts the i-th splat into the i-th slot, in use or not.

        Raises ValueError where the splats are antialiased and the map is not, or the reverse.
        """
        if splats.antialiased != self._arrays.antialiased:
            raise ValueError("can't mix antialiased splats with others: they are drawn differently")
        if not len(slots):
            return
        if splats.sh_degree > self._arrays.sh_degree:
            self._arrays = self._arrays.with_sh_degree(splats.sh_degree)
        self._reserve(slots.stop if isinstance(slots, range) else int(slots.max()) + 1)
        into = _index(slots)
        mine = self._arrays
        shift = splats.origin - mine.origin
        mine.positions[into] = splats.positions + shift if shift.any() else splats.positions
        mine.orientations[into] = splats.orientations
        mine.scales[into] = splats.scales
        mine.opacities[into] = splats.opacities
        mine.sh[into] = splats.with_sh_degree(mine.sh_degree).sh
        self._used[into] = True

    def clear(self, slots: range | NDArray[np.integer]) -> None:
        """Empties slots; those beyond the map are empty already."""
        slots = np.asarray(slots, np.int64)
        self._used[slots[slots < len(self._used)]] = False

    def snapshot(self) -> tuple[range | NDArray[np.uint32], Splats]:
        """A copy of the slots in use, ascending, and of what is in them."""
        slots = np.flatnonzero(self._used).astype(np.uint32)
        splats = self._arrays[slots]
        return (range(len(slots)) if np.all(slots == np.arange(len(slots))) else slots), splats

    def _reserve(self, capacity: int) -> None:
        have = len(self._used)
        if capacity <= have:
            return
        more = max(capacity, 2 * have) - have
        old = self._arrays

        def grow(values: NDArray[np.float32]) -> NDArray[np.float32]:
            return np.pad(values, [(0, more)] + [(0, 0)] * (values.ndim - 1))

        self._arrays = replace(
            old,
            positions=grow(old.positions),
            orientations=grow(old.orientations),
            scales=grow(old.scales),
            opacities=grow(old.opacities),
            sh=grow(old.sh),
        )
        self._used = np.pad(self._used, (0, more))


def _index(slots: range | NDArray[np.integer]) -> slice | NDArray[np.integer]:
    return slice(slots.start, slots.stop) if isinstance(slots, range) else slots
