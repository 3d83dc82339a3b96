"""NumPy: sorts depth and slot as one integer."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rosplat_core import depth
from rosplat_core.view import SortView
from rosplat_sorter.backends import Allocate, new_array
from rosplat_sorter.map import Rows, SplatMap

_BLOCK = 1 << 15  # splats culled at a time, so that intermediate arrays stay in the cache


class NumpyBackend:
    """Sorts key << 32 | slot: unique integers, so any sort is stable, and NumPy's is vectorised."""

    name = "numpy"
    device = "1 thread"

    def __init__(self, threads: int = 0, gpu_only: bool = False) -> None:
        self.close()

    def update(self, splats: SplatMap, changed: Rows) -> None:
        self._splats = splats
        self._slots, self._groups = splats.slots_and_groups()

    def close(self) -> None:
        self._splats = SplatMap()
        self._slots, self._groups = self._splats.slots_and_groups()

    def order(self, view: SortView, allocate: Allocate = new_array) -> NDArray[np.uint32]:
        positions, extents = self._splats.positions, self._splats.extents
        one_group = len(view.translations) == 1
        packed = [np.zeros(0, np.uint64)]
        for first in range(0, len(extents), _BLOCK):
            block = slice(first, first + _BLOCK)
            groups: depth.Groups = 0 if one_group else self._groups[block]
            seen = depth.visible(view, positions[block], extents[block], groups)
            rows = np.flatnonzero(seen) + first
            groups = 0 if one_group else self._groups[rows]
            keys = depth.sort_keys(depth.transform(view, positions[rows], 2, groups))
            packed.append(keys.astype(np.uint64) << np.uint64(32) | self._slots[rows])
        entries = np.concatenate(packed)
        entries.sort()
        result = allocate(len(entries))
        result[:] = entries[::-1]  # keeps the lower half of each, the slot
        return result
