"""Shared by formats that store numbers in few bits."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rosplat_core.formats.decoded import Floats


def to_bytes(values: Floats) -> NDArray[np.uint8]:
    """The nearest whole numbers from 0 to 255."""
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)


def sigmoid(x: Floats) -> Floats:
    """1 / (1 + exp(-x)), without overflow."""
    p: Floats = 0.5 + 0.5 * np.tanh(0.5 * x)
    return p


def smallest_three(quaternions: Floats) -> tuple[NDArray[np.intp], Floats]:
    """Splits unit quaternions (n, 4) into the largest one's index (n,) and the others (n, 3).

    The others keep their order and lie within sqrt(1/2) of zero. Where the largest component is
    negative, they are those of the negative quaternion, which is the same rotation.
    """
    largest = np.abs(quaternions).argmax(axis=1)
    rows = np.arange(len(quaternions))
    signs = np.where(quaternions[rows, largest] < 0, -1, 1).astype(np.float32)
    others = OTHERS[largest]
    return largest, quaternions[rows[:, None], others] * signs[:, None]


def largest_restored(largest: NDArray[np.integer], others: Floats) -> NDArray[np.float32]:
    """(n, 4) unit quaternions: the inverse of smallest_three."""
    rows = np.arange(len(others))
    quaternions = np.empty((len(others), 4), np.float32)
    quaternions[rows[:, None], OTHERS[largest]] = others
    quaternions[rows, largest] = np.sqrt(np.maximum(0, 1 - (others**2).sum(axis=1)))
    return quaternions


# Row i: the components that remain without component i.
OTHERS = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])
