"""Merging of neighbours: which two splats look most like one, and the one that takes their place.

Pairs are merged by their moments, weighted by what each contributes to pictures. What that costs is
the squared error of the pair's field against the merged splat's, in closed form, seen along the
three axes (L2 of mixtures: Jian and Vemuri 2011). Knows no renderer.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from rosplat_lab.reference.projection import LOW_PASS, rotation_matrices
from rosplat_tools.harmonics import C0
from rosplat_tools.splats import Splats

Array = NDArray[np.floating[Any]]
Indices = NDArray[np.intp]

NEIGHBOURS = 4  # that a splat may be merged with; 16 gain 0.3 dB
MOST = 0.25  # of the splats that are merged before neighbours are looked for again
SHAPE = 0.3  # what a change of shape counts beside the same change of colour: most is hidden by
# what is behind, which is of like colour
CHUNK = 1 << 16  # pairs whose arrays stay in the cache
LARGEST = 1e15  # variance whose square a 32-bit float holds [px^2]
LEAST = 1e-12  # of areas and weights that are divided by


@dataclass(frozen=True)
class Pairs:
    """Splats to be merged, no splat in two pairs, those first that are missed least."""

    first: Indices
    second: Indices

    def __len__(self) -> int:
        return len(self.first)


def areas(splats: Splats) -> NDArray[np.float64]:
    """(n,) mean of the squares of an ellipsoid's three projected sizes, its root. [m^2]"""
    x, y, z = (splats.scales.astype(np.float64) ** 2).T
    mean: NDArray[np.float64] = np.sqrt((x * y + y * z + z * x) / 3)
    return mean


def find_pairs(
    splats: Splats,
    weights: NDArray[np.float64],
    pixel: float,
    progress: Callable[[float], None] = lambda part: None,
) -> Pairs:
    """Pairs of neighbours for a map's next round of merging, at most MOST of its splats.

    weights: (n,) what each contributes. pixel: size of one where the map is [m]; what is smaller is
    blurred by the low-pass filter of the renderer, and costs little.
    """
    count = len(splats)
    if count < 2:
        return Pairs(np.zeros(0, np.intp), np.zeros(0, np.intp))
    positions = splats.positions.astype(np.float64)
    nearest = cKDTree(positions).query(positions, min(NEIGHBOURS + 1, count), workers=-1)[1]
    progress(0.2)
    one = np.repeat(np.arange(count), nearest.shape[1])
    low, high = np.minimum(one, nearest.ravel()), np.maximum(one, nearest.ravel())
    low, high = np.divmod(np.unique((low * count + high)[low != high]), count)
    field = _Field.of(splats, weights, pixel)
    chunks = [slice(start, start + CHUNK) for start in range(0, len(low), CHUNK)]
    costs = np.empty(len(low), np.float32)

    def cost(chunk: slice) -> None:
        costs[chunk] = field.cost(low[chunk], high[chunk])

    with ThreadPoolExecutor() as pool:
        for done, _ in enumerate(pool.map(cost, chunks)):
            progress(0.2 + 0.7 * done / len(chunks))
    return _disjoint(low, high, costs, count, max(1, int(MOST * count)))


def merge(
    splats: Splats, weights: NDArray[np.float64], pairs: Pairs, count: int
) -> tuple[Splats, NDArray[np.float64]]:
    """A map in which the first count pairs are merged, and its weights."""
    first, second = pairs.first[:count], pairs.second[:count]
    if not len(first):
        return splats, weights
    of_first, of_second = weights[first] + LEAST, weights[second] + LEAST
    share = of_second / (of_first + of_second)
    apart = (splats.positions[second] - splats.positions[first]).astype(np.float64)
    covariances = _mixed(_covariances(splats[first]), _covariances(splats[second]), apart, share)
    variances, axes = np.linalg.eigh(covariances[:, _FULL].reshape(-1, 3, 3))
    axes[:, :, 0] *= np.linalg.det(axes)[:, None]  # no reflection
    areas_of_all = areas(splats)

    out = replace(splats, **{name: getattr(splats, name).copy() for name in _ARRAYS})
    out.positions[first] += share[:, None] * apart
    out.scales[first] = np.sqrt(np.maximum(variances, 0))
    out.orientations[first] = Rotation.from_matrix(axes).as_quat()
    out.sh[first] += share[:, None, None] * (splats.sh[second] - splats.sh[first])
    covered = splats.opacities * areas_of_all
    area = np.maximum(areas(out[first]), LEAST * LEAST)
    out.opacities[first] = np.clip((covered[first] + covered[second]) / area, 0, 1)
    sums = weights.copy()
    sums[first] += weights[second]
    kept = np.ones(len(splats), bool)
    kept[second] = False
    return out[kept], sums[kept]


_ARRAYS = ("positions", "orientations", "scales", "opacities", "sh")


