"""Merging of neighbours: which two splats look most like one, and the one that takes their place.

A merged splat has its pair's moments, weighted by what each of the two contributes to pictures. The
cost of a merge is the squared error of the pair's field against the merged splat's, in closed form,
seen along the three axes (L2 of mixtures: Jian and Vemuri 2011), in units of what pictures change
without each of the two. A splat that costs less to leave out is left out. Knows no renderer.
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

from rosplat_core.harmonics import C0
from rosplat_core.models import Model
from rosplat_core.quaternions import to_matrices
from rosplat_core.splats import LOW_PASS, Splats, concatenate

Array = NDArray[np.floating[Any]]
Indices = NDArray[np.intp]
Numbers = NDArray[np.int32]  # of splats, where many are held

NEIGHBOURS = 4  # that a splat may be merged with; 16 gain 0.3 dB
MOST = 0.25  # share of the splats that go before neighbours are looked for again
NOTHING = 1e-6  # what costs so little of the dearest is left out: merged, one of two would stay
INEXACT = 0.1  # share of the cost of leaving one of a pair out that is added to a merge's cost
CHUNK = 1 << 15  # pairs, or splats, whose arrays stay in the cache
BLOCK = 1 << 13  # pairs that are merged at a time
LARGEST = 1e15  # variance whose square a 32-bit float holds [px^2]
LEAST = 1e-12  # lower bound of areas and weights that divide


@dataclass(frozen=True)
class Contributions:
    """What each splat contributes to pictures: (n,) sums over their pixels."""

    weight: Array
    """Sums of alpha x transmittance: how many pixels' colour a splat makes up."""
    energy: Array
    """Sums of the squares of alpha x transmittance."""
    error: Array
    """Sums of the squares by which red, green and blue change without the splat."""

    def __getitem__(self, index: slice | Indices | NDArray[np.bool_]) -> Contributions:
        """The contributions of the splats that a slice, an index array or a mask picks."""
        return Contributions(self.weight[index], self.energy[index], self.error[index])

    @classmethod
    def concatenate(cls, parts: list[Contributions]) -> Contributions:
        """Joins contributions, in order."""
        none = np.zeros(0, np.float32)
        return cls(
            np.concatenate([none, *(part.weight for part in parts)]),
            np.concatenate([none, *(part.energy for part in parts)]),
            np.concatenate([none, *(part.error for part in parts)]),
        )

    def times(self, factor: float) -> Contributions:
        """The contributions of so many such views."""
        return Contributions(factor * self.weight, factor * self.energy, factor * self.error)

    def contrast(self) -> Array:
        """(n,) mean square by which a splat differs from what is behind it."""
        return self.error / np.maximum(self.energy, LEAST * LEAST)


