"""The order of a map's slots: splats that are drawn together become neighbours.

A renderer leaves out pages of consecutive slots that a picture can't show. A page is small in space
only if its slots are in space order. With levels of detail, it also leaves out pages whose splats
are all too fine; one large splat would keep its page. So splats are ordered by size, then in space.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rosplat_core import _core
from rosplat_core.splats import Splats, check_splats

_BITS = 21  # of each axis, in a code of 64


def space_order(positions: NDArray[np.float32]) -> NDArray[np.intp]:
    """Indices (n,) that put (n, 3) finite positions in the order of their Morton codes.

    The codes (Morton 1966) interleave the positions' bits in a cube around all of them.
    """
    if not len(positions):
        return np.zeros(0, np.intp)
    least = positions.min(axis=0).astype(np.float64)
    size = float((positions.max(axis=0) - least).max()) or 1.0
    codes = np.zeros(len(positions), np.uint64)
    for axis in range(3):
        cells = (positions[:, axis] - least[axis]) * ((2**_BITS - 1) / size)
        codes |= _spread(cells.astype(np.uint64)) << np.uint64(axis)
    return np.argsort(codes)


def slot_order(splats: Splats) -> NDArray[np.intp]:
    """Indices (n,) that put splats of finite positions in the order of a map's slots.

    Large splats come first; those of one size, within a factor of four, are in space order.
    Raises ValueError for a position that isn't finite.
    """
    check_splats(splats)
    if not np.isfinite(splats.positions).all():
        raise ValueError("positions: expected finite numbers")
    return order_by_size(splats.positions, splats.scales.max(axis=1, initial=0))


def order_by_size(positions: NDArray[np.float32], sizes: NDArray[np.float32]) -> NDArray[np.intp]:
    """As slot_order; sizes: (n,) largest scales. [m]"""
    order = space_order(positions)
    with np.errstate(divide="ignore"):
        octaves = np.log2(sizes[order])
    powers_of_four = np.floor(np.nan_to_num(octaves, neginf=-200.0) / 2)
    return order[np.argsort(-powers_of_four.astype(np.int8), kind="stable")]


def put_in_slot_order(splats: Splats) -> None:
    """Reorders splats of finite positions where they are, without a copy.

    Other Splats that share an array with these, as moved() and replace() make them, are damaged:
    reorder before you make them. Raises ValueError for an array that can't be written, and for
    positions that aren't finite; then nothing has changed.
    """
    order = slot_order(splats)
    if not all(array.flags.writeable for array in splats.arrays):
        raise ValueError("splats: an array is read-only; take splats[slot_order(splats)] instead")
    for array in splats.arrays:
        _core.put_in_order(array, order)


def _spread(cells: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Spreads the lowest 21 bits of each number to every third bit."""
    for shift, mask in (
        (32, 0x001F00000000FFFF),
        (16, 0x001F0000FF0000FF),
        (8, 0x100F00F00F00F00F),
        (4, 0x10C30C30C30C30C3),
        (2, 0x1249249249249249),
    ):
        cells = (cells | cells << np.uint64(shift)) & np.uint64(mask)
    return cells
