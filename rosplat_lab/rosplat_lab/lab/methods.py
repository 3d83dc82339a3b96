"""The methods that are held against each other: a line each in METHODS adds one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rosplat_core.cameras import Camera
from rosplat_core.rendering import Rasterizer
from rosplat_core.splats import Splats
from rosplat_core.view import OVERSCAN
from rosplat_lab.bench import baselines
from rosplat_lab.lab import fragments, motion, orders, viewers
from rosplat_lab.lab.bench import Bench, Image, Shot, Sort
from rosplat_lab.lab.orders import Order
from rosplat_sorter.backends import BACKENDS

Shoot = Callable[[Bench, Camera], Shot]
Model = Callable[[Splats, Camera], Image]
"""Draws (height, width, 3) RGB over black without a renderer."""
Change = Callable[[Splats], Splats]

# Why a method's time or error isn't held against others'.
MODEL = "a model"
MOVING = "under motion"
NUMPY = "sorted or culled by NumPy"
ELSEWHERE = "another viewer's"


@dataclass(frozen=True)
class Method:
    """A way to a picture."""

    name: str
    """Unique, and new when its meaning changes: results are kept by it."""
    family: str
    """What it varies: methods of a family are one curve."""
    shoot: Shoot | None = None
    """By the renderer; None: it has no time."""
    model: Model | None = None
    """In NumPy, where the renderer can't; then the picture is this one."""
    aside: str = ""
    """Why it is not held against others, empty where it is."""
    change: Change | None = None
    """Made of the map before it is shown; its function has a result for the same argument once."""
    available: Callable[[Bench], bool] = lambda bench: True


def modelled(name: str, family: str, model: Model) -> Method:
    """A method that has an error, but no time."""
    return Method(name, family, model=model, aside=MODEL)


def blending(blend: fragments.Blend, **options: Any) -> Model:
    """A model of another blend."""
    return lambda splats, camera: fragments.picture(splats, camera, blend, **options)


def sorted_by(backend: str) -> Sort:
    """A backend's order; empty: whichever is there."""
    return lambda bench, camera: bench.order(camera, backend)


def as_displayed(bench: Bench, camera: Camera) -> Order | None:
    """As the Display does it at rest: a graphics card sorts by itself, else a sorter does."""
    return None if bench.accelerated else bench.order(camera)


def by_renderer(bench: Bench, camera: Camera) -> None:
    """The renderer's own sort on the GPU, whose time is part of drawing."""


def by_baseline(make: Callable[[baselines.Positions], baselines.Sort]) -> Sort:
    """Another viewer's sort, of all that there is."""
    return lambda bench, camera: bench.baseline(make, camera)


def by_keys(quantise: orders.Quantise, distance: Any = orders.by_z) -> Sort:
    """An order by other keys, made in NumPy."""
    return lambda bench, camera: orders.keyed(bench.view(camera), bench.map, quantise, distance)


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
    """The exact order of some frames ago, culled for a picture so many times as wide."""

    def sort(bench: Bench, camera: Camera) -> Order:
        target = motion.typical_bounds(bench.splats).mean(axis=0)
        past = motion.before(camera, kind, speed, frames / motion.FRAME_RATE, target)
        return bench.order(widened(past, culled / OVERSCAN))

    return sort


def no_sort(bench: Bench, camera: Camera) -> Order:
    """What is visible, as it lies in the map."""
    return orders.unsorted(bench.view(camera), bench.map)


def most_worth(share: float) -> Sort:
    """The part of the exact order with the largest opacity times area."""

    def sort(bench: Bench, camera: Camera) -> Order:
        order = bench.order(camera)
        sizes = orders.radii(bench.view(camera), bench.map, order)
        return orders.budget(order, bench.splats.opacities[order] * sizes**2, share)

    return sort


def large_enough(pixels: float) -> Sort:
    """The exact order without splats of a smaller half size."""

    def sort(bench: Bench, camera: Camera) -> Order:
        order = bench.order(camera)
        return orders.at_least(order, orders.radii(bench.view(camera), bench.map, order), pixels)

    return sort


def drawn(
    sort: Sort = as_displayed, age: int = 0, float_blending: bool = True, **settings: Any
) -> Shoot:
    """By the renderer. In 32-bit floats, so that only what a method varies makes its error."""
    settings["float_blending"] = float_blending
    return lambda bench, camera: bench.shoot(camera, sort, age, **settings)


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


def _aged(frames: int, kind: str, speed: float) -> Method:
    return Method(
        f"{kind} at {speed:g}/s, {frames} frames old", f"age {kind}, {speed:g}/s",
        drawn(stale(frames, kind, speed), age=frames), aside=MOVING,
    )  # fmt: skip