class Pairs:
    """Pairs of splats to merge, no splat in two pairs, those first that are missed least.

    A splat paired with itself is to be left out. Merged splats are computed when they are asked
    for, as most never are.
    """

    def __init__(
        self,
        splats: Splats,
        contributions: Contributions,
        first: Indices,
        second: Indices,
        costs: Array,
        pixel: float,
    ) -> None:
        self.first, self.second = first, second
        self.costs = costs
        """Estimates of the sum of the squares by which pictures change, for each pair."""
        self._splats, self._contributions, self._pixel = splats, contributions, pixel
        self._two = np.flatnonzero(first != second)
        self._blocks: list[tuple[Splats, Contributions]] = []

    def __len__(self) -> int:
        return len(self.first)

    def merged(self, begin: int, end: int) -> tuple[Indices, Splats, Contributions]:
        """Merges the pairs of a range: each one's first splat, merged splat, and contributions."""
        begin, end = np.searchsorted(self._two, [begin, end])
        blocks = range(len(self._blocks), -(-end // BLOCK))
        with ThreadPoolExecutor() as pool:
            self._blocks.extend(pool.map(self._block, blocks))
        parts = []
        for start, (splats, contributions) in zip(range(0, end, BLOCK), self._blocks, strict=False):
            if start + BLOCK > begin:
                rows = slice(max(begin - start, 0), end - start)
                parts.append((splats[rows], contributions[rows]))
        return (
            self.first[self._two[begin:end]],
            concatenate([splats for splats, _ in parts] or [self._splats[:0]]),
            Contributions.concatenate([contributions for _, contributions in parts]),
        )

    def _block(self, number: int) -> tuple[Splats, Contributions]:
        pairs = self._two[BLOCK * number : BLOCK * (number + 1)]
        one, other = self.first[pairs], self.second[pairs]
        return combine(
            self._splats[one], self._splats[other],
            self._contributions[one], self._contributions[other], self._pixel,
        )  # fmt: skip


def areas(splats: Splats) -> NDArray[np.float64]:
    """(n,) root mean square of the products of two of a splat's three scales. [m^2]"""
    x, y, z = (splats.scales.astype(np.float64) ** 2).T
    mean: NDArray[np.float64] = np.sqrt((x * y + y * z + z * x) / 3)
    return mean


def find_pairs(
    splats: Splats,
    contributions: Contributions,
    pixel: float,
    progress: Callable[[float], None] = lambda part: None,
) -> Pairs:
    """Pairs of neighbours for a map's next round, at most MOST of its splats.

    pixel: size of a pixel at the map [m]. The renderer's low-pass filter blurs smaller splats, so
    that they cost little.
    """
    count = len(splats)
    if count < 2:
        none = np.zeros(0, np.intp)
        return Pairs(splats, contributions, none, none, np.zeros(0), pixel)
    most = max(1, int(MOST * count))
    low, high, costs = _candidates(splats, contributions, pixel, most, progress)
    progress(0.8)
    order = _ascending(costs)
    chosen = order[_first_disjoint(low[order], high[order], count)[:most]]
    first, second = low[chosen].astype(np.intp), high[chosen].astype(np.intp)
    return Pairs(splats, contributions, first, second, costs[chosen], pixel)


def merge(
    splats: Splats, contributions: Contributions, pairs: Pairs, count: int
) -> tuple[Splats, Contributions]:
    """The map with the first count pairs merged or left out, and its contributions."""
    kept = np.ones(len(splats), bool)
    kept[pairs.second[:count]] = False
    first, merged, found = pairs.merged(0, count)
    where = (np.cumsum(kept) - 1)[first]
    splats, contributions = splats[kept], contributions[kept]
    for name in ("positions", "orientations", "scales", "opacities", "sh"):
        getattr(splats, name)[where] = getattr(merged, name)
    for name in ("weight", "energy", "error"):
        getattr(contributions, name)[where] = getattr(found, name)
    return splats, contributions


def combine(
    one: Splats, other: Splats, of_one: Contributions, of_other: Contributions, pixel: float
) -> tuple[Splats, Contributions]:
    """Merges each splat of `one` with that of `other`; returns them and their contributions."""
    weight = of_one.weight + of_other.weight
    share = (of_other.weight + LEAST) / (weight + 2 * LEAST)
    apart = (other.positions - one.positions).astype(np.float64)
    covariances = [_covariances(one), _covariances(other)]
    covariances.append(_mixed(covariances[0], covariances[1], apart, share))
    variances, axes = np.linalg.eigh(covariances[2][:, _FULL].reshape(-1, 3, 3))
    if one.model is Model.DISC:  # stays flat along its third axis
        variances, axes = variances[:, ::-1] * (1, 1, 0), axes[:, :, ::-1].copy()
    axes[:, :, 0] *= np.linalg.det(axes)[:, None]  # no reflection
    merged = replace(
        one,
        positions=(one.positions + share[:, None] * apart).astype(np.float32),
        scales=np.sqrt(np.maximum(variances, 0)),
        orientations=Rotation.from_matrix(axes).as_quat(),
        sh=one.sh + share[:, None, None] * (other.sh - one.sh),
    )
    covered = one.opacities * areas(one) + other.opacities * areas(other)
    area = np.maximum(areas(merged), LEAST * LEAST)
    merged = replace(merged, opacities=np.clip(covered / area, 0, 1))

    fields = [_alone(_blurred(covariance, pixel)) for covariance in covariances]
    amplitude = np.sqrt(of_one.energy / fields[0]) + np.sqrt(of_other.energy / fields[1])
    energy: Array = amplitude**2 * fields[2]
    contrast = of_one.contrast() + share * (of_other.contrast() - of_one.contrast())
    return merged, Contributions(weight, energy, contrast * energy)


def _candidates(
    splats: Splats,
    contributions: Contributions,
    pixel: float,
    most: int,
    progress: Callable[[float], None],
) -> tuple[Numbers, Numbers, Array]:
    """Pairs, splats with themselves among them, and their costs: all of the cheapest `most`.

    Leaves out what is dearer than to leave out any of the 2 * most splats that are missed least:
    these, each left out or merged, are `most` pairs or more.
    """
    nearest = _neighbours(splats.positions)
    progress(0.4)
    field = _Field.of(splats, contributions, pixel)
    progress(0.6)
    dear = np.partition(field.errors, 2 * most - 1)[2 * most - 1]
    free = field.errors <= NOTHING * dear

    def cheap(part: slice) -> tuple[Numbers, Numbers, Array]:
        low, high = _pairs_of(nearest, part)
        costs = field.cost(low, high)
        kept = (costs <= dear) & ~(free[low] | free[high])
        return low[kept], high[kept], costs[kept]

    found = in_chunks(len(splats), cheap)
    alone = np.flatnonzero(field.errors <= dear).astype(np.int32)
    found.append((alone, alone, field.errors[alone]))
    low, high, costs = (np.concatenate(arrays) for arrays in zip(*found, strict=True))
    return low, high, costs


def _neighbours(positions: NDArray[np.float32]) -> Numbers:
    """(n, k) the nearest of each splat, itself among them."""
    count = len(positions)
    tree = cKDTree(positions, balanced_tree=False)
    most = min(NEIGHBOURS + 1, count)
    nearest = np.empty((count, most), np.int32)

    def find(part: slice) -> None:
        nearest[part] = tree.query(positions[part], most)[1]

    in_chunks(count, find)
    return nearest


def _pairs_of(nearest: Numbers, part: slice) -> tuple[Numbers, Numbers]:
    """Pairs of each splat and its nearest: the lower and the higher index, no pair twice."""
    one = np.arange(part.start, part.stop, dtype=np.int32)[:, None]
    other = nearest[part]
    mutual = (nearest[other] == one[..., None]).any(axis=2)
    once = (one < other) | ((one > other) & ~mutual)
    return np.minimum(one, other)[once], np.maximum(one, other)[once]


def in_chunks(count: int, work: Callable[[slice], Any]) -> list[Any]:
    """Results of work, run in threads, for each slice of count things, in order.

    An interrupt waits for these threads; a library's own would go on with memory that is gone.
    """
    chunks = [slice(start, min(start + CHUNK, count)) for start in range(0, count, CHUNK)]
    with ThreadPoolExecutor() as pool:
        return list(pool.map(work, chunks))


@dataclass(frozen=True)
class _Field:
    """The numbers that pairs are compared by, in single precision."""

    positions: Array  # (n, 3) [m]
    colours: Array  # (n, 3) harmonics of band 0
    weights: Array
    errors: Array
    covariances: Array  # (n, 6), with the low-pass filter [px^2]
    amplitudes: Array  # (n,) factor on each splat's Gaussian of unit mass
    contrasts: Array
    alone: Array  # (n,) integral of the square of each splat's Gaussian
    pixel: np.float32  # [m]

    @classmethod
    def of(cls, splats: Splats, contributions: Contributions, pixel: float) -> _Field:
        covariances = np.empty((len(splats), 6), np.float32)
        amplitudes, contrasts, alone = np.empty((3, len(splats)), np.float32)

        def fill(part: slice) -> None:
            found = contributions[part]
            covariances[part] = _blurred(_covariances(splats[part]), pixel)
            alone[part] = _alone(covariances[part])
            amplitudes[part] = np.sqrt(found.energy / alone[part])
            contrasts[part] = found.contrast()

        in_chunks(len(splats), fill)
        return cls(
            splats.positions, splats.sh[:, 0], contributions.weight.astype(np.float32, copy=False),
            contributions.error.astype(np.float32, copy=False), covariances, amplitudes, contrasts,
            alone, np.float32(pixel),
        )  # fmt: skip

    def cost(self, i: Numbers, j: Numbers) -> Array:
        """(m,) squared errors of merging splats i (m,) with splats j (m,)."""
        of_i, of_j = self.amplitudes[i], self.amplitudes[j]
        total = of_i + of_j
        weighs_i, weighs_j = (
            self.weights[i] + np.float32(LEAST),
            self.weights[j] + np.float32(LEAST),
        )
        share = weighs_j / (weighs_i + weighs_j)
        # In pixels: areas in metres may be beyond 32-bit floats.
        apart = (self.positions[j] - self.positions[i]) / self.pixel
        one, other = self.covariances[i], self.covariances[j]
        merged = _mixed(one, other, apart, share)
        both = _overlap(apart, one + other)
        shape = of_i**2 * self.alone[i] + of_j**2 * self.alone[j] + 2 * of_i * of_j * both
        shape += total**2 * _alone(merged)
        shape -= 2 * total * of_i * _overlap(share[:, None] * apart, one + merged)
        shape -= 2 * total * of_j * _overlap((1 - share)[:, None] * apart, other + merged)
        contrast = self.contrasts[i] + share * (self.contrasts[j] - self.contrasts[i])
        differ = np.float32(C0**2) * ((self.colours[j] - self.colours[i]) ** 2).sum(axis=1)
        differs_i, differs_j = share * of_i, (1 - share) * of_j
        colour = differs_i**2 * self.alone[i] + differs_j**2 * self.alone[j]
        colour -= 2 * differs_i * differs_j * both
        costs: Array = contrast * np.maximum(shape, 0) + differ * np.maximum(colour, 0)
        return costs + np.float32(INEXACT) * np.minimum(self.errors[i], self.errors[j])


def _ascending(values: NDArray[np.float32]) -> Indices:
    """Stable argsort of values that aren't negative.

    The bits of such floats have the same order, and sorting integers is faster than argsort.
    """
    keys = (values + np.float32(0)).view(np.uint32).astype(np.uint64) << np.uint64(32)
    keys |= np.arange(len(values), dtype=np.uint64)
    keys.sort()
    return (keys & np.uint64(0xFFFFFFFF)).astype(np.intp)


def _first_disjoint(low: Numbers, high: Numbers, count: int) -> Indices:
    """Indices, in order, of the pairs that share no splat with a pair taken before."""
    rank = np.arange(len(low))
    taken = []
    free = np.ones(count, bool)
    best = np.empty(count, np.intp)
    while len(rank):
        best[low] = best[high] = rank[-1]
        np.minimum.at(best, low, rank)
        np.minimum.at(best, high, rank)
        ours = (best[low] == rank) & (best[high] == rank)
        taken.append(rank[ours])
        free[low[ours]] = free[high[ours]] = False
        left = free[low] & free[high]
        low, high, rank = low[left], high[left], rank[left]
    return np.sort(np.concatenate(taken))


# Symmetric matrices are kept as xx, yy, zz, xy, xz, yz.
_ROWS, _COLUMNS = [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]
_FULL = [0, 3, 4, 3, 1, 5, 4, 5, 2]
_PLANES = ((0, 1, 3), (0, 2, 4), (1, 2, 5))  # two axes, and where their mixed term is


def _covariances(splats: Splats) -> Array:
    """(n, 6) covariances. [m^2]"""
    axes = to_matrices(splats.orientations) * splats.scales[:, None, :]
    rows = np.ascontiguousarray(axes.transpose(1, 2, 0))
    return np.stack(
        [(rows[i] * rows[j]).sum(axis=0) for i, j in zip(_ROWS, _COLUMNS, strict=True)], axis=1
    )


def _mixed(one: Array, other: Array, apart: Array, share: Array) -> Array:
    """(n, 6) covariances of mixtures of two; share: the weight (n,) of `other`, 0 to 1."""
    part = share[:, None]
    outer = apart[:, _ROWS] * apart[:, _COLUMNS]
    return one + part * (other - one) + part * (1 - part) * outer


def _blurred(covariances: Array, pixel: float) -> Array:
    """(n, 6) covariances in pixels, with the renderer's low-pass filter. [px^2]"""
    blurred: Array = np.clip(covariances / pixel**2, -LARGEST, LARGEST).astype(np.float32)
    blurred[:, :3] += LOW_PASS
    return blurred


def _alone(covariances: Array) -> Array:
    """(n,) integrals of the squares of Gaussians of unit mass, seen along three axes."""
    sums = np.zeros(len(covariances), np.float32)
    for x, y, mixed in _PLANES:
        xx, yy, xy = covariances[:, x], covariances[:, y], covariances[:, mixed]
        sums += 0.5 / np.sqrt(np.maximum(xx * yy - xy * xy, np.float32(LOW_PASS**2)))
    return sums


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