@dataclass(frozen=True)
class _Field:
    """What pairs are compared by, single precision."""

    positions: Array
    covariances: Array  # (n, 6), with the low-pass filter
    weights: Array
    colours: Array
    alone: Array  # (n,) integral of the square of each splat's Gaussian

    @classmethod
    def of(cls, splats: Splats, weights: NDArray[np.float64], pixel: float) -> _Field:
        # In pixels from the middle: areas in metres may be beyond 32-bit floats.
        covariances = np.clip(_covariances(splats) / pixel**2, -LARGEST, LARGEST)
        covariances = covariances.astype(np.float32)
        covariances[:, :3] += LOW_PASS
        positions = (splats.positions - splats.positions.mean(axis=0)) / np.float32(pixel)
        scaled = (weights / max(weights.max(), LEAST)).astype(np.float32)
        colours = np.float32(C0) * splats.sh[:, 0]
        alone = _overlap(np.zeros_like(positions), 2 * covariances)
        return cls(positions, covariances, scaled, colours, alone)

    def cost(self, i: Indices, j: Indices) -> Array:
        """(m,) squared errors of merging splats i (m,) with splats j (m,)."""
        of_i, of_j = self.weights[i] + np.float32(LEAST), self.weights[j] + np.float32(LEAST)
        total = of_i + of_j
        share = of_j / total
        apart = self.positions[j] - self.positions[i]
        one, other = self.covariances[i], self.covariances[j]
        merged = _mixed(one, other, apart, share)
        both = _overlap(apart, one + other)
        alone = of_i**2 * self.alone[i] + of_j**2 * self.alone[j]
        shape = alone + 2 * of_i * of_j * both
        shape += total**2 * _overlap(np.zeros_like(apart), 2 * merged)
        shape -= 2 * total * of_i * _overlap(share[:, None] * apart, one + merged)
        shape -= 2 * total * of_j * _overlap((1 - share)[:, None] * apart, other + merged)
        differ = ((self.colours[j] - self.colours[i]) ** 2).sum(axis=1)
        apart_in_colour = self.alone[i] + self.alone[j] - 2 * both
        costs: Array = SHAPE**2 * shape + (of_i * share) ** 2 * differ * apart_in_colour
        return costs


def _disjoint(low: Indices, high: Indices, costs: Array, count: int, most: int) -> Pairs:
    """Takes the cheapest pair of all that are left, again and again."""
    order = np.argsort(costs, kind="stable")
    low, high, rank = low[order], high[order], np.arange(len(order))
    taken: list[Indices] = []
    number = 0
    free = np.ones(count, bool)
    while len(rank) and number < most:
        best = np.full(count, len(order))
        np.minimum.at(best, low, rank)
        np.minimum.at(best, high, rank)
        ours = (best[low] == rank) & (best[high] == rank)  # nobody has a cheaper one
        taken.append(np.stack([rank[ours], low[ours], high[ours]]))
        number += int(ours.sum())
        free[low[ours]] = free[high[ours]] = False
        left = free[low] & free[high]
        low, high, rank = low[left], high[left], rank[left]
    pairs = np.concatenate(taken, axis=1) if taken else np.zeros((3, 0), np.intp)
    pairs = pairs[:, np.argsort(pairs[0])[:most]]
    return Pairs(pairs[1], pairs[2])


# Symmetric matrices are kept as xx, yy, zz, xy, xz, yz.
_ROWS, _COLUMNS = [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]
_FULL = [0, 3, 4, 3, 1, 5, 4, 5, 2]
_PLANES = ((0, 1, 3), (0, 2, 4), (1, 2, 5))  # two axes, and where their mixed term is


def _covariances(splats: Splats) -> Array:
    """(n, 6) covariances. [m^2]"""
    axes = rotation_matrices(splats.orientations.astype(np.float64)) * splats.scales[:, None, :]
    covariances: Array = np.einsum("nik,nik->ni", axes[:, _ROWS], axes[:, _COLUMNS])
    return covariances


def _mixed(one: Array, other: Array, apart: Array, share: Array) -> Array:
    """(n, 6) covariances of mixtures of two; share: the other's."""
    part = share[:, None]
    outer = apart[:, _ROWS] * apart[:, _COLUMNS]
    mixed: Array = one + part * (other - one) + part * (1 - part) * outer
    return mixed


def _overlap(apart: Array, covariances: Array) -> Array:
    """(n,) integrals of the products of two Gaussians of unit mass, seen along three axes.

    covariances: (n, 6) sums of the two's; apart: (n, 3) from one to the other.
    """
    sums = np.zeros(len(apart), np.float32)
    for x, y, mixed in _PLANES:
        xx, yy, xy = covariances[:, x], covariances[:, y], covariances[:, mixed]
        dx, dy = apart[:, x], apart[:, y]
        determinant = np.maximum(xx * yy - xy * xy, np.float32(LOW_PASS**2))
        distance = (yy * dx * dx - 2 * xy * dx * dy + xx * dy * dy) / determinant
        sums += np.exp(np.float32(-0.5) * distance) / np.sqrt(determinant)
    return sums
