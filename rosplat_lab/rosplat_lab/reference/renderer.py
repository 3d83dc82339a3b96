"""Front to back blending of projected splats, tile by tile."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rosplat_core.cameras import Camera
from rosplat_core.lenses import Lens
from rosplat_core.splats import Splats
from rosplat_lab.reference.conics import SPOT
from rosplat_lab.reference.projection import MAX_ALPHA, MIN_ALPHA, Array, Projected, project

TILE = 16  # [px]
CHUNK = 512  # splats blended at once: a tile's arrays then stay in the cache


@dataclass(frozen=True, eq=False)
class Picture:
    """What a camera sees."""

    rgba: Array
    """(height, width, 4) premultiplied linear RGBA; colours may exceed 1."""
    depth: Array
    """(height, width) opacity-weighted mean of z [m]; NaN where nothing is."""
    median: Array
    """(height, width) z of the splat that leaves half of the light or less; NaN: none does.

    z is where the ray meets the splat: of EWA, its plane; see planes of render()."""


def render(
    splats: Splats,
    camera: Camera,
    *,
    crop: tuple[int, int, int, int] | None = None,
    order: NDArray[np.integer] | None = None,
    shares: Array | None = None,
    max_alpha: float = MAX_ALPHA,
    min_transmittance: float = 0.0,
    scene_depth: Array | None = None,
    lens: Lens | None = None,
    by_distance: bool = False,
    planes: bool = True,
) -> Picture:
    """Draws splats in float64.

    crop is left, top, right, bottom [px] of the part to draw; the camera stays what it is. order
    are slots back to front, as in SplatOrder, instead of the exact order by z; slots that it leaves
    out are not drawn. shares: (n,) how much of each splat is drawn, as of levels of detail; all, if
    not given. max_alpha caps a splat's alpha. A pixel is finished by the splat that would take its
    transmittance to min_transmittance or below (INRIA and gsplat: 1e-4); 0 blends everything.
    scene_depth: (height, width) depths of opaque objects [m], inf where there is none; a splat
    whose centre is behind them is hidden. lens, by_distance: as in project(); the camera has the
    size of the lens's picture. planes: EWA's depths are where its density is largest along a ray,
    to first order; else those of the centres, as on a graphics card. Raises ValueError for a crop
    outside the picture.
    """
    left, top, right, bottom = crop or (0, 0, camera.width, camera.height)
    if not (0 <= left < right <= camera.width and 0 <= top < bottom <= camera.height):
        raise ValueError(f"crop {crop} is not inside {camera.width} x {camera.height}")
    projected = project(splats, camera, shares, lens=lens, by_distance=by_distance)
    if not planes:
        projected = replace(projected, planes=np.zeros_like(projected.planes))
    projected = projected[_front_to_back(projected, order, len(splats))]
    return blended(
        projected, (left, top, right, bottom), max_alpha=max_alpha,
        min_transmittance=min_transmittance, scene_depth=scene_depth,
    )  # fmt: skip


def blended(
    projected: Projected,
    crop: tuple[int, int, int, int],
    *,
    min_alpha: float = MIN_ALPHA,
    max_alpha: float = MAX_ALPHA,
    min_transmittance: float = 0.0,
    scene_depth: Array | None = None,
) -> Picture:
    """The crop of a picture of projected splats, nearest first. Alpha below min_alpha is not
    drawn."""
    left, top, right, bottom = crop
    shape = bottom - top, right - left
    rgba, weighted_z, median = np.zeros((*shape, 4)), np.zeros(shape), np.full(shape, np.nan)
    values = np.column_stack([projected.colors, np.ones(len(projected.slots))])
    for window, members, weights, depths in _contributed(
        projected, crop, (min_alpha, max_alpha), min_transmittance, scene_depth
    ):
        half = rgba[window][..., 3] + np.cumsum(weights, axis=0) >= 0.5
        crossed = np.isnan(median[window]) & half.any(axis=0)
        first = np.take_along_axis(depths, half.argmax(axis=0)[None], axis=0)[0]
        median[window] = np.where(crossed, first, median[window])
        rgba[window] += np.tensordot(weights, values[members], axes=(0, 0))
        weighted_z[window] += (weights * depths).sum(axis=0)
    alpha, depth = rgba[..., 3], np.full(shape, np.nan)
    np.divide(weighted_z, alpha, out=depth, where=alpha > 0)
    return Picture(rgba, depth, median)


def pick(splats: Splats, camera: Camera) -> tuple[NDArray[np.int64], Array]:
    """The splat that contributes most to each pixel, alpha times the transmittance before it.

    Returns (height, width) slots, -1 where nothing is, and (height, width) what they contribute;
    of equal contributions the nearer splat's.
    """
    slots = np.full((camera.height, camera.width), -1)
    most = np.zeros(slots.shape)
    for window, seen, weights in _seen(splats, camera):
        best = weights.argmax(axis=0)
        contribution = np.take_along_axis(weights, best[None], axis=0)[0]
        more = contribution > most[window]
        slots[window] = np.where(more, seen[best], slots[window])
        most[window] = np.where(more, contribution, most[window])
    return slots, most


def contributions(splats: Splats, camera: Camera) -> tuple[Array, Array, Array]:
    """What each splat contributes to a picture: three sums over its pixels, (n,) each.

    The first is of alpha times the transmittance before it, the second of the squares of these.
    The third is of the squares by which red, green and blue change without the splat, which takes
    a picture for each splat.
    """
    weights, energies = np.zeros(len(splats)), np.zeros(len(splats))
    for _, slots, of_pixels in _seen(splats, camera):
        weights[slots] += of_pixels.sum(axis=(1, 2))
        energies[slots] += (of_pixels**2).sum(axis=(1, 2))
    whole = render(splats, camera).rgba[..., :3]
    errors = np.zeros(len(splats))
    for slot in project(splats, camera).slots:
        others = np.delete(np.arange(len(splats)), slot)
        errors[slot] = np.sum((render(splats[others], camera).rgba[..., :3] - whole) ** 2)
    return weights, energies, errors


def dealt(splats: Splats, camera: Camera, values: Array) -> Array:
    """Deals values (height, width) of pixels to splats, (n,), by what each contributes."""
    sums = np.zeros(len(splats))
    for window, slots, weights in _seen(splats, camera):
        sums[slots] += (weights * values[window]).sum(axis=(1, 2))
    return sums


def _seen(
    splats: Splats, camera: Camera
) -> Iterator[tuple[tuple[slice, slice], NDArray[np.intp], Array]]:
    """Yields for each part of a picture its rows and columns, slots (n,), nearest first, and what
    each contributes (n, h, w): alpha times the transmittance before."""
    projected = project(splats, camera)
    projected = projected[_front_to_back(projected, None, len(splats))]
    crop = 0, 0, camera.width, camera.height
    for window, members, weights, _ in _contributed(projected, crop, (MIN_ALPHA, MAX_ALPHA), 0.0):
        yield window, projected.slots[members], weights


def _contributed(
    projected: Projected,
    crop: tuple[int, int, int, int],
    alphas: tuple[float, float],
    min_transmittance: float,
    opaque: Array | None = None,
) -> Iterator[tuple[tuple[slice, slice], NDArray[np.intp], Array, Array]]:
    """Yields rows and columns of each tile of a crop, and parts of the splats in it, nearest first;
    what each adds to each pixel (n, h, w), and at what depth [m].

    alphas: the least alpha that is drawn, and the most that a splat has. opaque: (height, width)
    depths beyond which centres of splats are hidden [m].
    """
    left, top, right, bottom = crop
    for y, x, members in _tiles(projected, left, top, right, bottom):
        ys = np.arange(y, min(y + TILE, bottom))
        xs = np.arange(x, min(x + TILE, right))
        window = np.s_[y - top : y - top + len(ys), x - left : x - left + len(xs)]
        hiding = None if opaque is None else opaque[np.ix_(ys, xs)]
        for part, weights, depths in _weights(
            projected[members], xs, ys, alphas, min_transmittance, hiding
        ):
            yield window, members[part], weights, depths


def _front_to_back(
    projected: Projected, order: NDArray[np.integer] | None, count: int
) -> NDArray[np.intp]:
    """Indices into projected, nearest first; of equal depths the lower slot first."""
    if order is None:
        return np.argsort(projected.keys, kind="stable")
    rank = np.full(count, -1)
    rank[order[::-1]] = np.arange(len(order))
    ranks = rank[projected.slots]
    by_rank = np.argsort(ranks, kind="stable")
    return by_rank[ranks[by_rank] >= 0]


def _tiles(
    projected: Projected, left: int, top: int, right: int, bottom: int
) -> Iterator[tuple[int, int, NDArray[np.intp]]]:
    """Corner y, x of each tile that splats reach, and the indices of these, in their order."""
    tiles = np.array([-(-(right - left) // TILE), -(-(bottom - top) // TILE)])
    corner = np.array([left, top])
    # Clipped first: a splat next to the camera may be larger than an integer holds.
    first = np.floor(np.clip((projected.low - corner) / TILE, 0, tiles))
    last = np.floor(np.clip((projected.high - corner) / TILE, -1, tiles - 1))
    first, spans = first.astype(int), (last - first + 1).astype(int).clip(0)
    # One entry for each pair of splat and tile, numbered within the splat.
    pairs = spans.prod(axis=1)
    splat = np.repeat(np.arange(len(pairs)), pairs)
    number = np.arange(len(splat)) - np.repeat(np.cumsum(pairs) - pairs, pairs)
    column = first[splat, 0] + number % spans[splat, 0]
    row = first[splat, 1] + number // spans[splat, 0]
    tile = row * tiles[0] + column
    by_tile = np.argsort(tile, kind="stable")
    starts = np.flatnonzero(np.diff(tile[by_tile], prepend=-1))
    for members in np.split(by_tile, starts[1:]):
        if len(members):
            y, x = divmod(int(tile[members[0]]), int(tiles[0]))
            yield top + y * TILE, left + x * TILE, splat[members]


def _weights(
    splats: Projected,
    xs: NDArray[np.intp],
    ys: NDArray[np.intp],
    alphas: tuple[float, float],
    min_transmittance: float,
    opaque: Array | None = None,
) -> Iterator[tuple[slice, Array, Array]]:
    """As _contributed, of one tile: parts of the splats in it, weights and depths."""
    min_alpha, max_alpha = alphas
    transmittance = np.ones((len(ys), len(xs)))
    for start in range(0, len(splats.slots), CHUNK):
        part = slice(start, start + CHUNK)
        distances, depths = _along_rays(splats, part, xs, ys)
        peaks = splats.opacities[part, None, None]
        alpha = np.minimum(max_alpha, peaks * np.exp(-0.5 * distances))
        alpha[~(alpha >= min_alpha)] = 0
        if opaque is not None:
            alpha[splats.depths[part, None, None] > opaque] = 0
        alpha = 1 - (1 - alpha) ** splats.shares[part, None, None]
        after = transmittance * np.cumprod(1 - alpha, axis=0)
        before = np.concatenate([transmittance[None], after[:-1]])
        yield part, np.where(after > min_transmittance, alpha * before, 0), depths
        transmittance = after[-1]
        if transmittance.max() <= min_transmittance:
            break


def _along_rays(
    splats: Projected, part: slice, xs: NDArray[np.intp], ys: NDArray[np.intp]
) -> tuple[Array, Array]:
    """(n, h, w) squared distances of pixels' rays from some splats' means, in standard deviations,
    and the depths where rays are nearest to them [m]; views/conic.hpp has the formulae."""
    dx = (xs + 0.5 - splats.centers[part, :1])[:, None, :]
    dy = (ys + 0.5 - splats.centers[part, 1:])[:, :, None]
    xx, xy, yy = splats.conics[part].T[..., None, None]
    tilt_x, tilt_y = splats.tilts[part].T[..., None, None]
    depths = splats.depths[part, None, None]
    flat = xx * dx**2 + 2 * xy * dx * dy + yy * dy**2
    along = 1 + tilt_x * dx + tilt_y * dy
    scale = np.maximum(along**2 + splats.nearness[part, None, None] * flat, 1e-30)
    spots = splats.spots[part, :, None, None]  # NaN, and so never less, where there is none
    spot = SPOT * ((xs + 0.5 - spots[:, 0]) ** 2 + (ys[:, None] + 0.5 - spots[:, 1]) ** 2)
    is_spot = spot < flat / scale
    # A ray that comes nearest to a splat behind the camera meets it at the camera.
    slope_x, slope_y = splats.planes[part].T[..., None, None]
    seen = np.maximum(depths * along / scale + slope_x * dx + slope_y * dy, 0)
    return np.where(is_spot, spot, flat / scale), np.where(is_spot, depths, seen)
