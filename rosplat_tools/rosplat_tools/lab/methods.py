"""The methods that are held against each other: a line each in METHODS adds one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rosplat_sorter.backends import BACKENDS
from rosplat_sorter.view import OVERSCAN
from rosplat_tools.cameras import Camera
from rosplat_tools.lab import fragments, motion, orders
from rosplat_tools.lab.bench import Bench, Image
from rosplat_tools.lab.orders import Order
from rosplat_tools.splats import Splats
from rviz_gaussian_plugin.offscreen import Rasterizer


@dataclass(frozen=True)
class Shot:
    """A picture and what it cost."""

    picture: Image
    """(height, width, 3) RGB over black."""
    sort_ms: float | None = None
    """None for models: they have no time."""
    draw_ms: float | None = None
    splats: int | None = None
    """How many were drawn."""


Shoot = Callable[[Bench, Camera], Shot]
Sort = Callable[[Bench, Camera], tuple[Order, float]]
"""An order and its time [ms]."""
OwnSort = Callable[[Bench, Camera], tuple[None, float]]
"""No order: the renderer sorts."""
Change = Callable[[Splats], Splats]


@dataclass(frozen=True)
class Method:
    """A way to a picture."""

    name: str
    """Unique, and new when its meaning changes: results are kept by it."""
    family: str
    """What it varies: methods of a family are one curve."""
    shoot: Shoot
    model: bool = False
    """A NumPy model of what the renderer can't do, not a setting of the renderer."""
    change: Change | None = None
    """Made of the map before it is shown; its function has a result for the same argument once."""
    available: Callable[[Bench], bool] = lambda bench: True


def sorted_by(backend: str) -> Sort:
    """A backend's order; empty: whichever is there."""
    return lambda bench, camera: bench.order(camera, backend)


def by_keys(quantise: orders.Quantise, distance: Any = orders.by_z) -> Sort:
    """An order by other keys, made in NumPy."""

    def sort(bench: Bench, camera: Camera) -> tuple[Order, float]:
        view = bench.view(camera)
        return bench.timed(lambda: orders.keyed(view, bench.map, quantise, distance))

    return sort


def widened(camera: Camera, factor: float) -> Camera:
    """The camera with a picture so many times as wide and high, around the same middle."""
    width, height = round(factor * camera.width), round(factor * camera.height)
    return replace(
        camera,
        width=width,
        height=height,
        cx=camera.cx + (width - camera.width) / 2,
        cy=camera.cy + (height - camera.height) / 2,
    )


def stale(frames: int, kind: str, speed: float = 1.0, culled: float = OVERSCAN) -> Sort:
    """The exact order of some frames ago, its time shared by the frames that draw it.

    culled: for a picture so many times as wide.
    """

    def sort(bench: Bench, camera: Camera) -> tuple[Order, float]:
        target = motion.typical_bounds(bench.splats).mean(axis=0)
        seconds = frames / motion.FRAME_RATE
        past = motion.before(camera, kind, speed, seconds, target)
        order, milliseconds = bench.order(widened(past, culled / OVERSCAN))
        return order, milliseconds / (frames + 1)

    return sort


def by_renderer(bench: Bench, camera: Camera) -> tuple[None, float]:
    """The renderer's own sort on the GPU, whose time is part of drawing."""
    return None, 0.0


def no_sort(bench: Bench, camera: Camera) -> tuple[Order, float]:
    """What is visible, as it lies in the map."""
    view = bench.view(camera)
    return bench.timed(lambda: orders.unsorted(view, bench.map))


def most_worth(share: float, of: Sort) -> Sort:
    """The part of an order with the largest opacity times area."""

    def sort(bench: Bench, camera: Camera) -> tuple[Order, float]:
        order, milliseconds = of(bench, camera)

        def cull() -> Order:
            sizes = orders.radii(bench.view(camera), bench.map, order)
            return orders.budget(order, bench.splats.opacities[order] * sizes**2, share)

        kept, culling = bench.timed(cull)
        return kept, milliseconds + culling

    return sort


