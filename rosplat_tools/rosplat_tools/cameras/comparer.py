"""Compares a camera's picture with the map, drawn from the same pose."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rosplat_core.lens_pictures import take_picture
from rosplat_core.lens_warps import Warp
from rosplat_core.rendering import CpuRenderer
from rosplat_msgs.msg import Comparison
from rosplat_ros.images import to_bytes
from rosplat_tools.cameras import comparison
from rosplat_tools.cameras.health import NoPicture, drawn
from rosplat_tools.cameras.taken_pictures import Taken


@dataclass(frozen=True, eq=False)
class Compared:
    """What a comparison found."""

    figures: Comparison
    rendered: NDArray[np.uint8]
    """(height, width, 3) RGB of the map."""
    errors: NDArray[np.float32]
    """(height, width) errors of pixels, as of comparison.errors."""
    mask: NDArray[np.bool_]
    """(height, width) true of pixels that count."""


def compare(renderer: CpuRenderer, taken: Taken[Any], warp: Warp) -> Compared:
    """Draws a renderer's map as a picture was taken, and measures how they differ.

    Raises NoPicture.
    """
    mask = taken.counts & warp.met
    if not mask.any():
        raise NoPicture("masked", "the mask leaves no pixel")
    near, far = taken.clip
    with drawn():
        colour = take_picture(renderer, warp, taken.world_to_lens, near=near, far=far).colour
    rendered = to_bytes(colour)  # in 8 bits, as the camera's
    ours, theirs = (
        picture.astype(np.float32) / np.float32(255) for picture in (rendered, taken.colours)
    )
    exposure = comparison.fit_exposure(ours, theirs, mask)
    fitted = comparison.figures(exposure.apply(ours), theirs, mask)
    figures = Comparison(
        header=taken.header,
        map_id=renderer.map.map_id,
        revision=renderer.map.revision,
        pixels=int(mask.sum()),
        **vars(comparison.figures(ours, theirs, mask)),
        **vars(exposure),
        **{f"fitted_{name}": value for name, value in vars(fitted).items()},
    )
    return Compared(figures, rendered, comparison.errors(ours, theirs), mask)
