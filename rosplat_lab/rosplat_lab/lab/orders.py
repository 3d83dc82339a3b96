"""Orders other than the exact one: coarse keys, other keys, old cameras, fewer splats. Pure NumPy.

An order is the visible slots back to front, uint32 (m,), as SplatOrder carries it.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from rosplat_core import depth
from rosplat_core.view import SortView
from rosplat_sorter.map import SplatMap

Depths = NDArray[np.float32]
Keys = NDArray[np.uint32]
Order = NDArray[np.uint32]
Quantise = Callable[[Depths], Keys]
"""Keys of (m,) depths, m > 0, that don't descend where the depths ascend."""


def full(depths: Depths) -> Keys:
    """All 32 bits of the floats: exact."""
    keys: Keys = depth.sort_keys(depths)
    return keys


def linear(bits: int) -> Quantise:
    """2^bits steps of equal depth from the nearest to the farthest visible mean."""

    def keys(depths: Depths) -> Keys:
        least = np.float64(depths.min())
        span = max(float(depths.max()) - least, 1e-300)
        steps: Keys = ((depths - least) * ((2**bits - 1) / span)).astype(np.uint32)
        return steps

    return keys


def truncated(bits: int) -> Quantise:
    """The upper bits of the floats, without those that all have in common: steps of equal ratio."""

    def keys(depths: Depths) -> Keys:
        exact: Keys = depth.sort_keys(depths)
        exact -= exact.min()
        used = int(exact.max()).bit_length()
        return exact >> np.uint32(max(0, used - bits))

    return keys


def equalised(bits: int, sample: int = 4096) -> Quantise:
    """Steps that hold equally many of a sample of the depths, each split evenly (adaptive keys).

    Up to 2^10 quantiles of a regular sample carry a piecewise linear map to 2^bits steps.
    """

    def keys(depths: Depths) -> Keys:
        drawn = depths[:: max(1, len(depths) // sample)]
        quantiles = np.linspace(0, 1, 2 ** min(bits, 10) + 1)
        knots = np.quantile(drawn, quantiles)
        knots[0], knots[-1] = depths.min(), depths.max()
        steps: Keys = np.interp(depths, knots, quantiles * (2**bits - 1)).astype(np.uint32)
        return steps

    return keys


def by_z(view: SortView, splats: SplatMap, slots: Order) -> Depths:
    """Distance along the optical axis, what splats are trained with."""
    depths: Depths = depth.transform(view, splats.positions[slots], 2)
    return depths


def by_distance(view: SortView, splats: SplatMap, slots: Order) -> Depths:
    """Distance from the camera, which turning it doesn't change."""
    positions = splats.positions[slots]
    x, y, z = (depth.transform(view, positions, axis) for axis in range(3))
    distances: Depths = np.sqrt(x * x + y * y + z * z)
    return distances


def keyed(view: SortView, splats: SplatMap, quantise: Quantise, distance: Callable = by_z) -> Order:  # type: ignore[type-arg]
    """The visible slots by quantised keys; of equal keys the higher slot is drawn first."""
    slots = np.flatnonzero(depth.visible(view, splats.positions, splats.extents)).astype(np.uint32)
    if not len(slots):
        return slots
    return slots[radix_argsort(quantise(distance(view, splats, slots)))[::-1]]


def radix_argsort(keys: Keys) -> NDArray[np.intp]:
    """Stable argsort in as many of NumPy's 16-bit radix sorts as the largest key needs.

    The time of a sort then depends on the width of its keys as a GPU's radix sort does.
    """
    index = np.argsort(keys.astype(np.uint16), kind="stable")
    if int(keys.max(initial=0)) >> 16:
        upper = (keys >> np.uint32(16)).astype(np.uint16)
        index = index[np.argsort(upper[index], kind="stable")]
    return index


def unsorted(view: SortView, splats: SplatMap) -> Order:
    """The visible slots as the file has them."""
    return np.flatnonzero(depth.visible(view, splats.positions, splats.extents)).astype(np.uint32)


def radii(view: SortView, splats: SplatMap, slots: Order) -> NDArray[np.float32]:
    """About how large splats of an order are drawn, half size in pixels (m,)."""
    w = 1.0 if view.orthographic else by_z(view, splats, slots)
    sizes: NDArray[np.float32] = (
        splats.extents[slots] * math.sqrt(float(view.fx) * float(view.fy)) / w
    )
    return sizes


def at_least(order: Order, sizes: NDArray[np.float32], least: float) -> Order:
    """An order without the splats of a half size below least pixels."""
    return order[sizes >= least]


def budget(order: Order, worth: NDArray[np.float32], share: float) -> Order:
    """The share of an order that is worth the most, still back to front."""
    count = math.ceil(share * len(order))
    if count >= len(order):
        return order
    kept = np.sort(np.argpartition(-worth, count)[:count]) if count else np.zeros(0, np.intp)
    return order[kept]
