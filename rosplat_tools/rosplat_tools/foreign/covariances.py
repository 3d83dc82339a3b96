"""Shapes as covariances, in which some packages send them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rosplat_core.quaternions import from_matrices, to_matrices
from rosplat_core.splats import Splats


def to_covariances(splats: Splats) -> NDArray[np.float64]:
    """(n, 3, 3) covariances of splats [m^2]."""
    scaled = to_matrices(splats.orientations.astype(np.float64)) * splats.scales[:, None]
    product: NDArray[np.float64] = scaled @ scaled.transpose(0, 2, 1)
    return product


def from_covariances(
    covariances: NDArray[np.floating],
) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
    """Quaternions x, y, z, w (n, 4) and standard deviations (n, 3) [m] of covariances (n, 3, 3).

    Those of a covariance that isn't finite are NaN; negative variances, of rounding, are zero.
    """
    finite = np.all(np.isfinite(covariances), axis=(1, 2))
    usable = np.where(finite[:, None, None], covariances, 0).astype(np.float64)
    variances, vectors = np.linalg.eigh(usable)
    vectors[np.linalg.det(vectors) < 0, :, 0] *= -1  # a rotation, not a reflection
    scales = np.sqrt(np.maximum(variances, 0)).astype(np.float32)
    scales[~finite] = np.nan
    return from_matrices(vectors), scales
