"""Splats moved to where their object stands in a scene, for formats of scenes of objects."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rosplat_core import harmonics
from rosplat_core.formats.decoded import Columns, blocks
from rosplat_core.quaternions import from_matrices, product, to_matrices

UNIFORM = 1e-6  # most relative difference of scales along the axes that count as equal


def place(columns: Columns, pose: NDArray[np.float64]) -> None:
    """Moves splats, in place, by a finite affine transform (4, 4); its last row is (0, 0, 0, 1).

    If it scales the axes differently, each splat becomes its stretched ellipsoid. Colours turn by
    the nearest rotation, mirrored where the transform mirrors.
    """
    if np.array_equal(pose, np.eye(4)):
        return
    linear = pose[:3, :3]
    left, stretch, right = np.linalg.svd(linear)
    rotation = left @ right
    uniform = stretch[0] - stretch[-1] <= UNIFORM * stretch[0] and np.linalg.det(rotation) > 0
    turns = not np.array_equal(rotation, np.eye(3))
    for part in blocks(len(columns.positions)):
        positions, orientations, scales, _, sh = columns.part(part)
        positions[:] = positions @ linear.T + pose[:3, 3]
        if uniform:
            scales *= stretch[0]
        else:
            orientations[:], scales[:] = _stretched(orientations, scales, linear)
        if uniform and turns:
            orientations[:] = product(from_matrices(rotation), orientations)
        if turns:
            sh[:] = harmonics.turned(sh.astype(np.float32, copy=False), rotation)


def _stretched(
    orientations: NDArray[np.floating], scales: NDArray[np.floating], linear: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Quaternions (n, 4) and scales (n, 3) of ellipsoids that a matrix (3, 3) has stretched."""
    axes = linear @ (to_matrices(orientations) * scales[:, None, :])
    usable = np.isfinite(axes.sum(axis=(1, 2)))
    turned, stretched, _ = np.linalg.svd(np.where(usable[:, None, None], axes, 0))
    turned[np.linalg.det(turned) < 0, :, 0] *= -1
    stretched[~usable] = np.nan
    return from_matrices(turned), stretched
