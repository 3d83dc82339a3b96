"""Occupancy in float64: rosplat_core's voxel_map.hpp without packing and without integers.

Also other values by which voxels may be judged, for comparison, and the voxels that are truly
occupied in generated rooms.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from rosplat_core.generated.rooms import LAMP, Rooms
from rosplat_core.quaternions import to_matrices
from rosplat_core.splats import Splats
from rosplat_lab.reference.projection import Array

Cells = NDArray[np.int64]

AXIS = 1 << 21  # coordinates of cells are from -AXIS / 2
BLOCK = 1 << 22  # points of splats at a time


def keys_of(cells: Cells) -> NDArray[np.int64]:
    """(n,) a number for each cell (n, 3), ordered by z, y, x."""
    x, y, z = (cells + AXIS // 2).T
    keys: NDArray[np.int64] = (z * AXIS + y) * AXIS + x
    return keys


def cells_of(keys: NDArray[np.int64]) -> Cells:
    """The reverse of keys_of."""
    return np.column_stack([keys % AXIS, keys // AXIS % AXIS, keys // AXIS**2]) - AXIS // 2


def spread(
    splats: Splats, resolution: float
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64], Array, Array]]:
    """Points of splats: number of the splat, key of the cell, weight, place in cells (n, 3).

    Each splat's points lie on a lattice along its axes, to two standard deviations on either side,
    half a voxel apart or so, weighted by the Gaussian; the weights of a splat sum to 1.
    """
    deviations = splats.scales.astype(np.float64) / resolution
    centres = (splats.positions + splats.origin) / resolution
    axes = to_matrices(splats.orientations.astype(np.float64))
    steps = np.rint(4 * deviations).astype(np.int64)
    kinds, kind = np.unique(steps, axis=0, return_inverse=True)
    for number, to_either_side in enumerate(kinds):
        along = [np.linspace(-2, 2, 2 * n + 1) if n else np.zeros(1) for n in to_either_side]
        lattice = np.stack(np.meshgrid(*along, indexing="ij"), axis=-1).reshape(-1, 3)
        weights = np.exp(-0.5 * (lattice**2).sum(axis=1))
        weights /= weights.sum()
        members = np.flatnonzero(kind.ravel() == number)
        most = max(1, BLOCK // len(lattice))
        for some in (members[i : i + most] for i in range(0, len(members), most)):
            own = lattice * deviations[some, None, :]
            places = centres[some, None, :] + np.einsum("nij,npj->npi", axes[some], own)
            places = places.reshape(-1, 3)
            cells = np.floor(places).astype(np.int64)
            yield (
                np.repeat(some, len(lattice)), keys_of(cells), np.tile(weights, len(some)), places,
            )  # fmt: skip


def sums(splats: Splats, resolution: float, of: Array) -> tuple[NDArray[np.int64], Array]:
    """Sums numbers (n, k) of splats in the cells that they reach: keys, and sums (m, k)."""
    keys, values = [], []
    for splat, key, weight, _ in spread(splats, resolution):
        here, place = np.unique(key, return_inverse=True)
        some = of[splat] * weight[:, None]
        keys.append(here)
        values.append(np.stack([np.bincount(place, column) for column in some.T], axis=1))
    every, place = np.unique(np.concatenate(keys), return_inverse=True)
    rows = np.concatenate(values)
    return every, np.stack([np.bincount(place, column) for column in rows.T], axis=1)


def hidden(splats: Splats, resolution: float) -> Array:
    """(n, 3) how many faces of a voxel each splat hides, as seen along x, y, z."""
    deviations = splats.scales.astype(np.float64) / resolution
    axes = to_matrices(splats.orientations.astype(np.float64)) * deviations[:, None, :]
    covariances = axes @ axes.transpose(0, 2, 1)
    across = np.stack(
        [
            covariances[:, j, j] * covariances[:, k, k] - covariances[:, j, k] ** 2
            for j, k in ((1, 2), (0, 2), (0, 1))
        ],
        axis=1,
    )
    opacities = splats.opacities.astype(np.float64)[:, None]
    return 2 * np.pi * opacities * np.sqrt(np.maximum(across, 0))


def depths(splats: Splats, resolution: float) -> tuple[NDArray[np.int64], Array]:
    """Keys of cells, and their optical depths along x, y, z (m, 3)."""
    return sums(splats, resolution, hidden(splats, resolution))


def densities(splats: Splats, resolution: float) -> tuple[NDArray[np.int64], Array]:
    """Keys of cells, and the mean over each of the sum of opacity times Gaussian (m, 1).

    The density of SuGaR (Guedon and Lepetit 2024).
    """
    volume = (2 * np.pi) ** 1.5 * (splats.scales.astype(np.float64) / resolution).prod(axis=1)
    return sums(splats, resolution, (splats.opacities * volume)[:, None])


def centres(splats: Splats, resolution: float) -> tuple[NDArray[np.int64], Array]:
    """Keys of cells, and the opacity of the most opaque splat with its centre there (m, 1)."""
    places = (splats.positions + splats.origin) / resolution
    keys, place = np.unique(keys_of(np.floor(places).astype(np.int64)), return_inverse=True)
    most = np.zeros(len(keys))
    np.maximum.at(most, place, splats.opacities)
    return keys, most[:, None]


def truth(rooms: Rooms, resolution: float, tolerance: float) -> NDArray[np.int64]:
    """Keys of the cells that touch a surface of generated rooms, to within a tolerance. [m]"""
    keys = []
    for low, high in zip(*rooms.sides(), strict=True):
        keys.append(_block(low - tolerance, high + tolerance, resolution))
    for centre in rooms.lamp_centres():
        reach = LAMP + tolerance
        cells = cells_of(_block(centre - reach, centre + reach, resolution))
        low, high = cells * resolution - centre, (cells + 1) * resolution - centre
        nearest = np.linalg.norm(np.maximum(np.maximum(low, -high), 0), axis=1)
        farthest = np.linalg.norm(np.maximum(-low, high), axis=1)
        keys.append(keys_of(cells[(nearest <= reach) & (farthest >= LAMP - tolerance)]))
    return np.unique(np.concatenate(keys))


def _block(low: Array, high: Array, resolution: float) -> NDArray[np.int64]:
    """Keys of the cells between two corners."""
    first, last = (np.floor(corner / resolution).astype(np.int64) for corner in (low, high))
    ranges = [np.arange(a, b + 1) for a, b in zip(first, last, strict=True)]
    return keys_of(np.stack(np.meshgrid(*ranges, indexing="ij"), axis=-1).reshape(-1, 3))


def surface_points(rooms: Rooms, count: int, seed: int) -> Array:
    """(count, 3) points on the rooms' rectangles, evenly by area. [m]"""
    rng = np.random.default_rng(seed)
    low, high = rooms.sides()
    size = high - low
    areas = np.sort(size, axis=1)[:, 1:].prod(axis=1)  # one edge is zero
    face = rng.choice(len(areas), count, p=areas / areas.sum())
    return low[face] + rng.uniform(size=(count, 3)) * size[face]


def met(points: Array, keys: NDArray[np.int64], resolution: float, tolerance: float) -> Array:
    """(n,) bool: whether cells, by their sorted keys, hold points (n, 3) to within a tolerance."""
    found = np.zeros(len(points), bool)
    for corner in np.stack(np.meshgrid(*[(-1, 1)] * 3), axis=-1).reshape(-1, 3):
        cells = np.floor((points + tolerance * corner) / resolution).astype(np.int64)
        found |= np.isin(keys_of(cells), keys)
    return found
