"""Depths, culling and order in plain NumPy: the reference that every backend equals to the bit.

Everything is IEEE float32 and each operation is rounded by itself, so a backend must not fuse a
product with a sum. Written out for a splat at p:

    x y z  = ((r0 * px + r1 * py) + r2 * pz) + t     for each row r of the rotation; z is the depth

with the rotation and translation of the splat's group, so that depths of all groups compare.

Why the culling is safe. The renderer draws a Gaussian of covariance V up to k standard deviations
of its projection, k = min(3.33, sqrt(2 ln(255 opacity))), beyond which its alpha is below 1/255.
The projection (EWA; Zwicker et al. 2001, Kerbl et al. 2023) has, along u, the variance

    c = J V J' + 0.3 px²,    J = fx (1/z, 0, -tan/z)   with |tan| clamped to what `slope` holds
      <= s² fx² (1 + tan²) / z² + 0.3                  with s the largest standard deviation

so k sqrt(c) <= k s fx sqrt(1 + tan²) / z + k sqrt(0.3), whose last term is below the 2.5 px margin.
With the extent e = k s, and multiplied by z, the splat can touch the picture only if

    |fx x + (cx - width/2) z| <= (width/2 + 2.5) z + fx sqrt(1 + tan²) e

and alike along v. Orthographic, J is constant: z becomes 1 and the tangent 0.

The same holds for splats that are evaluated along rays, and for discs. A ray of the picture that
comes within e of p lies, like the whole picture, on one side of each border's plane, fx x + (cx -
width) z = 0 say, and that plane's normal has the length of fx sqrt(1 + tan²), tan the border's own,
or less. A disc's spot is within the margin of its outline.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from rosplat_core.view import SortView

# No splat is seen beyond this, in standard deviations: exp(-3.33²/2) < 1/255.
CUTOFF_SIGMAS = np.float32(3.33)
LEAST_ALPHA = np.float32(1 / 255)
INVISIBLE = np.float32(-1)

Groups: TypeAlias = "int | NDArray[np.integer]"


def splat_extents(
    scales: NDArray[np.float32], opacities: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Radius beyond which a splat is not drawn, float32 (n,) [m]; -1 where it never is.

    scales: standard deviations, float32 (n, 3) [m]. opacities: float32 (n,), above 1 taken as 1.
    """
    drawn = opacities >= LEAST_ALPHA
    alpha = np.clip(opacities, LEAST_ALPHA, np.float32(1))
    logarithm = np.maximum(np.log(np.float32(255) * alpha), np.float32(0))
    sigmas = np.minimum(np.sqrt(np.float32(2) * logarithm), CUTOFF_SIGMAS)
    return np.where(drawn, scales.max(axis=1, initial=0) * sigmas, INVISIBLE)


def transform(
    view: SortView, positions: NDArray[np.float32], axis: int, groups: Groups = 0
) -> NDArray[np.float32]:
    """Coordinate along an axis of the camera optical frame, float32 (n,) [m].

    positions: float32 (n, 3) [m], relative to their group's origin. groups: index in the view of
    each position's group, (n,), or of the one group of all.
    """
    r0, r1, r2 = view.rotations[groups, axis].T
    px, py, pz = positions.T
    result: NDArray[np.float32] = ((r0 * px + r1 * py) + r2 * pz) + view.translations[groups, axis]
    return result


@np.errstate(over="ignore", invalid="ignore")  # what overflows is not visible
def visible(
    view: SortView, positions: NDArray[np.float32], extents: NDArray[np.float32], groups: Groups = 0
) -> NDArray[np.bool_]:
    """Whether any of a splat's footprint can touch the picture, bool (n,)."""
    x, y, z = (transform(view, positions, axis, groups) for axis in range(3))
    w = np.ones_like(z) if view.orthographic else z
    in_depth = (extents >= 0) & (z > view.near_clip) & (z < view.far_clip)
    in_width = (
        np.abs(view.fx * x + view.offset_x * w) <= view.half_width * w + view.slope_x * extents
    )
    in_height = (
        np.abs(view.fy * y + view.offset_y * w) <= view.half_height * w + view.slope_y * extents
    )
    return in_depth & in_width & in_height


def sort_keys(depths: NDArray[np.float32]) -> NDArray[np.uint32]:
    """Unsigned integers that compare as the depths do, uint32 (n,)."""
    bits = (depths + np.float32(0)).view(np.uint32)  # the sum turns -0 into 0: they are equal
    negative = np.uint32(0) - (bits >> np.uint32(31))
    return bits ^ (negative | np.uint32(1 << 31))


@np.errstate(over="ignore", invalid="ignore")
def order(
    view: SortView,
    positions: NDArray[np.float32],
    extents: NDArray[np.float32],
    slots: NDArray[np.uint32] | None = None,
    groups: Groups = 0,
) -> NDArray[np.uint32]:
    """The visible slots back to front, uint32 (m,); of equal depths the higher slot first.

    positions: float32 (n, 3) [m], relative to their group's origin. extents: float32 (n,) [m].
    slots: each position's, uint32 (n,), by default 0 to n - 1. groups: as for transform.
    """
    rows = np.flatnonzero(visible(view, positions, extents, groups))
    slots = rows.astype(np.uint32) if slots is None else slots[rows]
    ascending = np.lexsort((slots, transform(view, positions, 2, groups)[rows]))
    return slots[ascending[::-1]]
