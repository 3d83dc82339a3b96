"""Models of blending, in plain NumPy: what other renderers do with the very same fragments.

A fragment is what one splat leaves in one pixel. All of a band of rows are made at once, so that
each way of blending is a few lines. These are models of methods that our renderer doesn't have:
they tell the error that a method would make, never its time.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rosplat_core.cameras import Camera
from rosplat_core.quaternions import to_matrices
from rosplat_core.splats import Splats
from rosplat_lab.reference.projection import (
    MIN_ALPHA,
    Array,
    Projected,
    project,
)

MAX_ALPHA = 0.99
BAND_FRAGMENTS = 3_000_000  # about as many candidates are held at once
# The customary places of 4 samples in a pixel, from its middle. [px]
SAMPLES = ((-0.125, -0.375), (0.375, -0.125), (-0.375, 0.125), (0.125, 0.375))


@dataclass(frozen=True)
class Fragments:
    """The m fragments of a band of p pixels, by pixel; those of a pixel nearest first."""

    pixels: NDArray[np.intp]
    """(m,) ascending."""
    alphas: Array
    """(m,) MIN_ALPHA to MAX_ALPHA."""
    colors: Array
    """(m, 3) RGB."""
    depths: Array
    """(m,) z of the splat's mean [m], or of what the pixel's ray meets of it."""
    pixel_count: int
    """p."""

    def sorted_by_depth(self) -> Fragments:
        """The same fragments, in each pixel by their own depths."""
        by_depth = np.lexsort((self.depths, self.pixels))
        return Fragments(
            self.pixels[by_depth],
            self.alphas[by_depth],
            self.colors[by_depth],
            self.depths[by_depth],
            self.pixel_count,
        )

    def sums(self, values: Array) -> Array:
        """(p, ...) sums of (m, ...) values over the fragments of each pixel."""
        total = np.zeros((self.pixel_count, *values.shape[1:]))
        firsts = np.flatnonzero(np.diff(self.pixels, prepend=-1))
        if len(firsts):
            total[self.pixels[firsts]] = np.add.reduceat(values, firsts, axis=0)
        return total

    def transmittances(self) -> Array:
        """(m,) what is left of the light in front of each fragment."""
        logs = np.log1p(-self.alphas)
        through = np.concatenate([[0.0], np.cumsum(logs)])[:-1]
        firsts = np.flatnonzero(np.diff(self.pixels, prepend=-1))
        counts = np.diff(np.append(firsts, len(self.pixels)))
        result: Array = np.exp(through - np.repeat(through[firsts], counts))
        return result


Blend = Callable[[Fragments], Array]
"""Makes (p, 3) RGB over black of a band's fragments."""


@dataclass(frozen=True)
class Alphas:
    """Which fragments count, and how much at most."""

    least: float = MIN_ALPHA
    most: float = MAX_ALPHA


def picture(
    splats: Splats,
    camera: Camera,
    blend: Blend,
    *,
    ray_depths: bool = False,
    cutoff_sigmas: float = math.inf,
    alphas: Alphas = Alphas(),
) -> Array:
    """(height, width, 3) RGB over black of splats blended in another way.

    ray_depths: a fragment's depth is where its pixel's ray meets the most of the splat, not the
    mean's z. cutoff_sigmas: a splat ends there, unless its alpha falls below the least before.
    """
    projected = nearest_first(project(splats, camera))
    rays = _RayDepths(splats[projected.slots], camera) if ray_depths else None
    return blended(projected, camera, blend, rays=rays, cutoff_sigmas=cutoff_sigmas, alphas=alphas)


def multisampled(splats: Splats, camera: Camera) -> Array:
    """(height, width, 3) RGB over black with 4 samples a pixel and quads to the 1/255 ellipse.

    A fragment is shaded once, at the pixel's middle, and blended into the samples that its quad
    covers: only the quads' edges differ.
    """
    projected = nearest_first(project(splats, camera))
    samples = [blended(projected, camera, over, sample=place) for place in SAMPLES]
    mean: Array = np.mean(samples, axis=0)
    return mean


def nearest_first(projected: Projected) -> Projected:
    """By z; of equal depths the lower slot first."""
    return projected[np.argsort(projected.depths, kind="stable")]


def blended(
    projected: Projected,
    camera: Camera,
    blend: Blend,
    *,
    rays: _RayDepths | None = None,
    cutoff_sigmas: float = math.inf,
    alphas: Alphas = Alphas(),
    sample: tuple[float, float] | None = None,
) -> Array:
    """The same of splats that are projected already, nearest first; rays are of these.

    sample: where in a pixel, from its middle, a splat's quad must be to count there [px].
    """
    rgb = np.zeros((camera.height * camera.width, 3))
    for first, rows in _bands(projected, camera):
        band = _fragments(projected, camera, first, rows, cutoff_sigmas, rays, alphas, sample)
        start = first * camera.width
        rgb[start : start + band.pixel_count] = blend(band)
    return rgb.reshape(camera.height, camera.width, 3)


