"""How long a picture takes, and what memory a map takes to be drawn."""

from __future__ import annotations

import ctypes
import gc
from collections.abc import Iterator, Sequence
from functools import partial
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rosplat_core import rendering
from rosplat_core.cameras import Camera
from rosplat_core.models import Model
from rosplat_core.ordering import depth_order
from rosplat_core.program import machine
from rosplat_core.rendering import Rasterizer
from rosplat_core.scenes import ROOMS
from rosplat_core.splats import InputError, Splats
from rosplat_lab.bench import scenes, truths
from rosplat_lab.bench.isolation import isolated
from rosplat_lab.bench.plan import GPU, Plan
from rosplat_lab.bench.records import (
    Budget,
    Doing,
    Event,
    Measurement,
    Skipped,
    in_a_row,
    milliseconds,
)
from rosplat_lab.bench.renderers import (
    RENDERERS,
    WARM_UP,
    DisplayRenderer,
    accelerated,
    in_turn,
)

SIZES = (100_000, 500_000, 1_000_000, 2_000_000, 5_000_000)
SOFTWARE_SIZES = (100_000, 500_000)  # where no GPU draws
QUICK_SIZES = (50_000,)
CARD_PICTURES = (*scenes.PICTURES, (3840, 2160))
STEPS = 8  # cameras that take turns
PROFILED = Budget(least=3, most=30, seconds=0.5)  # frames whose stages are measured

FOUR_MAPS = "four maps"  # the scene as so many interleaved ones
# By name, how the display's renderer draws otherwise than by default: settings, fields of
# RenderSettings. Each of its rasterisers is a variant.
VARIANTS: dict[str, dict[str, Any]] = {
    "default": {},
    **{name.lower(): {"rasterizer": name} for name in Rasterizer.__members__ if name != "AUTO"},
    FOUR_MAPS: {},
    # The same map, as if it had been trained so.
    **{str(model): {"model": model} for model in (Model.EWA, Model.RAY, Model.DISC)},
}
FEW_VARIANTS = ("default",)  # of a quick run, and where no GPU draws

GIVEN = "given"  # each camera gets a sorter's order: what a frame costs beside sorting
ON_CARD = "sorted in the frame, GPU"
ORDERS = {GIVEN: "native", ON_CARD: GPU}
"""Whose order frames have, by what sorts, as `--backends` names it."""

Look = tuple[tuple[int, int], str]
"""A size of pictures, and a view."""
Truths = dict[Look, truths.Truth]
"""The truth of the first camera of each look."""


def measure(plan: Plan) -> Iterator[Event]:
    """Frame times and errors by scene, picture, view, settings and order; memory."""
    try:
        from rviz_gaussian_plugin.offscreen import ensure_display
    except ImportError as error:
        yield Skipped(f"the renderer is not built here: {error}")
        return
    known = VARIANTS.keys() | RENDERERS.keys()
    if unknown := set(plan.variants) - known:
        names = ", ".join(sorted(known))
        raise InputError(f"unknown variant '{unknown.pop()}', known are {names}")
    try:
        with ensure_display():
            sizes: tuple[int, ...] = SIZES
            pictures: tuple[tuple[int, int], ...] = CARD_PICTURES
            usual: tuple[str, ...] = tuple(VARIANTS)
            if not accelerated():
                sizes, usual, pictures = SOFTWARE_SIZES, FEW_VARIANTS, scenes.PICTURES
            if plan.quick:
                sizes, usual = QUICK_SIZES, FEW_VARIANTS
            chosen = plan.variants or (*usual, *RENDERERS)
            ours = [variant for variant in chosen if variant in VARIANTS]
            jobs = []
            # In rooms walls hide much; in the garden little is hidden.
            rooms = () if plan.quick or plan.sizes else (f"{ROOMS}{max(sizes)}",)
            for name in scenes.names(plan.sizes or sizes, plan.scenes or rooms):
                looks = list(product(pictures, scenes.views(name)))[: 1 if plan.quick else None]
                told: Truths = {}
                jobs.append(partial(_draw_truths, name, looks, told))
                for whole in (True, False):  # not one of four maps
                    if alike := [which for which in ours if (which != FOUR_MAPS) == whole]:
                        maps = 1 if whole else 4
                        jobs.append(partial(isolated, _scene, plan, name, looks, told, alike, maps))
                if beside := [renderer for renderer in chosen if renderer in RENDERERS]:
                    jobs.append(partial(isolated, _beside, plan, name, looks, told, beside))
            yield from in_a_row(jobs)
    except RuntimeError as error:
        yield Skipped(f"pictures: {error}")


def _draw_truths(name: str, looks: Sequence[Look], told: Truths) -> Iterator[Event]:
    """Fills told for these looks at a scene."""
    yield Doing(f"{name}: reference", 0.0)
    found = truths.draw(name, [partial(_first, look) for look in looks])
    told.update(zip(looks, found, strict=True))


def _first(look: Look, splats: Splats) -> Camera:
    picture, view = look
    return scenes.VIEWS[view](splats, *picture, STEPS)[0]


