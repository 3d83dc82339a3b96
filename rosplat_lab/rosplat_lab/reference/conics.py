"""A splat's response along the rays of a picture: rosplat_core's views/conic.hpp in float64.

That header derives the formulae, and has the names.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SPOT = 2.0  # 1 / the variance of a disc's spot [1/px^2]


class Conics(NamedTuple):
    """The conics of n splats."""

    covariances: Array
    """(n, 2, 2) S [px^2]"""
    g: Array
    """(n, 2) [px]"""
    ahead: Array
    """(n,)"""
    tilts: Array
    """(n, 2) [1/px]"""
    nearness: Array
    """(n,)"""

    @classmethod
    def of(cls, rows: Array) -> Conics:
        """Of rows (n, 3, 3): right, down and ahead."""
        right, down, ahead = rows.transpose(1, 0, 2)
        area = np.cross(right, down)
        determinant = np.sum(area * area, axis=1) + 1e-30
        flat = rows[:, :2]
        below, beside = np.cross(down, ahead), np.cross(ahead, right)
        tilts = np.column_stack([np.sum(below * area, axis=1), np.sum(beside * area, axis=1)])
        return cls(
            covariances=flat @ flat.transpose(0, 2, 1),
            g=np.einsum("nik,nk->ni", flat, ahead),
            ahead=np.sum(ahead * ahead, axis=1),
            tilts=tilts / determinant[:, None],
            nearness=np.sum(ahead * area, axis=1) ** 2 / determinant,
        )

    def outlines(self, cut2: Array) -> tuple[Array, Array]:
        """Where outlines are at sqrt(cut2) (n,) deviations: middles and half sizes, (n, 2) each.

        Middles are from the projected mean. Open outlines have infinite half sizes. [px]
        """
        w = 1 - cut2 * self.ahead
        closed = w > 0
        w = np.where(closed, w, 1)[:, None]
        middles = np.where(closed[:, None], -cut2[:, None] * self.g / w, 0)
        spreads = np.diagonal(self.covariances, axis1=1, axis2=2)
        halves = np.sqrt(cut2[:, None] * (spreads / w + cut2[:, None] * (self.g / w) ** 2))
        return middles, np.where(closed[:, None], halves, np.inf)

    def spots(self) -> Array:
        """(n, 2) middles of discs' spots from the projected mean. [px]"""
        left = 1 - self.ahead
        near = np.abs(left) > 1e-3
        return np.where(near[:, None], -self.g / np.where(near, left, 1)[:, None], 0)