def over(fragments: Fragments) -> Array:
    """The exact blend, front to back."""
    weights = fragments.alphas * fragments.transmittances()
    return fragments.sums(weights[:, None] * fragments.colors)


def over_by_pixel(fragments: Fragments) -> Array:
    """Each pixel sorts for itself (Radl et al. 2024, StopThePop)."""
    return over(fragments.sorted_by_depth())


def weighted_oit(fragments: Fragments) -> Array:
    """Weighted blended order-independent transparency (McGuire and Bavoil 2013, equation 10)."""
    if not len(fragments.pixels):
        return np.zeros((fragments.pixel_count, 3))
    depths = fragments.depths
    nearness = 1 - (depths - depths.min()) / max(float(np.ptp(depths)), 1e-12)
    weights = fragments.alphas * np.maximum(1e-2, 3e3 * nearness**3)
    color = fragments.sums(weights[:, None] * fragments.colors)
    mean = color / np.maximum(fragments.sums(weights), 1e-300)[:, None]
    through: Array = np.exp(fragments.sums(np.log1p(-fragments.alphas)))
    return mean * (1 - through)[:, None]


def stochastic(samples: int, seed: int = 0) -> Blend:
    """Stochastic transparency (Enderton et al. 2010): each sample keeps the nearest fragment that
    wins a toss of probability alpha.

    A sample's first win is fragment k with the probability of what exact blending gives it, so one
    number a sample looked up among the sums of these is the same as a toss for each fragment.
    """

    def blend(fragments: Fragments) -> Array:
        random = np.random.default_rng(seed)
        weights = fragments.alphas * fragments.transmittances()
        total = np.cumsum(weights)
        firsts = np.flatnonzero(np.diff(fragments.pixels, prepend=-1))
        counts = np.diff(np.append(firsts, len(weights)))
        # pixel + probability so far: ascending over the whole band
        before = np.concatenate([[0.0], total])[firsts]
        ladder = fragments.pixels + np.minimum(total - np.repeat(before, counts), 1 - 1e-9)
        rgb = np.zeros((fragments.pixel_count, 3))
        covered = fragments.pixels[firsts]
        for _ in range(samples):
            tossed = covered + random.random(len(covered))
            winners = np.searchsorted(ladder, tossed, side="right")
            won = winners < firsts + counts
            rgb[covered[won]] += fragments.colors[winners[won]]
        return rgb / samples

    return blend


def rounded(levels: int, *, front_to_back: bool = False) -> Blend:
    """Blending in a target of so many levels a channel, rounded after each fragment.

    255 is RGBA8. Back to front colour = source + (1 - alpha) colour; front to back the target's
    alpha is rounded as well (what fixed function blending can do in that order).
    """

    def blend(fragments: Fragments) -> Array:
        p = fragments.pixel_count
        firsts = np.flatnonzero(np.diff(fragments.pixels, prepend=-1))
        counts = np.diff(np.append(firsts, len(fragments.pixels)))
        # Deepest pixels first, so that the pixels with a k-th fragment are always a prefix.
        deepest = np.argsort(-counts, kind="stable")
        firsts, counts = firsts[deepest], counts[deepest]
        target = np.zeros((len(firsts), 4))
        source = np.column_stack([fragments.colors, np.ones(len(fragments.alphas))])
        source *= fragments.alphas[:, None]
        for k in range(int(counts.max(initial=0))):
            active = np.searchsorted(-counts, -k, side="left")  # counts > k
            if front_to_back:
                new = source[firsts[:active] + k]
                blended = target[:active] + (1 - target[:active, 3:]) * new
            else:
                new = source[firsts[:active] + counts[:active] - 1 - k]
                blended = new + (1 - new[:, 3:]) * target[:active]
            target[:active] = np.rint(np.clip(blended, 0, 1) * levels) / levels
        rgb = np.zeros((p, 3))
        rgb[fragments.pixels[firsts]] = target[:, :3]
        return rgb

    return blend