def large_enough(pixels: float) -> Sort:
    """The exact order without splats of a smaller half size."""

    def sort(bench: Bench, camera: Camera) -> tuple[Order, float]:
        order, milliseconds = bench.order(camera)

        def cull() -> Order:
            return orders.at_least(
                order, orders.radii(bench.view(camera), bench.map, order), pixels
            )

        kept, culling = bench.timed(cull)
        return kept, milliseconds + culling

    return sort


EXACT = sorted_by("")


def drawn(sort: Sort | OwnSort = EXACT, float_blending: bool = True, **settings: Any) -> Shoot:
    """By the renderer. In 32-bit floats, so that only what a method varies makes its error."""

    def shoot(bench: Bench, camera: Camera) -> Shot:
        order, sort_ms = sort(bench, camera)
        picture, draw_ms = bench.draw(camera, order, float_blending=float_blending, **settings)
        return Shot(picture, sort_ms, draw_ms, None if order is None else len(order))

    return shoot


def modelled(blend: fragments.Blend, **options: Any) -> Shoot:
    """By a model of blending."""
    return lambda bench, camera: Shot(fragments.picture(bench.splats, camera, blend, **options))


def halves(*names: str) -> Change:
    """Attributes in 16-bit floats; positions relative to the middle of their page of 256 slots."""

    def change(splats: Splats) -> Splats:
        changed: dict[str, Any] = {}
        for name in names:
            values = getattr(splats, name)
            middle = _page_middles(values) if name == "positions" else np.float32(0)
            changed[name] = (values - middle).astype(np.float16).astype(np.float32) + middle
        return replace(splats, **changed)

    return change


def packed(sh_bits: int = 8) -> Change:
    """About what SPZ keeps: scales by their logarithms and rotations in 8 bits, 24-bit positions,
    opacities in 8 bits, spherical harmonics in sh_bits over -2..2."""

    def rounded(values: NDArray[Any], low: float, high: float, bits: int) -> NDArray[np.float32]:
        steps = (2**bits - 1) / (high - low)
        result: NDArray[np.float32] = (
            np.rint((np.clip(values, low, high) - low) * steps) / steps + low
        ).astype(np.float32)
        return result

    def change(splats: Splats) -> Splats:
        low, high = float(splats.positions.min()), float(splats.positions.max())
        logs = np.log(np.maximum(splats.scales, 1e-9))
        turns = splats.orientations / np.abs(splats.orientations).max(axis=1, keepdims=True)
        return replace(
            splats,
            positions=rounded(splats.positions, low, high, 24),
            scales=np.exp(rounded(logs, -12, 4, 8)),
            orientations=rounded(turns, -1, 1, 8),
            opacities=rounded(splats.opacities, 0, 1, 8),
            sh=np.concatenate(
                [splats.sh[:, :1], rounded(splats.sh[:, 1:], -2, 2, sh_bits)], axis=1
            ),
        )

    return change


def _page_middles(positions: NDArray[np.float32], page: int = 256) -> NDArray[np.float32]:
    firsts = np.arange(0, len(positions), page)
    lower = np.minimum.reduceat(positions, firsts)
    upper = np.maximum.reduceat(positions, firsts)
    middles = np.repeat(np.float32(0.5) * (lower + upper), page, axis=0)[: len(positions)]
    return middles.astype(np.float32)


def _sorter(name: str) -> Method:
    return Method(
        f"sorter {name}", "sorter", drawn(sorted_by(name)), available=lambda b: name in b.backends
    )


HALF = ("scales", "orientations", "opacities", "sh")