def _shadygm(library: str, make: Callable[[baselines.Positions], baselines.Sort]) -> Method:
    """Its own sort and all splats drawn, here as our quads; the picture as its shaders make it."""
    return Method(
        f"shadygm/ROSplat, {library}", "other viewers",
        drawn(by_baseline(make), float_blending=False, rasterizer=Rasterizer.QUADS),
        model=viewers.shadygm, aside=ELSEWHERE,
        available=lambda b: library not in BACKENDS or (library in b.backends and b.accelerated),
    )  # fmt: skip


HALF = ("scales", "orientations", "opacities", "sh")
BITS = (20, 16, 12, 10, 8)

METHODS: tuple[Method, ...] = (
    # The same order from each backend, and from the renderer.
    *(_sorter(name) for name in BACKENDS),
    Method("sorted by the renderer", "sorter", drawn(by_renderer)),
    # What the keys hold.
    Method("keys z 32 bit", "keys", drawn(by_keys(orders.full)), aside=NUMPY),
    *(
        Method(
            f"keys {name} {bits} bit", f"keys {name}", drawn(by_keys(quantise(bits))), aside=NUMPY
        )
        for name, quantise in (
            ("linear", orders.linear), ("adaptive", orders.equalised), ("float", orders.truncated),
        )
        for bits in BITS
    ),
    Method(
        "keys radial 32 bit", "keys", drawn(by_keys(orders.full, orders.by_distance)), aside=NUMPY
    ),
    Method("unsorted", "keys", drawn(no_sort), aside=NUMPY),
    # How old the order is: speeds in rad/s, or in distances to the scene a second.
    *(
        _aged(frames, kind, speed)
        for kind, speeds in (("rotation", (0.3, 1, 3)), ("orbit", (0.3, 1, 3)), ("dolly", (1, 3)))
        for speed in speeds
        for frames in (1, 2, 5, 10)
    ),
    *(
        Method(
            f"rotation at 1/s, {frames} frames old, culled {culled:g}x",
            f"age rotation, 1/s, culled {culled:g}x",
            drawn(stale(frames, "rotation", culled=culled), age=frames), aside=MOVING,
        )
        for culled in (1.0, 1.5)
        for frames in (1, 2, 5, 10)
    ),
    # What is blended, and in what.
    Method("quads, to RGBA32F", "blend", drawn(rasterizer=Rasterizer.QUADS)),
    Method(
        "quads, to RGBA16F", "blend", drawn(float_blending=False, rasterizer=Rasterizer.QUADS)
    ),
    Method("tiles, to RGBA32F", "blend", drawn(rasterizer=Rasterizer.TILES)),
    Method(
        "tiles, to RGBA16F", "blend", drawn(float_blending=False, rasterizer=Rasterizer.TILES)
    ),
    modelled("quads, to RGBA8", "blend", blending(fragments.rounded(255))),
    modelled(
        "front to back, to RGBA8", "blend", blending(fragments.rounded(255, front_to_back=True))
    ),
    modelled("quads, 4 samples a pixel", "blend", fragments.multisampled),
    modelled(
        "sorted for each pixel", "order of pixels",
        blending(fragments.over_by_pixel, ray_depths=True),
    ),
    modelled("weighted blended OIT", "order-free", blending(fragments.weighted_oit)),
    *(
        modelled(f"stochastic {n}", "stochastic", blending(fragments.stochastic(n)))
        for n in (1, 4, 16, 64)
    ),
    *(
        modelled(
            f"quads to {name} sigma", "cut-off", blending(fragments.over, cutoff_sigmas=sigmas)
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
    # How many splats are drawn, and how much of them.
    *(
        Method(f"budget {share:.0%}", "budget", drawn(most_worth(share)), aside=NUMPY)
        for share in (0.9, 0.75, 0.5, 0.25)
    ),
    *(
        Method(f"from {pixels} px", "least size", drawn(large_enough(pixels)), aside=NUMPY)
        for pixels in (0.5, 1, 2)
    ),
    # What others do.
    _shadygm("torch", baselines.torch_uploading),
    _shadygm("cupy", baselines.cupy_uploading),
    _shadygm("np.argsort", baselines.argsort),
    modelled(
        "shadygm/ROSplat without its gamma", "other viewers",
        partial(viewers.shadygm, gamma=1.0),
    ),
    modelled("RVizSplat 1.0.0", "other viewers", viewers.rvizsplat),
)  # fmt: skip
