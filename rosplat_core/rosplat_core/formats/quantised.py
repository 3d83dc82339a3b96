"""What formats share that keep numbers as others."""

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
    """What stores a rotation: the index of the largest component, and the three others, in order.

    (n, 4) unit quaternions to (n,) and (n, 3), the latter within sqrt(1/2) of zero, of the
    quaternion or its negative: the same rotation, with the largest component positive.
    """
    largest = np.abs(quaternions).argmax(axis=1)
    rows = np.arange(len(quaternions))
    signs = np.where(quaternions[rows, largest] < 0, -1, 1).astype(np.float32)
    others = OTHERS[largest]
    return largest, quaternions[rows[:, None], others] * signs[:, None]


def largest_restored(largest: NDArray[np.integer], others: Floats) -> NDArray[np.float32]:
    """(n, 4) unit quaternions from what smallest_three makes of them."""
    rows = np.arange(len(others))
    quaternions = np.empty((len(others), 4), np.float32)
    quaternions[rows[:, None], OTHERS[largest]] = others
    quaternions[rows, largest] = np.sqrt(np.maximum(0, 1 - (others**2).sum(axis=1)))
    return quaternions


# The components that remain when one is left out.
OTHERS = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])