class _RayDepths:
    """Depth at which a pixel's ray meets the most of a splat: the ray d reaches it at d P m / d P d
    for a mean m and a precision P in the camera's frame."""

    def __init__(self, splats: Splats, camera: Camera) -> None:
        turn = camera.world_to_camera[:3, :3]
        world = splats.positions.astype(np.float64) + splats.origin
        means = world @ turn.T + camera.world_to_camera[:3, 3]
        scales = splats.scales.astype(np.float64)
        # A disc without thickness has no precision matrix: a thousandth of its size will do.
        scales = np.maximum(scales, 1e-3 * scales.max(axis=1, keepdims=True))
        axes = turn @ to_matrices(splats.orientations) / scales[:, None, :]
        precisions = axes @ axes.transpose(0, 2, 1)
        self._targets = np.einsum("nij,nj->ni", precisions, means)
        upper = np.triu_indices(3)
        self._precisions = precisions[:, upper[0], upper[1]]
        self._depths = means[:, 2]
        self._camera = camera

    def __call__(self, splat: NDArray[np.intp], x: NDArray[Any], y: NDArray[Any]) -> Array:
        camera = self._camera
        if camera.orthographic:  # rays don't meet in a point: the mean's depth is close enough
            means: Array = self._depths[splat]
            return means
        dx, dy = (x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy
        bx, by, bz = self._targets[splat].T
        xx, xy, xz, yy, yz, zz = self._precisions[splat].T
        along = dx * bx + dy * by + bz
        across = xx * dx**2 + yy * dy**2 + zz + 2 * (xy * dx * dy + xz * dx + yz * dy)
        depths: Array = along / across
        return depths


def _bands(projected: Projected, camera: Camera) -> Iterator[tuple[int, int]]:
    """First row and number of rows of bands that hold about BAND_FRAGMENTS candidates each."""
    top, bottom, left, right = _boxes(projected, camera, 0, camera.height)
    width = right - left
    load = np.zeros(camera.height + 1)
    np.add.at(load, top, width)
    np.add.at(load, bottom, -width)
    total = np.cumsum(np.cumsum(load)[:-1])
    first = 0
    while first < camera.height:
        before = total[first - 1] if first else 0
        last = int(np.searchsorted(total, before + BAND_FRAGMENTS))
        rows = min(max(1, last - first), camera.height - first)
        yield first, rows
        first += rows


def _boxes(
    projected: Projected, camera: Camera, first: int, end: int
) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]:
    """Top, bottom, left, right of the pixels whose centres a splat's box can hold, clipped."""
    lower, upper = projected.centers - projected.extents, projected.centers + projected.extents
    top = np.clip(np.ceil(lower[:, 1] - 0.5), first, end).astype(np.intp)
    bottom = np.clip(np.floor(upper[:, 1] - 0.5) + 1, first, end).astype(np.intp)
    left = np.clip(np.ceil(lower[:, 0] - 0.5), 0, camera.width).astype(np.intp)
    right = np.clip(np.floor(upper[:, 0] - 0.5) + 1, 0, camera.width).astype(np.intp)
    return top, np.maximum(top, bottom), left, np.maximum(left, right)


def _fragments(
    projected: Projected,
    camera: Camera,
    first: int,
    rows: int,
    cutoff_sigmas: float,
    rays: _RayDepths | None,
    allowed: Alphas,
    sample: tuple[float, float] | None,
) -> Fragments:
    top, bottom, left, right = _boxes(projected, camera, first, first + rows)
    widths = right - left
    counts = (bottom - top) * widths
    splat = np.repeat(np.arange(len(counts)), counts)
    number = np.arange(len(splat)) - np.repeat(np.cumsum(counts) - counts, counts)
    row, column = np.divmod(number, widths[splat])
    y, x = top[splat] + row, left[splat] + column
    dx = x + 0.5 - projected.centers[splat, 0]
    dy = y + 0.5 - projected.centers[splat, 1]
    xx, xy, yy = projected.conics[splat].T
    square = xx * dx**2 + yy * dy**2 + 2 * xy * dx * dy
    alphas = np.minimum(allowed.most, projected.opacities[splat] * np.exp(-0.5 * square))
    kept = np.flatnonzero((alphas >= allowed.least) & (square <= cutoff_sigmas**2))
    if sample:
        place = np.column_stack([dx[kept], dy[kept]]) + sample
        kept = kept[_in_quad(projected, splat[kept], place)]
    pixels = (y[kept] - first) * camera.width + x[kept]
    kept = kept[np.argsort(pixels, kind="stable")]
    splat, x, y = splat[kept], x[kept], y[kept]
    return Fragments(
        pixels=(y - first) * camera.width + x,
        alphas=alphas[kept],
        colors=projected.colors[splat],
        depths=rays(splat, x + 0.5, y + 0.5) if rays else projected.depths[splat],
        pixel_count=rows * camera.width,
    )


def _in_quad(projected: Projected, splat: NDArray[np.intp], offsets: Array) -> NDArray[np.bool_]:
    """Whether points at (m, 2) offsets from splats' centres [px] are in their 1/255 squares."""
    xx, xy, yy = projected.conics.T
    inverses, axes = np.linalg.eigh(np.stack([xx, xy, xy, yy], axis=1).reshape(-1, 2, 2))
    along = np.einsum("mij,mi->mj", axes[splat], offsets) * np.sqrt(inverses[splat])
    reach = np.sqrt(2 * np.log(projected.opacities[splat] / MIN_ALPHA))
    inside: NDArray[np.bool_] = (np.abs(along) <= reach[:, None]).all(axis=1)
    return inside
