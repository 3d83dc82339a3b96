"""Merging of neighbours: which two splats look most like one, and the one that takes their place.

Pairs are merged by their moments, weighted by what each contributes to pictures. What that costs is
the squared error of the pair's field against the merged splat's, in closed form, seen along the
three axes (L2 of mixtures: Jian and Vemuri 2011), in units of what pictures change without each of
the two. Where leaving one out costs less, it is left out. Knows no renderer.
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

from rosplat_lab.reference.projection import LOW_PASS
from rosplat_tools.harmonics import C0
from rosplat_tools.quaternions import to_matrices
from rosplat_tools.splats import Splats

Array = NDArray[np.floating[Any]]
Indices = NDArray[np.intp]

NEIGHBOURS = 4  # that a splat may be merged with; 16 gain 0.3 dB
MOST = 0.25  # of the splats that go before neighbours are looked for again
INEXACT = 0.1  # part of what leaving one of a pair out costs that merging it costs at least
CHUNK = 1 << 16  # pairs, or splats, whose arrays stay in the cache
LARGEST = 1e15  # variance whose square a 32-bit float holds [px^2]
LEAST = 1e-12  # of areas and weights that are divided by


@dataclass(frozen=True)
class Contributions:
    """What each splat is to pictures: (n,) sums over their pixels."""

    weight: NDArray[np.float64]
    """Of alpha x transmittance: of how many pixels it is the colour."""
    energy: NDArray[np.float64]
    """Of the squares of these."""
    error: NDArray[np.float64]
    """Of the squares by which red, green and blue change without it."""

    def __getitem__(self, index: Indices | NDArray[np.bool_]) -> Contributions:
        """Those of the splats that an index array or a mask picks."""
        return Contributions(self.weight[index], self.energy[index], self.error[index])

    def contrast(self) -> NDArray[np.float64]:
        """(n,) mean square by which a splat differs from what is behind it."""
        contrast: NDArray[np.float64] = self.error / np.maximum(self.energy, LEAST * LEAST)
        return contrast


@dataclass(frozen=True)
class Pairs:
    """Splats to be merged, no splat in two pairs, those first that are missed least.

    What is its own partner is to be left out.
    """

    first: Indices
    second: Indices
    costs: Array
    """About the sum of the squares by which pictures change."""
    merged: Splats
    """What takes the place of both."""
    contributions: Contributions

    def __len__(self) -> int:
        return len(self.first)


def areas(splats: Splats) -> NDArray[np.float64]:
    """(n,) mean of the squares of an ellipsoid's three projected sizes, its root. [m^2]"""
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

    pixel: size of one where the map is [m]; what is smaller is blurred by the low-pass filter of
    the renderer, and costs little.
    """
    count = len(splats)
    if count < 2:
        none = np.zeros(0, np.intp)
        return Pairs(none, none, np.zeros(0), splats[none], contributions[none])
    low, high = _neighbours(splats.positions)
    progress(0.2)
    field = _Field.of(splats, contributions, pixel)
    chunks = [slice(start, start + CHUNK) for start in range(0, len(low), CHUNK)]
    costs = np.empty(len(low), np.float32)

    def cost(chunk: slice) -> None:
        costs[chunk] = field.cost(low[chunk], high[chunk])

    with ThreadPoolExecutor() as pool:
        for done, _ in enumerate(pool.map(cost, chunks)):
            progress(0.2 + 0.7 * done / len(chunks))
    alone = np.arange(count)
    low, high = np.concatenate([low, alone]), np.concatenate([high, alone])
    costs = np.concatenate([costs, field.errors])
    chosen = _disjoint(low, high, costs, count, max(1, int(MOST * count)))
    low, high = low[chosen], high[chosen]
    merged = combine(splats[low], splats[high], contributions[low], contributions[high], pixel)
    return Pairs(low, high, costs[chosen], *merged)


def merge(
    splats: Splats, contributions: Contributions, pairs: Pairs, count: int
) -> tuple[Splats, Contributions]:
    """A map in which the first count pairs are merged or left out, and what it contributes."""
    first, second = pairs.first[:count], pairs.second[:count]
    kept = np.ones(len(splats), bool)
    kept[second] = False
    return (
        _with(splats, _OF_SPLATS, first, pairs.merged, count)[kept],
        _with(contributions, _SUMS, first, pairs.contributions, count)[kept],
    )


_OF_SPLATS = ("positions", "orientations", "scales", "opacities", "sh")
_SUMS = ("weight", "energy", "error")


def _with(arrays: Any, names: tuple[str, ...], where: Indices, values: Any, count: int) -> Any:
    """Splats, or contributions, some of which are the first count of others."""
    out = replace(arrays, **{name: getattr(arrays, name).copy() for name in names})
    for name in names:
        getattr(out, name)[where] = getattr(values, name)[:count]
    return out


def combine(
    one: Splats, other: Splats, of_one: Contributions, of_other: Contributions, pixel: float
) -> tuple[Splats, Contributions]:
    """Each of some splats and another as one, and what that contributes."""
    weight = of_one.weight + of_other.weight
    share = (of_other.weight + LEAST) / (weight + 2 * LEAST)
    apart = (other.positions - one.positions).astype(np.float64)
    covariances = [_covariances(one), _covariances(other)]
    covariances.append(_mixed(covariances[0], covariances[1], apart, share))
    variances, axes = np.linalg.eigh(covariances[2][:, _FULL].reshape(-1, 3, 3))
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
    energy: NDArray[np.float64] = amplitude**2 * fields[2]
    contrast = of_one.contrast() + share * (of_other.contrast() - of_one.contrast())
    return merged, Contributions(weight, energy, contrast * energy)


def _neighbours(positions: NDArray[np.float32]) -> tuple[Indices, Indices]:
    """Each splat and the nearest to it, by number the lower and the higher, no pair twice."""
    count = len(positions)
    tree = cKDTree(positions, balanced_tree=False)
    parts = [positions[start : start + CHUNK] for start in range(0, count, CHUNK)]
    # In threads that an interrupt waits for: SciPy's own would go on in a tree that is gone.
    with ThreadPoolExecutor() as pool:
        found = pool.map(lambda part: tree.query(part, min(NEIGHBOURS + 1, count))[1], parts)
        nearest = np.concatenate(list(found))
    one = np.repeat(np.arange(count), nearest.shape[1])
    other = nearest.ravel()
    mutual = (nearest[other] == one[:, None]).any(axis=1)
    once = (one < other) | ((one > other) & ~mutual)
    one, other = one[once], other[once]
    return np.minimum(one, other), np.maximum(one, other)


@dataclass(frozen=True)
class _Field:
    """What pairs are compared by, single precision."""

    positions: Array
    covariances: Array  # (n, 6), with the low-pass filter
    weights: Array
    amplitudes: Array  # what the integral of each splat's Gaussian is taken times
    contrasts: Array
    errors: Array
    colours: Array
    alone: Array  # (n,) integral of the square of each splat's Gaussian

    @classmethod
    def of(cls, splats: Splats, contributions: Contributions, pixel: float) -> _Field:
        # In pixels from the middle: areas in metres may be beyond 32-bit floats.
        covariances = _blurred(_covariances(splats), pixel)
        positions = (splats.positions - splats.positions.mean(axis=0)) / np.float32(pixel)
        alone = _alone(covariances)
        return cls(
            positions,
            covariances,
            contributions.weight.astype(np.float32),
            np.sqrt(contributions.energy / alone).astype(np.float32),
            contributions.contrast().astype(np.float32),
            contributions.error.astype(np.float32),
            np.float32(C0) * splats.sh[:, 0],
            alone,
        )

    def cost(self, i: Indices, j: Indices) -> Array:
        """(m,) squared errors of merging splats i (m,) with splats j (m,)."""
        of_i, of_j = self.amplitudes[i], self.amplitudes[j]
        total = of_i + of_j
        weighs_i, weighs_j = (
            self.weights[i] + np.float32(LEAST),
            self.weights[j] + np.float32(LEAST),
        )
        share = weighs_j / (weighs_i + weighs_j)
        apart = self.positions[j] - self.positions[i]
        one, other = self.covariances[i], self.covariances[j]
        merged = _mixed(one, other, apart, share)
        both = _overlap(apart, one + other)
        shape = of_i**2 * self.alone[i] + of_j**2 * self.alone[j] + 2 * of_i * of_j * both
        shape += total**2 * _alone(merged)
        shape -= 2 * total * of_i * _overlap(share[:, None] * apart, one + merged)
        shape -= 2 * total * of_j * _overlap((1 - share)[:, None] * apart, other + merged)
        contrast = self.contrasts[i] + share * (self.contrasts[j] - self.contrasts[i])
        differ = ((self.colours[j] - self.colours[i]) ** 2).sum(axis=1)
        differs_i, differs_j = share * of_i, (1 - share) * of_j
        colour = differs_i**2 * self.alone[i] + differs_j**2 * self.alone[j]
        colour -= 2 * differs_i * differs_j * both
        costs: Array = contrast * np.maximum(shape, 0) + differ * np.maximum(colour, 0)
        return costs + np.float32(INEXACT) * np.minimum(self.errors[i], self.errors[j])


def _disjoint(low: Indices, high: Indices, costs: Array, count: int, most: int) -> Indices:
    """Takes the cheapest pair of all that are left, again and again; returns which, in order."""
    order = np.argsort(costs, kind="stable")
    low, high, rank = low[order], high[order], np.arange(len(order))
    taken = [rank[:0]]
    number = 0
    free = np.ones(count, bool)
    while len(rank) and number < most:
        best = np.full(count, len(order))
        np.minimum.at(best, low, rank)
        np.minimum.at(best, high, rank)
        ours = (best[low] == rank) & (best[high] == rank)  # nobody has a cheaper one
        taken.append(rank[ours])
        number += int(ours.sum())
        free[low[ours]] = free[high[ours]] = False
        left = free[low] & free[high]
        low, high, rank = low[left], high[left], rank[left]
    chosen: Indices = order[np.sort(np.concatenate(taken))[:most]]
    return chosen


# Symmetric matrices are kept as xx, yy, zz, xy, xz, yz.
_ROWS, _COLUMNS = [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]
_FULL = [0, 3, 4, 3, 1, 5, 4, 5, 2]
_PLANES = ((0, 1, 3), (0, 2, 4), (1, 2, 5))  # two axes, and where their mixed term is


def _covariances(splats: Splats) -> Array:
    """(n, 6) covariances. [m^2]"""
    axes = to_matrices(splats.orientations) * splats.scales[:, None, :]
    covariances: Array = np.einsum("nik,nik->ni", axes[:, _ROWS], axes[:, _COLUMNS])
    return covariances


def _mixed(one: Array, other: Array, apart: Array, share: Array) -> Array:
    """(n, 6) covariances of mixtures of two; share: the other's."""
    part = share[:, None]
    outer = apart[:, _ROWS] * apart[:, _COLUMNS]
    mixed: Array = one + part * (other - one) + part * (1 - part) * outer
    return mixed


def _blurred(covariances: Array, pixel: float) -> Array:
    """(n, 6) in pixels, with the renderer's low-pass filter. [px^2]"""
    blurred: Array = np.clip(covariances / pixel**2, -LARGEST, LARGEST).astype(np.float32)
    blurred[:, :3] += LOW_PASS
    return blurred


def _alone(covariances: Array) -> Array:
    """(n,) integrals of the squares of Gaussians of unit mass, seen along three axes."""
    return _overlap(np.zeros((len(covariances), 3), np.float32), 2 * covariances)


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
