"""Pictures that a calibrated camera takes of a map: colours, depths, normals. Knows no ROS.

A pixel has a surface where at most half of its light comes from behind the splats that it shows.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rosplat_core.lenses import Warp
from rosplat_core.models import Model
from rosplat_core.rendering import CpuRenderer, DrawMode, posed

MEDIAN, EXPECTED = "median", "expected"
DEPTHS = (MEDIAN, EXPECTED)

Pixels = NDArray[np.float32]
View = tuple[NDArray[np.float64], float, float]  # world to lens (4, 4), near, far [m]


@dataclass(frozen=True, eq=False)
class LensPicture:
    """What a camera sees; fields that weren't asked for are None."""

    colour: Pixels
    """(height, width, 3) RGB over black, 0 or more."""
    depth: Pixels | None = None
    """(height, width) along the camera's z [m]; inf without a surface, NaN for pixels that no ray
    reaches, and for points that are not in front of the lens."""
    normals: Pixels | None = None
    """(height, width, 3) unit vectors in the camera's optical frame, towards the camera; NaN
    without a surface."""


def take_picture(
    renderer: CpuRenderer,
    warp: Warp,
    world_to_lens: NDArray[np.float64],
    *,
    near: float = 0.01,
    far: float = 1e10,
    depth: str = "",
    normals: bool = False,
) -> LensPicture:
    """Draws the renderer's map through a lens.

    world_to_lens: (4, 4) rigid transform into the lens's optical frame [m]. near, far: splats whose
    centres lie between these depths are drawn [m]. depth: "median", that of the splat at which half
    of the light or less is left; "expected", the mean of the splats' depths, weighted by their
    contributions; "", none. Raises ValueError for another.
    """
    if depth not in ("", *DEPTHS):
        raise ValueError(f"depth is '{depth}', expected one of {', '.join(DEPTHS)}")
    wanted = {"median_depth": depth == MEDIAN, "mean_depth": depth == EXPECTED}
    by_samples = warp.samples and renderer.model in (Model.RAY, Model.DISC)
    take = _by_rays if by_samples else _warped
    picture = take(renderer, warp, (world_to_lens, near, far), wanted, normals)
    if picture.normals is None:
        return picture
    return replace(picture, normals=picture.normals @ world_to_lens[:3, :3].T.astype("f4"))


def _warped(
    renderer: CpuRenderer, warp: Warp, view: View, wanted: dict[str, bool], normals: bool
) -> LensPicture:
    """As take_picture, from pictures of other cameras; normals in the map's frame."""
    sheets = warp.sheets(renderer.model)

    def draw(**wanted: bool) -> list[dict[str, Any]]:
        return [
            renderer.draw(posed(camera), lens=curve, **wanted)
            for camera, curve in sheets.cameras(*view)
        ]

    drawn = draw(**wanted)
    colour = sheets.colour([each["colour"][..., :3] for each in drawn])
    depth = sheets.depth([_depth(each) for each in drawn]) if any(wanted.values()) else None
    facing = None
    if normals:
        pictures = _in_mode(renderer, DrawMode.NORMALS, draw)
        facing = sheets.nearest([_normals(each["colour"]) for each in pictures])
    return LensPicture(colour, depth, facing)


def _by_rays(
    renderer: CpuRenderer, warp: Warp, view: View, wanted: dict[str, bool], normals: bool
) -> LensPicture:
    """As _warped, but each pixel along its own ray."""

    def draw(**wanted: bool) -> list[dict[str, Any]]:
        return [
            renderer.draw(posed(camera), samples=samples, **wanted)
            for camera, samples in zip(warp.cameras(*view), warp.samples, strict=True)
        ]

    drawn = draw(**wanted)
    colour = warp.placed([each["colour"][:, :3] for each in drawn])
    depth = None
    if any(wanted.values()):
        depths = warp.ahead([_depth(each) for each in drawn])
        depth = warp.placed([each[:, None] for each in depths], np.nan)[..., 0]
    facing = None
    if normals:
        pictures = _in_mode(renderer, DrawMode.NORMALS, draw)
        facing = warp.placed([_normals(each["colour"]) for each in pictures], np.nan)
    return LensPicture(colour, depth, facing)


def _in_mode(renderer: CpuRenderer, mode: DrawMode, draw: Callable[[], Any]) -> Any:
    before = renderer.settings.mode
    renderer.settings.mode = mode
    try:
        return draw()
    finally:
        renderer.settings.mode = before


def _depth(drawn: dict[str, Any]) -> Pixels:
    depth: Pixels = drawn["depth"][..., 0]
    surface = np.isfinite(depth) & (drawn["colour"][..., 3] >= 0.5)
    return np.where(surface, depth, np.float32(np.inf))


def _normals(colour: Pixels) -> Pixels:
    """Unit normals (h, w, 3) in the map's frame, of a premultiplied picture of (normal + 1) / 2."""
    alpha = colour[..., 3:]
    normals = 2 * colour[..., :3] - alpha
    length = np.linalg.norm(normals, axis=-1, keepdims=True)
    with np.errstate(all="ignore"):
        unit: Pixels = np.where(alpha >= 0.5, normals / length, np.float32(np.nan))
    return unit
