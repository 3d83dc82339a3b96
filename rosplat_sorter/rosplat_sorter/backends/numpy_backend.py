"""NumPy: the plain twin, and a faster one that sorts key and slot as one integer."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rosplat_sorter import depth
from rosplat_sorter.backends import Allocate, new_array
from rosplat_sorter.edits import Slots
from rosplat_sorter.map import SplatMap
from rosplat_sorter.view import View

_BLOCK = 1 << 15  # splats culled at a time, so that what lies between stays in cache


class NumpyReferenceBackend:
    """depth.order itself."""

    name = "numpy-reference"
    device = "1 thread"

    def __init__(self, threads: int = 0, gpu_only: bool = False) -> None:
        self._splats = SplatMap()

    def update(self, splats: SplatMap, changed: Slots) -> None:
        self._splats = splats

    def order(self, view: View, allocate: Allocate = new_array) -> NDArray[np.uint32]:
        order = depth.order(view, self._splats.positions, self._splats.extents)
        result = allocate(len(order))
        result[:] = order
        return result


class NumpyBackend(NumpyReferenceBackend):
    """Sorts key << 32 | slot: unique integers, so any sort is stable, and NumPy's is vectorised."""

    name = "numpy"

    def order(self, view: View, allocate: Allocate = new_array) -> NDArray[np.uint32]:
        positions, extents = self._splats.positions, self._splats.extents
        packed = [np.zeros(0, np.uint64)]
        for first in range(0, len(extents), _BLOCK):
            block = slice(first, first + _BLOCK)
            slots = np.flatnonzero(depth.visible(view, positions[block], extents[block])) + first
            keys = depth.sort_keys(depth.transform(view, positions[slots], 2))
            packed.append(keys.astype(np.uint64) << np.uint64(32) | slots.astype(np.uint64))
        entries = np.concatenate(packed)
        entries.sort()
        result = allocate(len(entries))
        result[:] = entries[::-1]  # the lower half of each
        return result
