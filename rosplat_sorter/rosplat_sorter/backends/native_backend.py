"""C++: the radix sort of depth_order.hpp, which the rviz display falls back on as well."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rosplat_core import _core
from rosplat_core.view import SortView
from rosplat_sorter.backends import Allocate, new_array
from rosplat_sorter.map import Rows, SplatMap


class NativeBackend:
    """Culls and sorts on the CPU with several threads."""

    name = "native"

    def __init__(self, threads: int = 0, gpu_only: bool = False) -> None:
        self._splats = SplatMap()
        self._sort = _core.DepthOrder(threads)
        self.device = f"{self._sort.threads} thread{'s' * (self._sort.threads > 1)}"

    def update(self, splats: SplatMap, changed: Rows) -> None:
        self._splats = splats

    def close(self) -> None:
        self._splats = SplatMap()
        del self._sort

    def order(self, view: SortView, allocate: Allocate = new_array) -> NDArray[np.uint32]:
        splats = self._splats
        return self._sort.sort(view, splats.positions, splats.extents, splats.pages, allocate)
