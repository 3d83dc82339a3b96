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
    warp: Warp
    world_to_lens: NDArray[np.float64]


def compare(
    renderer: CpuRenderer, taken: Taken[Any], warp: Warp, near: float = 0.01, far: float = 1e6
) -> Compared:
    """Draws a renderer's map as a picture was taken, and measures how they differ.

    near, far: splats between these depths are drawn [m]. Raises NoPicture.
    """
    mask = taken.counts & warp.met
    if not mask.any():
        raise NoPicture("masked", "the mask leaves no pixel")
    world_to_lens = taken.world_to_lens
    with drawn():
        colour = take_picture(renderer, warp, world_to_lens, near=near, far=far).colour
    rendered = to_bytes(colour)  # in 8 bits, as the camera's
    figures, errors = _measured(rendered, taken.colours, mask)
    figures.header = taken.header
    figures.map_id, figures.revision = renderer.map.map_id, renderer.map.revision
    return Compared(figures, rendered, errors, mask, warp, world_to_lens)


def _measured(
    rendered: NDArray[np.uint8], real: NDArray[np.uint8], mask: NDArray[np.bool_]
) -> tuple[Comparison, NDArray[np.float32]]:
    """The figures of two pictures, and the errors of pixels, (height, width)."""
    ours, theirs = (picture.astype(np.float32) / np.float32(255) for picture in (rendered, real))
    exposure = comparison.fit_exposure(ours, theirs, mask)
    plain = comparison.figures(ours, theirs, mask)
    fitted = comparison.figures(exposure.apply(ours), theirs, mask)
    message = Comparison(
        pixels=int(mask.sum()),
        psnr=plain.psnr,
        ssim=plain.ssim,
        explained=plain.explained,
        gain=exposure.gain,
        bias=exposure.bias,
        fitted_psnr=fitted.psnr,
        fitted_ssim=fitted.ssim,
        fitted_explained=fitted.explained,
    )
    return message, comparison.errors(ours, theirs)
