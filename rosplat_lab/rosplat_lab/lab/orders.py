"""Orders that a sorter finds: the exact one, and by other keys in NumPy.

An order is the visible slots back to front, uint32 (m,), as SplatOrder carries it.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from rosplat_core import depth
from rosplat_core.cameras import Camera
from rosplat_core.ordering import view_of
from rosplat_core.splats import Splats
from rosplat_core.view import SortView
from rosplat_lab.bench.sort import map_of
from rosplat_sorter.backends import open_backend

Order = NDArray[np.uint32]
Keys = Callable[[SortView, NDArray[np.float32]], NDArray[np.uint32]]
"""(m,) keys of positions (m, 3), m > 0, in a view: not smaller for splats that are farther."""


class Sorter:
    """The native backend with a map."""

    def __init__(self, splats: Splats) -> None:
        self._splats = splats
        self._map = map_of(splats)
        self._backend = open_backend("native")
        self._backend.update(self._map, slice(0, self._map.rows))

    def order(self, camera: Camera) -> Order:
        """The exact order."""
        return self._backend.order(view_of(camera, self._splats)).copy()

    def keyed(self, camera: Camera, keys: Keys) -> Order:
        """The visible slots by other keys; of equal keys the higher slot is drawn first."""
        view = view_of(camera, self._splats)
        seen = depth.visible(view, self._map.positions, self._map.extents)
        slots = np.flatnonzero(seen).astype(np.uint32)
        if not len(slots):
            return slots
        return slots[np.argsort(keys(view, self._map.positions[slots]), kind="stable")[::-1]]


def linear(bits: int) -> Keys:
    """2^bits steps of equal depth from the nearest to the farthest visible mean, as most viewers
    have them."""

    def keys(view: SortView, positions: NDArray[np.float32]) -> NDArray[np.uint32]:
        depths = depth.transform(view, positions, 2)
        least = np.float64(depths.min())
        span = max(float(depths.max()) - least, 1e-300)
        steps: NDArray[np.uint32] = ((depths - least) * ((2**bits - 1) / span)).astype(np.uint32)
        return steps

    return keys


def by_distance(view: SortView, positions: NDArray[np.float32]) -> NDArray[np.uint32]:
    """Distance from the camera, which turning it doesn't change, instead of z."""
    x, y, z = (depth.transform(view, positions, axis) for axis in range(3))
    return depth.sort_keys(np.sqrt(x * x + y * y + z * z))
