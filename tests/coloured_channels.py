"""How values of a channel are coloured, in float64: categories, or a gradient."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rosplat_lab.reference.projection import Array

NO_VALUE = 0.5
"""Grey."""

# Of three categories that follow each other. In OKLab, the first 16 are 0.08 apart or more;
# matplotlib's tab20 are 0.05.
SATURATIONS, BRIGHTNESSES = np.array([0.65, 0.85, 0.8]), np.array([1.0, 0.7, 0.5])
GOLDEN_TURN = 2654435769  # 2^32 over the golden ratio
FARTHEST_CATEGORY = 2.0**30

# Mikhailov 2019, coefficients of t^0 to t^5 for red, green and blue.
TURBO = np.array(
    [
        [0.13572138, 4.61539260, -42.66032258, 132.13108234, -152.94239396, 59.28637943],
        [0.09140261, 2.19418839, 4.84296658, -14.18503333, 4.27729857, 2.82956604],
        [0.10667330, 12.64194608, -60.58204836, 110.36276771, -89.90310912, 27.34824973],
    ]
)


def categories(values: ArrayLike) -> Array:
    """(n, 3) colours of the integers next to values (n,), not finite where there are none."""
    values = np.asarray(values, np.float64)
    there = np.isfinite(values)
    known = np.clip(np.where(there, values, 0), -FARTHEST_CATEGORY, FARTHEST_CATEGORY)
    numbers = np.floor(known + 0.5).astype(np.int64).astype(np.uint32)
    hues = (numbers * np.uint32(GOLDEN_TURN) >> np.uint32(8)) / 2**24
    pure = np.clip(np.abs((6 * hues[:, None] + [0, 4, 2]) % 6 - 3) - 1, 0, 1)
    tones = numbers % 3
    colours = BRIGHTNESSES[tones, None] * (1 + SATURATIONS[tones, None] * (pure - 1))
    return np.where(there[:, None], colours, NO_VALUE)


def gradient(values: ArrayLike, least: float, most: float) -> Array:
    """(n, 3) colours of values (n,): Turbo, blue at the least to red at the most."""
    values = np.asarray(values, np.float64)
    there: NDArray[np.bool_] = np.isfinite(values)
    above = np.clip(np.where(there, values, least), least, most) - least
    t = above / (most - least) if most > least else 0 * above
    colours = np.clip(t[:, None] ** np.arange(6) @ TURBO.T, 0, 1)
    return np.where(there[:, None], colours, NO_VALUE)
