"""How long a picture takes, and what memory a map takes to be drawn."""

from __future__ import annotations

import ctypes
import gc
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rosplat_core import rendering
from rosplat_core.cameras import Camera
from rosplat_core.models import Model
from rosplat_core.program import machine
from rosplat_core.scenes import ROOMS
from rosplat_core.splats import InputError, Splats
from rosplat_lab.bench import embedded, live, renderers, scenes, truths
from rosplat_lab.bench.isolation import isolated
from rosplat_lab.bench.plan import Plan
from rosplat_lab.bench.records import Budget, Doing, Event, Measurement, Skipped, milliseconds
from rosplat_lab.bench.renderers import RENDERERS

SIZES = (100_000, 500_000, 1_000_000, 2_000_000, 5_000_000)
SOFTWARE_SIZES = (100_000, 500_000)  # where no GPU draws
QUICK_SIZES = (50_000,)
CARD_PICTURES = (*scenes.PICTURES, (3840, 2160))
STEPS = 8  # cameras that take turns
PROFILED = Budget(least=3, most=30, seconds=0.5)  # frames whose stages are measured

FEW_VARIANTS = ("default",)  # of a quick run, and where no GPU draws


@dataclass(frozen=True)
class Variant:
    """How drawing differs from the default: settings, fields of RenderSettings; the scene as
    several interleaved maps."""

    settings: dict[str, Any] = field(default_factory=dict)
    maps: int = 1

    @property
    def has_truth(self) -> bool:
        """Whether the reference draws it. That draws maps in their own model."""
        return "model" not in self.settings


def variants() -> dict[str, Variant]:
    """Variants of the display's renderer, by name. Each of its rasterisers is one."""
    from rosplat_core.rendering import Rasterizer

    rasterizers = [name for name in Rasterizer.__members__ if name != "AUTO"]
    return {
        "default": Variant(),
        **{name.lower(): Variant({"rasterizer": name}) for name in rasterizers},
        "four maps": Variant(maps=4),
        # The same map, as if it had been trained so.
        **{str(model): Variant({"model": model}) for model in (Model.EWA, Model.RAY, Model.DISC)},
    }


@dataclass(frozen=True)
class Order:
    """Whose order frames have. backend: what sorts, as `--backends` names it. given: each camera
    gets a sorter's order."""

    backend: str
    settings: dict[str, Any] = field(default_factory=dict)
    given: bool = False


ON_CARD = "sorted in the frame, GPU"
ORDERS = {
    # What a frame costs beside sorting.
    "given": Order("native", {"order": "SIDECAR"}, given=True),
    ON_CARD: Order(live.GPU),
}

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
    known = variants().keys() | RENDERERS.keys()
    if unknown := set(plan.variants) - known:
        names = ", ".join(sorted(known))
        raise InputError(f"unknown variant '{unknown.pop()}', known are {names}")
    try:
        with ensure_display():
            (drawing,) = isolated(embedded.hardware)
            software = isinstance(drawing, Measurement) and "llvmpipe" in drawing.gpu
            sizes: tuple[int, ...] = SIZES
            pictures: tuple[tuple[int, int], ...] = CARD_PICTURES
            usual: tuple[str, ...] = tuple(variants())
            if software:
                sizes, usual = SOFTWARE_SIZES, FEW_VARIANTS
                pictures = scenes.PICTURES
            if plan.quick:
                sizes, usual = QUICK_SIZES, FEW_VARIANTS
            chosen = plan.variants or (*usual, *RENDERERS)
            ours = [variant for variant in chosen if variant in variants()]
            jobs = []
            # In rooms walls hide much; in the garden little is hidden.
            rooms = () if plan.quick or plan.sizes else (f"{ROOMS}{max(sizes)}",)
            for name in scenes.names(plan.sizes or sizes, plan.scenes or rooms):
                looks = _looks(plan, name, pictures)
                told: Truths = {}
                jobs.append(partial(_draw_truths, name, looks, told))
                for maps in sorted({variants()[variant].maps for variant in ours}):
                    alike = [variant for variant in ours if variants()[variant].maps == maps]
                    jobs.append(partial(isolated, _scene, plan, name, looks, told, alike, maps))
                if beside := [renderer for renderer in chosen if renderer in RENDERERS]:
                    jobs.append(partial(isolated, _beside, plan, name, looks, told, beside))
            for number, job in enumerate(jobs):
                yield from _part_of(job(), number, len(jobs))
    except RuntimeError as error:
        yield Skipped(f"pictures: {error}")


def _part_of(events: Iterator[Event], number: int, jobs: int) -> Iterator[Event]:
    """Events of one of several jobs, their shares of the job turned into shares of all jobs."""
    for event in events:
        if isinstance(event, Doing):
            event = replace(event, part=(number + event.part) / jobs)
        yield event


