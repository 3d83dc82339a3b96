"""Pictures that a calibrated camera takes of a map: colours, depths, normals. Knows no ROS.

A pixel has a surface where at most half of its light comes from behind the splats that it shows.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rosplat_core.cameras import Camera
from rosplat_core.lenses import Warp
from rosplat_core.models import Model
from rosplat_core.rendering import CpuRenderer, DrawMode, posed

MEDIAN, EXPECTED = "median", "expected"
DEPTHS = (MEDIAN, EXPECTED)

Pixels = NDArray[np.float32]


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
    by_rays = renderer.model in (Model.RAY, Model.DISC)
    if warp.curve and not by_rays:
        camera = warp.camera(world_to_lens, near, far)
        picture = _by_curve(renderer, warp, camera, wanted, normals)
    else:
        take = _by_rays if by_rays and warp.samples else _warped
        picture = take(renderer, warp, warp.cameras(world_to_lens, near, far), wanted, normals)
    if picture.normals is None:
        return picture
    return replace(picture, normals=picture.normals @ world_to_lens[:3, :3].T.astype("f4"))


def _warped(
    renderer: CpuRenderer,
    warp: Warp,
    cameras: list[Camera],
    wanted: dict[str, bool],
    normals: bool,
) -> LensPicture:
    """As take_picture, from pictures of pinhole cameras; normals in the map's frame."""

    def draw(**wanted: bool) -> list[dict[str, Any]]:
        return [renderer.draw(posed(camera), **wanted) for camera in cameras]

    drawn = draw(**wanted)
    colour = warp.colour([each["colour"][..., :3] for each in drawn])
    depth = warp.depth([_depth(each) for each in drawn]) if any(wanted.values()) else None
    facing = None
    if normals:
        pictures = _in_mode(renderer, DrawMode.NORMALS, draw)
        facing = warp.nearest([_normals(each["colour"]) for each in pictures])
    return LensPicture(colour, depth, facing)


def _by_rays(
    renderer: CpuRenderer,
    warp: Warp,
    cameras: list[Camera],
    wanted: dict[str, bool],
    normals: bool,
) -> LensPicture:
    """As _warped, but each pixel along its own ray."""

    def draw(**wanted: bool) -> list[dict[str, Any]]:
        return [
            renderer.draw(posed(camera), samples=samples, **wanted)
            for camera, samples in zip(cameras, warp.samples, strict=True)
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


def _by_curve(
    renderer: CpuRenderer, warp: Warp, camera: Camera, wanted: dict[str, bool], normals: bool
) -> LensPicture:
    """As _warped, but each splat is projected by the lens."""

    def draw(**wanted: bool) -> dict[str, Any]:
        return renderer.draw(posed(camera), lens=warp.curve, **wanted)

    drawn = draw(**wanted)
    colour = np.where(warp.met[..., None], drawn["colour"][..., :3], np.float32(0))
    depth = facing = None
    if any(wanted.values()):
        depth = _depth(drawn)
        depth[~(warp.met & (depth > 0))] = np.nan
    if normals:
        facing = _normals(_in_mode(renderer, DrawMode.NORMALS, draw)["colour"])
        facing[~warp.met] = np.nan
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
