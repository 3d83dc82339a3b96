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
from rosplat_core.lens_warps import Sheets, Warp
from rosplat_core.lenses import Lens
from rosplat_core.models import Model
from rosplat_core.rendering import CpuRenderer, DrawMode, SplatCamera, posed

MEDIAN, EXPECTED = "median", "expected"
DEPTHS = (MEDIAN, EXPECTED)
BAND = 16  # rows: the rasteriser's tiles are as high [px]

Array = NDArray[np.float64]
Pixels = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class LensPicture:
    """What a camera sees; fields that weren't asked for are None."""

    colour: Pixels
    """(height, width, 3) RGB over black, 0 or more; with `alpha`, (height, width, 4)."""
    depth: Pixels | None = None
    """(height, width) along the camera's z [m]; inf without a surface, NaN for pixels that no ray
    reaches, and for points that are not in front of the lens."""
    normals: Pixels | None = None
    """(height, width, 3) unit vectors in the camera's optical frame, towards the camera; NaN
    without a surface."""


def take_picture(
    renderer: CpuRenderer,
    warp: Warp,
    world_to_lens: Array,
    *,
    near: float = 0.01,
    far: float = 1e10,
    depth: str = "",
    normals: bool = False,
    alpha: bool = False,
) -> LensPicture:
    """Draws the renderer's map through a lens.

    world_to_lens: (4, 4) rigid transform into the lens's optical frame [m]. near, far: splats whose
    centres lie between these depths are drawn [m]. depth: "median", that of the splat at which half
    of the light or less is left; "expected", the mean of the splats' depths, weighted by their
    contributions; "", none. Raises ValueError for another.
    """
    if depth not in ("", *DEPTHS):
        raise ValueError(f"depth is '{depth}', expected one of {', '.join(DEPTHS)}")
    view = world_to_lens, near, far
    way: Warp | Sheets = warp
    parts: list[tuple[SplatCamera, dict[str, Any]]]
    if warp.samples and renderer.model in (Model.RAY, Model.DISC):  # each pixel along its own ray
        pinholes = zip(warp.cameras(*view), warp.samples, strict=True)
        parts = [(posed(camera), {"samples": samples}) for camera, samples in pinholes]
    else:
        way = warp.sheets(renderer.model)
        parts = [(_of_whole(camera, warp), {"lens": curve}) for camera, curve in way.cameras(*view)]

    def draw(**wanted: bool) -> list[dict[str, Any]]:
        return [renderer.draw(camera, **how, **wanted) for camera, how in parts]

    drawn = draw(median_depth=depth == MEDIAN, mean_depth=depth == EXPECTED)
    colour = way.colour([each["colour"][..., : 4 if alpha else 3] for each in drawn])
    depths = way.depth([_depth(each) for each in drawn]) if depth else None
    facing = None
    if normals:
        pictures = _in_mode(renderer, DrawMode.NORMALS, draw)
        facing = way.nearest([_normals(each["colour"]) for each in pictures])
        facing = facing @ world_to_lens[:3, :3].T.astype("f4")
    return LensPicture(colour, depths, facing)


class Shutter:
    """A rolling shutter: rows of a lens's picture that are exposed from the top to the bottom.

    Rows are drawn in bands, each from where the camera is as its middle is exposed.
    """

    def __init__(self, lens: Lens, rows: int = BAND) -> None:
        """rows: of a band, 1 or more; fewer are more exact, and slower. Raises LensError."""
        whole = Warp(lens)  # checks all of the lens
        self.bands: list[tuple[float, Warp | int]] = []
        """With the share of the exposure, 0 to 1, that has passed at a band's middle: its lens, or
        how many rows it has where no ray arrives."""
        for top in range(0, lens.height, rows):
            height = min(rows, lens.height - top)
            met = whole.met[top : top + height].any()
            rows_of_it = replace(lens, height=height, cy=lens.cy - top)
            beyond = top, lens.height - top - height
            band = Warp(rows_of_it, beyond) if met else height
            self.bands.append(((top + height / 2) / lens.height, band))
        self._width = lens.width

    def take(
        self, renderer: CpuRenderer, world_to_lens: Callable[[float], Array], **wanted: Any
    ) -> LensPicture:
        """As take_picture, with a pose for each share of the exposure. Normals are in each band's
        own optical frame."""
        parts = [
            self._dark(band, **wanted)
            if isinstance(band, int)
            else take_picture(renderer, band, world_to_lens(share), **wanted)
            for share, band in self.bands
        ]

        def whole(of_parts: list[Pixels | None]) -> Pixels | None:
            known = [part for part in of_parts if part is not None]
            return np.concatenate(known) if known else None

        return LensPicture(
            np.concatenate([part.colour for part in parts]),
            whole([part.depth for part in parts]),
            whole([part.normals for part in parts]),
        )

    def _dark(
        self, height: int, depth: str = "", normals: bool = False, alpha: bool = False, **_: Any
    ) -> LensPicture:
        unmet = np.full((height, self._width, 3), np.nan, np.float32)
        dark = np.zeros((height, self._width, 4 if alpha else 3), np.float32)
        return LensPicture(dark, unmet[..., 0] if depth else None, unmet if normals else None)


def _of_whole(camera: Camera, warp: Warp) -> SplatCamera:
    """A camera whose ellipses are those of the whole picture, by whose height they are clamped."""
    above, below = warp.beyond
    whole = replace(camera, height=above + camera.height + below, cy=camera.cy + above)
    return posed(whole).crop(0, above, camera.width, camera.height)


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