def _looks(plan: Plan, name: str, pictures: Sequence[tuple[int, int]]) -> list[Look]:
    """The looks that a scene is measured with."""
    views = scenes.views(name)
    if plan.quick:
        return [(pictures[0], views[0])]
    return [(picture, view) for picture in pictures for view in views]


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
        for index, look in enumerate(looks):
            picture, view = look
            cameras = scenes.VIEWS[view](splats, *picture, STEPS)
            size = f"{picture[0]}x{picture[1]}"
            done = (number + index / len(looks)) / len(chosen)
            yield Doing(f"{name}, {size}, {view}, {which}", done)

            def frame(
                index: int, renderer: renderers.Renderer = renderer, cameras: list[Camera] = cameras
            ) -> float:
                renderer.set_camera(cameras[index % STEPS])
                return milliseconds(renderer.draw)

            times = plan.budget.spend(frame, embedded.WARM_UP)
            labels: dict[str, Any] = {
                "scene": name, "splats": len(splats), "gpu": renderer.device,
                "picture": size, "view": view, "variant": which, "order": "its own",
            }  # fmt: skip
            yield Measurement.of("frame", "ms", times, **labels)
            frame(0)
            yield Measurement.of(
                "PSNR", "dB", truths.psnr(renderer.picture(), told[look]), **labels
            )
        if memory := renderer.graphics_memory():
            labels = {
                "scene": name, "splats": len(splats), "gpu": renderer.device, "variant": which,
            }  # fmt: skip
            yield from _memory(
                {"GPU memory of the map": memory[0], "GPU memory": memory[1]}, labels
            )
        del renderer, frame  # the next renderer's memory is measured alone


def _memory(used: dict[str, int], labels: dict[str, Any]) -> Iterator[Measurement]:
    """The bytes of each kind of memory that a map takes: in all, and for each splat."""
    for what, count in used.items():
        yield Measurement.of(what, "MB", count / 1e6, **labels)
        yield Measurement.of(f"{what} a splat", "bytes", count / labels["splats"], **labels)


def _scene(
    plan: Plan, name: str, looks: Sequence[Look], told: Truths, chosen: Sequence[str], maps: int
) -> Iterator[Event]:
    """All measurements of one scene, as so many maps, by the display's renderer."""
    yield Doing(f"{name}: loading", 0.0)
    bench = Bench()
    renderer = bench.renderer
    before = _trimmed_memory()
    splats = scenes.load(name)
    count = len(splats)
    for number in range(maps):
        target = renderer.add_map() if number else renderer
        rendering.insert_all(target, splats[number::maps])
    kinds = {
        kind: order
        for kind, order in ORDERS.items()
        # Sorters other than a graphics card sort one map alone.
        if (maps == 1 or kind == ON_CARD) and order.backend in (plan.backends or [order.backend])
    }
    orders: list[NDArray[np.uint32]] = []
    for index, look in enumerate(looks):
        picture, view = look
        cameras = scenes.VIEWS[view](splats, *picture, STEPS)
        if any(order.given for order in kinds.values()):
            orders = truths.orders(splats, cameras)
        bench.view.set_camera(cameras[0])
        bench.view.draw(sort_now=True)  # uploads all that waits
        for variant in chosen:
            drawn = variants()[variant]
            size = f"{picture[0]}x{picture[1]}"
            yield Doing(f"{name}, {size}, {view}, {variant}", index / len(looks))
            labels = {
                "scene": name, "splats": count, "gpu": renderer.renderer_info,
                "picture": size, "view": view, "variant": variant,
            }  # fmt: skip
            for kind, order in kinds.items():
                bench.use(drawn.settings | order.settings)
                yield from bench.frames(
                    plan.budget, cameras, orders, order, labels | {"order": kind}
                )
            if drawn.has_truth:
                bench.use(drawn.settings)
                found = truths.psnr(bench.exact(cameras[0]), told[look])
                yield Measurement.of("PSNR", "dB", found, **labels)
    if maps > 1:
        return  # only the memory of one map is compared
    report = bench.view.draw()
    del splats, orders
    memory = {
        "GPU memory": report["gpu_bytes"],
        "host memory": _trimmed_memory() - before,
        "GPU memory of the map": report["map_bytes"],
    }
    yield from _memory(memory, {"scene": name, "splats": count, "gpu": renderer.renderer_info})


class Bench(renderers.DisplayRenderer):
    """A renderer with a map, and one view of it, to time frames of."""

    def exact(self, camera: Camera) -> NDArray[np.float32]:
        """Premultiplied RGB over black, (height, width, 3), exactly sorted."""
        self.set_camera(camera)
        self.draw()
        return self.picture()

    def frames(
        self, budget: Budget, cameras: list[Camera], orders: list[NDArray[np.uint32]],
        order: Order, labels: dict[str, Any],
    ) -> Iterator[Measurement]:  # fmt: skip
        """Times of frames with cameras in turn, and of their stages."""
        reports: list[dict[str, Any]] = []

        def frame(index: int) -> float:
            which = index % len(cameras)
            self.set_camera(cameras[which])
            if order.given:
                self.set_order(orders[which])

            def draw() -> None:
                reports.append(self.view.draw())
                self.finish()

            return milliseconds(draw)

        times = budget.spend(frame, embedded.WARM_UP)
        if order.given and not all(report["order_fresh"] for report in reports):
            raise RuntimeError("the renderer did not take the orders that it was given")
        if self.renderer.failed():
            raise RuntimeError("OpenGL reports an error")
        details = labels | {"drawn": int(reports[-1]["splats"])}
        yield Measurement.of("frame", "ms", times, **details)
        submitting = [1e3 * report["draw_time"] for report in reports[-len(times) :]]
        yield Measurement.of("render thread", "ms", submitting, **details)
        self.renderer.settings.profile = True
        reports.clear()
        PROFILED.spend(frame)
        self.renderer.settings.profile = False
        for stage in reports[-1]["profile"]:
            spent = [1e3 * r["profile"][stage] for r in reports[1:] if stage in r["profile"]]
            yield Measurement.of("stage", "ms", spent, **details, stage=stage)


def _trimmed_memory() -> int:
    """Memory of this process after what isn't needed has been given back. [bytes]"""
    gc.collect()
    ctypes.CDLL(None).malloc_trim(0)
    return machine.resident_bytes()