METHODS: tuple[Method, ...] = (
    # The same order from each backend: what the time of sorting is made of.
    *(_sorter(name) for name in BACKENDS),
    # What the keys hold.
    Method("keys z 32 bit", "keys", drawn(by_keys(orders.full))),
    *(
        Method(f"keys linear {bits} bit", "keys linear", drawn(by_keys(orders.linear(bits))))
        for bits in (20, 16, 12, 10, 8)
    ),
    *(
        Method(f"keys adaptive {b} bit", "keys adaptive", drawn(by_keys(orders.equalised(b))))
        for b in (20, 16, 12, 10, 8)
    ),
    *(
        Method(f"keys float {bits} bit", "keys float", drawn(by_keys(orders.truncated(bits))))
        for bits in (20, 16, 12, 10, 8)
    ),
    Method("keys radial 32 bit", "keys", drawn(by_keys(orders.full, orders.by_distance))),
    Method("unsorted", "keys", drawn(no_sort)),
    # How old the order is, under motion of 1 rad/s, or 1 distance to the scene a second.
    *(
        Method(f"{kind}, {frames} frames old", f"age {kind}", drawn(stale(frames, kind)))
        for kind in ("rotation", "orbit", "dolly")
        for frames in (1, 2, 5, 10)
    ),
    *(
        Method(
            f"rotation, {frames} frames old, culled {culled:g}x",
            f"age rotation, culled {culled:g}x", drawn(stale(frames, "rotation", culled=culled)),
        )
        for culled in (1.0, 1.5)
        for frames in (1, 2, 5, 10)
    ),
    # What is blended, and in what.
    Method("blend RGBA32F", "blend", drawn(rasterizer=Rasterizer.QUADS)),
    Method(
        "blend RGBA16F", "blend", drawn(float_blending=False, rasterizer=Rasterizer.QUADS)
    ),
    Method("tiles, to RGBA32F", "tiles", drawn(rasterizer=Rasterizer.TILES)),
    Method(
        "tiles, to RGBA16F", "tiles", drawn(float_blending=False, rasterizer=Rasterizer.TILES)
    ),
    Method(
        "tiles, sorted by the renderer", "tiles",
        drawn(by_renderer, rasterizer=Rasterizer.TILES),
    ),
    Method(
        "quads, sorted by the renderer", "blend",
        drawn(by_renderer, rasterizer=Rasterizer.QUADS),
    ),
    Method("blend RGBA8", "blend", modelled(fragments.rounded(255)), model=True),
    Method(
        "blend RGBA8, front to back", "blend",
        modelled(fragments.rounded(255, front_to_back=True)), model=True,
    ),
    Method(
        "sorted for each pixel", "order of pixels",
        modelled(fragments.over_by_pixel, ray_depths=True), model=True,
    ),
    Method("weighted blended OIT", "order-free", modelled(fragments.weighted_oit), model=True),
    *(
        Method(f"stochastic {n}", "stochastic", modelled(fragments.stochastic(n)), model=True)
        for n in (1, 4, 16, 64)
    ),
    *(
        Method(
            f"quads to {name} sigma", "cut-off",
            modelled(fragments.over, cutoff_sigmas=sigmas), model=True,
        )
        for name, sigmas in (("3", 3.0), ("sqrt 8", 8**0.5), ("2.5", 2.5), ("2", 2.0))
    ),
    # What is kept of a splat.
    *(Method(f"SH degree {d}", "SH degree", drawn(max_sh_degree=d)) for d in (2, 1, 0)),
    Method("half floats, but positions", "precision", drawn(), change=halves(*HALF)),
    Method("half floats", "precision", drawn(), change=halves("positions", *HALF)),
    Method("half floats, SH alone", "precision", drawn(), change=halves("sh")),
    Method("packed, SH in 8 bits", "packed", drawn(), change=packed(8)),
    Method("packed, SH in 4 bits", "packed", drawn(), change=packed(4)),
    # How many splats are drawn.
    *(
        Method(f"budget {share:.0%}", "budget", drawn(most_worth(share, EXACT)))
        for share in (0.9, 0.75, 0.5, 0.25)
    ),
    *(
        Method(f"from {pixels} px", "least size", drawn(large_enough(pixels)))
        for pixels in (0.5, 1, 2)
    ),
    *(
        Method(f"worth {pixels} px", "least worth", drawn(least_worth=float(pixels)))
        for pixels in (0.25, 0.5, 1, 2, 4)
    ),
    # All at once: the Display's property Quality.
    Method("quality exact", "quality", drawn()),
    Method(
        "quality balanced", "quality",
        drawn(stale(1, "rotation"), float_blending=False),
    ),
    Method(
        "quality fast", "quality",
        drawn(stale(1, "rotation"), float_blending=False, least_worth=1.0),
    ),
)  # fmt: skip
