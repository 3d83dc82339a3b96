"""NumPy: the plain twin, and a faster one that sorts key and slot as one integer."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rosplat_core import depth
from rosplat_core.slot_pages import Rows
from rosplat_core.view import View
from rosplat_sorter.backends import Allocate, new_array
from rosplat_sorter.map import SplatMap

_BLOCK = 1 << 15  # splats culled at a time, so that what lies between stays in cache


class NumpyReferenceBackend:
    """depth.order itself."""

    name = "numpy-reference"
    device = "1 thread"

    def __init__(self, threads: int = 0, gpu_only: bool = False) -> None:
        self._splats = SplatMap()

    def update(self, splats: SplatMap, changed: Rows) -> None:
        self._splats = splats

    def close(self) -> None:
        self._splats = SplatMap()

    def order(self, view: View, allocate: Allocate = new_array) -> NDArray[np.uint32]:
        splats = self._splats
        order = depth.order(view, splats.positions, splats.extents, splats.slots, splats.groups)
        result = allocate(len(order))
        result[:] = order
        return result


class NumpyBackend(NumpyReferenceBackend):
    """Sorts key << 32 | slot: unique integers, so any sort is stable, and NumPy's is vectorised."""

    name = "numpy"

    def order(self, view: View, allocate: Allocate = new_array) -> NDArray[np.uint32]:
        splats = self._splats
        positions, extents, pages = splats.positions, splats.extents, splats.pages
        packed = [np.zeros(0, np.uint64)]
        for first in range(0, len(extents), _BLOCK):
            block = slice(first, first + _BLOCK)
            groups: depth.Groups = 0
            if len(pages.groups) > 1:
                groups = pages.groups_of(np.arange(first, min(first + _BLOCK, len(extents))))
            seen = depth.visible(view, positions[block], extents[block], groups)
            rows = np.flatnonzero(seen) + first
            if len(pages.groups) > 1:
                groups = pages.groups_of(rows)
            keys = depth.sort_keys(depth.transform(view, positions[rows], 2, groups))
            packed.append(keys.astype(np.uint64) << np.uint64(32) | pages.slots(rows))
        entries = np.concatenate(packed)
        entries.sort()
        result = allocate(len(entries))
        result[:] = entries[::-1]  # the lower half of each
        return result
