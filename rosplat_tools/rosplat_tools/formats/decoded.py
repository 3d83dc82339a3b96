"""What all readers end with: a file's numbers become splats that can be drawn."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rosplat_tools.splats import Splats, rebase

Progress = Callable[[float], None]
Warn = Callable[[str], None]


Floats = NDArray[np.floating[Any]]


def decoded(
    path: Path,
    warn: Warn,
    *,
    positions: NDArray[np.float64],
    orientations: Floats,
    scales: Floats,
    opacities: Floats,
    sh: Floats,
    antialiased: bool = False,
) -> Splats:
    """Splats from arrays shaped as in Splats; quaternions may have any length.

    Drops splats that hold a number that is not finite or a quaternion of length zero, and tells
    warn how many.
    """
    lengths = np.linalg.norm(orientations, axis=1)
    # A sum is finite where all of its terms are.
    sums = positions.astype(np.float32).sum(axis=1) + lengths + scales.sum(axis=1) + opacities
    sums = sums + sh.sum(axis=(1, 2), dtype=np.float64)
    usable = np.isfinite(sums) & (lengths > 0)
    dropped = len(usable) - np.count_nonzero(usable)
    if dropped:
        warn(
            f"{path}: dropped {dropped:,} of {len(usable):,} splats: "
            "a number that is not finite, or a quaternion of length zero"
        )
        positions, orientations, lengths = positions[usable], orientations[usable], lengths[usable]
        scales, opacities, sh = scales[usable], opacities[usable], sh[usable]
    offsets, origin = rebase(positions)
    return Splats(
        positions=offsets,
        orientations=orientations / lengths[:, None],
        scales=scales,
        opacities=opacities,
        sh=sh,
        origin=origin,
        antialiased=antialiased,
    )
