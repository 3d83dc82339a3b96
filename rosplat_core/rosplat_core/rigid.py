"""Transforms that should be rigid, and nearly are: SLAM back ends and data sets round them."""

from __future__ import annotations

import logging

import numpy as np
from numpy.typing import ArrayLike, NDArray

_log = logging.getLogger(__name__)

ROUNDED = 1e-4  # most that R R' of float32 or few digits is off; taken as it is
NEARLY = 1e-2  # most that R R' may be off at all: 0.3 degrees, or half a percent of scale
_said: list[str] = []


def rigid(transform: ArrayLike, name: str) -> NDArray[np.float64]:
    """A copy (4, 4) whose rotation is one, the nearest to what was given; the log says so once.

    Raises ValueError, which begins with name, for anything else than 4x4 finite numbers of a
    rotation and a translation.
    """
    try:
        matrix = np.array(transform, np.float64)
    except (TypeError, ValueError, OverflowError):
        matrix = np.empty(0)
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
        got = "numbers that are not" if matrix.shape == (4, 4) else f"shape {np.shape(matrix)}"
        if not matrix.size:
            got = type(transform).__name__
        raise ValueError(f"{name}: expected 4x4 finite numbers, got {got}")
    rotation = matrix[:3, :3]
    with np.errstate(all="ignore"):
        off = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
    if not off <= NEARLY or np.linalg.det(rotation) < 0 or (matrix[3] != (0, 0, 0, 1)).any():
        raise ValueError(f"{name}: expected a rotation and a translation")
    if off <= ROUNDED:
        return matrix
    if not _said:
        _said.append(name)
        _log.warning("%s: no rotation, but off by %.2g; the nearest one is taken", name, off)
    left, _, right = np.linalg.svd(rotation)
    matrix[:3, :3] = left @ right
    return matrix


def placed(position: NDArray[np.float64], rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    """(4, 4) of a position (3,) and a rotation matrix of any shape of nine. [m]"""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = np.reshape(rotation, (3, 3)), position
    return pose
