"""Quaternions x y z w and rotation matrices."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray


def from_matrices(rotations: ArrayLike) -> NDArray[np.float64]:
    """Unit quaternions (..., 4) of rotation matrices (..., 3, 3), however large the angle.

    Each is the eigenvector of its rotation's K matrix with the largest eigenvalue (Bar-Itzhack
    2000).
    """
    r = np.asarray(rotations, np.float64)
    trace = np.trace(r, axis1=-2, axis2=-1)
    k = np.empty((*r.shape[:-2], 4, 4))
    for i in range(3):
        for j in range(3):
            k[..., i, j] = r[..., i, j] + r[..., j, i]
        k[..., i, i] -= trace
        a, b = (i + 1) % 3, (i + 2) % 3
        k[..., i, 3] = k[..., 3, i] = r[..., b, a] - r[..., a, b]
    k[..., 3, 3] = trace
    quaternions: NDArray[np.float64] = np.linalg.eigh(k)[1][..., -1]
    return quaternions


def product(a: NDArray[np.floating[Any]], b: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    """The rotations b, then a: Hamilton products of quaternions (..., 4)."""
    ax, ay, az, aw = np.moveaxis(np.asarray(a, np.float64), -1, 0)
    bx, by, bz, bw = np.moveaxis(np.asarray(b, np.float64), -1, 0)
    return np.stack(
        [
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
            aw * bw - ax * bx - ay * by - az * bz,
        ],
        axis=-1,
    )