def _beside(
    plan: Plan, name: str, looks: Sequence[Look], told: Truths, chosen: Sequence[str]
) -> Iterator[Event]:
    """Frames of one scene by some of the RENDERERS."""
    yield Doing(f"{name}: loading", 0.0)
    splats = scenes.load(name)
    for number, which in enumerate(chosen):
        try:
            renderer = RENDERERS[which]()
            renderer.set_map(splats)
        except (ImportError, RuntimeError, ValueError) as error:
            yield Skipped(f"{name}, {which}: {error}")
            continue
        common: dict[str, Any] = {
            "scene": name, "splats": len(splats), "gpu": renderer.device, "variant": which,
        }  # fmt: skip
        for index, look in enumerate(looks):
            picture, view = look
            cameras = scenes.VIEWS[view](splats, *picture, STEPS)
            size = f"{picture[0]}x{picture[1]}"
            done = (number + index / len(looks)) / len(chosen)
            yield Doing(f"{name}, {size}, {view}, {which}", done)
            labels = common | {"picture": size, "view": view, "order": "its own"}
            yield Measurement("frame", "ms", in_turn(renderer, cameras, plan.budget), **labels)
            renderer.set_camera(cameras[0])
            renderer.draw()
            found = truths.psnr(renderer.picture(), told[look])
            yield Measurement("PSNR", "dB", found, **labels)
        if memory := renderer.graphics_memory():
            used = {"GPU memory of the map": memory[0], "GPU memory": memory[1]}
            yield from _memory(used, common)
        del renderer  # the next renderer's memory is measured alone


def _memory(used: dict[str, int], labels: dict[str, Any]) -> Iterator[Measurement]:
    """The bytes of each kind of memory that a map takes: in all, and for each splat."""
    for what, count in used.items():
        yield Measurement(what, "MB", count / 1e6, **labels)
        yield Measurement(f"{what} a splat", "bytes", count / labels["splats"], **labels)


def _scene(
    plan: Plan, name: str, looks: Sequence[Look], told: Truths, chosen: Sequence[str], maps: int
) -> Iterator[Event]:
    """All measurements of one scene, as so many maps, by the display's renderer."""
    yield Doing(f"{name}: loading", 0.0)
    display = DisplayRenderer()
    renderer = display.renderer
    before = _trimmed_memory()
    splats = scenes.load(name)
    for number in range(maps):
        target = renderer.add_map() if number else renderer
        rendering.insert_all(target, splats[number::maps])
    common: dict[str, Any] = {"scene": name, "splats": len(splats), "gpu": display.device}
    kinds = [
        kind
        for kind, backend in ORDERS.items()
        # Sorters other than a graphics card sort one map alone.
        if (maps == 1 or kind == ON_CARD) and backend in (plan.backends or [backend])
    ]
    orders: list[NDArray[np.uint32]] = []
    for index, look in enumerate(looks):
        picture, view = look
        cameras = scenes.VIEWS[view](splats, *picture, STEPS)
        if GIVEN in kinds:
            orders = [depth_order(splats, camera) for camera in cameras]
        display.set_camera(cameras[0])
        display.draw()  # uploads all that waits
        for variant in chosen:
            settings = VARIANTS[variant]
            size = f"{picture[0]}x{picture[1]}"
            yield Doing(f"{name}, {size}, {view}, {variant}", index / len(looks))
            labels = common | {"picture": size, "view": view, "variant": variant}
            for kind in kinds:
                given = orders if kind == GIVEN else None
                display.use(settings | ({"order": "SIDECAR"} if given else {}))
                yield from _frames(display, plan.budget, cameras, given, labels | {"order": kind})
            if "model" not in settings:  # the reference draws maps in their own
                display.use(settings)
                display.set_camera(cameras[0])
                display.draw()
                yield Measurement(
                    "PSNR", "dB", truths.psnr(display.picture(), told[look]), **labels
                )
    if maps > 1:
        return  # only the memory of one map is compared
    report = display.view.draw()
    del splats, orders
    memory = {
        "GPU memory": report["gpu_bytes"],
        "host memory": _trimmed_memory() - before,
        "GPU memory of the map": report["map_bytes"],
    }
    yield from _memory(memory, common)


def _frames(
    display: DisplayRenderer, budget: Budget, cameras: list[Camera],
    orders: list[NDArray[np.uint32]] | None, labels: dict[str, Any],
) -> Iterator[Measurement]:  # fmt: skip
    """Times of frames with cameras in turn, and of their stages. orders: given with the cameras."""
    reports: list[dict[str, Any]] = []

    def frame(index: int) -> float:
        which = index % len(cameras)
        display.set_camera(cameras[which])
        if orders:
            display.set_order(orders[which])

        def draw() -> None:
            reports.append(display.view.draw())
            display.finish()

        return milliseconds(draw)

    times = budget.spend(frame, WARM_UP)
    if orders and not all(report["order_fresh"] for report in reports):
        raise RuntimeError("the renderer did not take the orders that it was given")
    if display.renderer.failed():
        raise RuntimeError("OpenGL reports an error")
    details = labels | {"drawn": int(reports[-1]["splats"])}
    yield Measurement("frame", "ms", times, **details)
    submitting = [1e3 * report["draw_time"] for report in reports[-len(times) :]]
    yield Measurement("render thread", "ms", submitting, **details)
    display.renderer.settings.profile = True
    reports.clear()
    PROFILED.spend(frame)
    display.renderer.settings.profile = False
    for stage in reports[-1]["profile"]:
        spent = [1e3 * r["profile"][stage] for r in reports[1:] if stage in r["profile"]]
        yield Measurement("stage", "ms", spent, **details, stage=stage)


def _trimmed_memory() -> int:
    """Memory of this process after what isn't needed has been given back. [bytes]"""
    gc.collect()
    ctypes.CDLL(None).malloc_trim(0)
    return machine.resident_bytes()
