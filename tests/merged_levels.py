"""Levels of detail merged from a map, and which of them a view draws.

The lattice, the moments and the shares of rosplat_core's lattice.hpp, mixture.hpp and cut.hpp,
in float64, whole maps at a time and without packing.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rosplat_core.cameras import Camera
from rosplat_core.quaternions import from_matrices, to_matrices
from rosplat_core.splats import Splats, concatenate
from rosplat_lab.reference.projection import MIN_ALPHA, Array

LEVELS = 28
FEWEST = 8  # nodes, which nothing merges any more
FINEST = 2.0**-13  # width of the smallest cells [m]
AXIS_CELLS = 2**18  # to either side of the origin
SIGMAS = 2  # of a splat, that its cell is wider than
BLUR = 0.3 / 8**2  # variance of the low-pass filter in widths of a cell


@dataclass(frozen=True)
class Nodes:
    """The n nodes of one level, a Gaussian for each cell that holds anything."""

    size: float
    """Width of the cells. [m]"""
    cells: NDArray[np.int64]
    """(n, 3) corners of the cells, in sizes, by row in ascending order."""
    means: Array
    """(n, 3) relative to the map's origin. [m]"""
    covariances: Array
    """(n, 3, 3) [m^2]"""
    opacities: Array
    """(n,) may exceed 1."""
    sh: Array
    """(n, k, 3) spherical harmonics."""

    def __len__(self) -> int:
        return len(self.cells)

    def splats(self, like: Splats) -> Splats:
        """The nodes as splats of a map; opacities may exceed 1."""
        variances, axes = np.linalg.eigh(self.covariances)
        axes[np.linalg.det(axes) < 0] *= -1
        return replace(
            like,
            positions=self.means.astype(np.float32),
            orientations=from_matrices(axes).astype(np.float32),
            scales=np.sqrt(np.maximum(variances, 0)).astype(np.float32),
            opacities=self.opacities.astype(np.float32),
            sh=self.sh.astype(np.float32),
        )


def entry_levels(splats: Splats) -> NDArray[np.int64]:
    """(n,) the level at which each splat enters the lattice, LEVELS where none is coarse enough."""
    widths = np.maximum(SIGMAS * splats.scales.max(axis=1).astype(np.float64), FINEST / 2)
    distances = np.maximum(np.abs(splats.positions).max(axis=1), FINEST) / AXIS_CELLS
    octaves = np.floor(np.log2(np.maximum(widths, distances) / FINEST)) + 1
    levels: NDArray[np.int64] = np.clip(octaves, 0, LEVELS).astype(np.int64)
    return levels


def merge(splats: Splats) -> list[Nodes]:
    """The nodes of each level up to the last one, the finest first."""
    seen = splats.opacities >= MIN_ALPHA
    entries = np.where(seen, entry_levels(splats), LEVELS)
    axes = to_matrices(splats.orientations)
    axes *= splats.scales.astype(np.float64)[:, None, :]
    covariances = axes @ axes.transpose(0, 2, 1)
    levels: list[Nodes] = []
    for level in range(LEVELS):
        enter = entries == level
        own = (
            splats.positions[enter],
            covariances[enter],
            splats.opacities[enter],
            splats.sh[enter],
        )
        content = [column.astype(np.float64) for column in own]
        if levels:
            below = levels[-1]
            inside = (below.means, below.covariances, below.opacities, below.sh)
            content = [np.concatenate(pair) for pair in zip(content, inside, strict=True)]
        levels.append(_merge(level, *content))
        enters_later = ((entries > level) & (entries < LEVELS)).any()
        if not enters_later and len(levels[-1]) <= FEWEST:
            break
    return levels


def _merge(level: int, means: Array, covariances: Array, opacities: Array, sh: Array) -> Nodes:
    """One Gaussian for all that is in a cell of a level, by their moments and their masses."""
    size = FINEST * 2.0**level
    inside = np.floor(means / size).astype(np.int64)
    cells, cell = np.unique(inside, axis=0, return_inverse=True)
    cell = cell.reshape(-1)

    def total(values: Array) -> Array:
        sums = np.zeros((len(cells), *values.shape[1:]))
        np.add.at(sums, cell, values)
        return sums

    masses = opacities * _areas(covariances, size)
    mass = total(masses)
    mean = total(masses[:, None] * means) / mass[:, None]
    away = means - mean[cell]
    spread = covariances + away[:, :, None] * away[:, None, :]
    covariance = total(masses[:, None, None] * spread) / mass[:, None, None]
    return Nodes(
        size=size,
        cells=cells,
        means=mean,
        covariances=covariance,
        opacities=mass / _areas(covariance, size),
        sh=total(masses[:, None, None] * sh) / mass[:, None, None],
    )


def _areas(covariances: Array, size: float) -> Array:
    """(n,) root mean square over all directions of the area of one standard deviation. [m^2]"""
    blurred = covariances + BLUR * size**2 * np.eye(3)
    trace = np.trace(blurred, axis1=1, axis2=2)
    square: Array = np.einsum("nij,nij->n", blurred, blurred)
    areas: Array = np.sqrt((trace**2 - square) / 6)
    return areas


def errors(means: Array, size: float, camera: Camera, origin: Array) -> Array:
    """(n,) widths [px] in a picture of the cells around means, at their nearest points."""
    focal = max(camera.fx, camera.fy)
    if camera.orthographic:
        return np.full(len(means), focal * size)
    corners = np.floor(means / size) * size
    eye = camera.position - origin
    away = np.maximum(np.maximum(corners - eye, eye - corners - size), 0)
    distances: Array = np.linalg.norm(away, axis=1)
    return focal * size / np.maximum(distances, 1e-6)


def cut(
    splats: Splats, levels: list[Nodes], camera: Camera, error: float, blends: bool = True
) -> tuple[Splats, Array]:
    """What a view draws of a map, to an error [px]: splats and nodes, and (n,) the share of each.

    A share is what is left of a cell's error above that of its parent's; see cut.hpp.
    """

    def rise(errors: Array) -> Array:
        if not blends:
            return (errors >= error).astype(np.float64)
        t = np.clip((errors / error - np.sqrt(0.5)) / (1 - np.sqrt(0.5)), 0, 1)
        risen: Array = t * t * (3 - 2 * t)
        return risen

    entries = entry_levels(splats)
    share = np.ones(len(splats))
    for level, nodes in enumerate(levels):
        enter = entries == level
        positions = splats.positions[enter].astype(np.float64)
        share[enter] = rise(errors(positions, nodes.size, camera, splats.origin))
    drawn, shares = [splats], [share]
    for level, nodes in enumerate(levels):
        share = np.ones(len(nodes))
        if level + 1 < len(levels):
            share = rise(errors(nodes.means, 2 * nodes.size, camera, splats.origin))
        drawn.append(nodes.splats(splats))
        shares.append(share - rise(errors(nodes.means, nodes.size, camera, splats.origin)))
    joined, all_shares = concatenate(drawn), np.concatenate(shares)
    return joined[all_shares > 0], all_shares[all_shares > 0]
