"""How long a picture takes, and what memory a map takes to be drawn."""

from __future__ import annotations

import ctypes
import gc
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rosplat_core import rendering
from rosplat_core.cameras import Camera, Place, place
from rosplat_core.scenes import ROOMS
from rosplat_core.splats import SceneError, Splats
from rosplat_lab import machine
from rosplat_lab.bench import embedded, scenes, streaming
from rosplat_lab.bench.isolation import isolated
from rosplat_lab.bench.plan import Plan
from rosplat_lab.bench.records import Budget, Doing, Event, Measurement, Skipped, milliseconds
from rosplat_lab.bench.renderers import RENDERERS
from rosplat_lab.bench.sort import map_of, view_of

if TYPE_CHECKING:
    from rviz_gaussian_plugin.offscreen import Renderer

SIZES = (100_000, 500_000, 1_000_000, 2_000_000, 5_000_000)
SOFTWARE_SIZES = (100_000, 500_000)  # where no GPU draws
QUICK_SIZES = (50_000,)
STREAMED, QUICK_STREAMED = 5_000_000, 100_000
STEPS = 8  # cameras that take turns
PROFILED = Budget(least=3, most=30, seconds=0.5)  # frames whose stages are measured

QUICK_VARIANTS = ("default",)
SOFTWARE_VARIANTS = ("default", "translucent")  # where no GPU draws


@dataclass(frozen=True)
class Variant:
    """What is drawn otherwise: settings, fields of RenderSettings; a translucent box; the scene as
    several maps through each other."""

    settings: dict[str, Any] = field(default_factory=dict)
    translucent: bool = False
    maps: int = 1


def variants() -> dict[str, Variant]:
    """Of the display's renderer, by name: each of its rasterisers is one."""
    from rosplat_core.rendering import Rasterizer

    rasterizers = [name for name in Rasterizer.__members__ if name != "AUTO"]
    return {
        "default": Variant(),
        **{name.lower(): Variant({"rasterizer": name}) for name in rasterizers},
        "float blending": Variant({"float_blending": True}),
        # A box amid the splats, before some, behind others.
        "translucent": Variant(translucent=True),
        "four maps": Variant(maps=4),
    }


@dataclass(frozen=True)
class Order:
    """Whose order frames have. given: a sorter's, for each camera; waits: sorted in the frame."""

    settings: dict[str, Any] = field(default_factory=dict)
    given: bool = False
    waits: bool = False


ON_CARD = "sorted in the frame, GPU"
ORDERS = {
    "given": Order({"order": "SIDECAR"}, given=True),  # what a frame costs beside sorting
    "sorted in the frame, CPU": Order({"order": "BUILT_IN"}, waits=True),
    "sorted beside it, CPU": Order({"order": "BUILT_IN"}),  # for a camera of some frames ago
    ON_CARD: Order({"order": "GPU"}),
}


def measure(plan: Plan) -> Iterator[Event]:
    """Frame times by scene, picture, view, settings and order; memory; frames of a growing map."""
    try:
        from rviz_gaussian_plugin.offscreen import ensure_display
    except ImportError as error:
        yield Skipped(f"the renderer is not built here: {error}")
        return
    known = variants().keys() | RENDERERS.keys()
    if unknown := set(plan.variants) - known:
        names = ", ".join(sorted(known))
        raise SceneError(f"unknown variant '{unknown.pop()}', known are {names}")
    try:
        with ensure_display():
            (drawing,) = isolated(embedded.hardware)
            software = isinstance(drawing, Measurement) and "llvmpipe" in drawing.gpu
            sizes: tuple[int, ...] = SIZES
            usual: tuple[str, ...] = tuple(variants())
            if software:
                sizes, usual = SOFTWARE_SIZES, SOFTWARE_VARIANTS
            if plan.quick:
                sizes, usual = QUICK_SIZES, QUICK_VARIANTS
            chosen = plan.variants or (*usual, *RENDERERS)
            ours = [variant for variant in chosen if variant in variants()]
            jobs = []
            # Where walls hide much, beside the garden, where little does.
            rooms = () if plan.quick or plan.sizes else (f"{ROOMS}{max(sizes)}",)
            for name in scenes.names(plan.sizes or sizes, plan.scenes or rooms):
                for maps in sorted({variants()[variant].maps for variant in ours}):
                    alike = [variant for variant in ours if variants()[variant].maps == maps]
                    jobs.append(partial(isolated, _scene, plan, name, alike, maps))
                beside = [renderer for renderer in chosen if renderer in RENDERERS]
                jobs += [partial(isolated, _beside, plan, name, renderer) for renderer in beside]
            if ours:
                streamed = max(plan.sizes, default=QUICK_STREAMED if plan.quick else STREAMED)
                jobs.append(partial(isolated, streaming.measure, streamed))
            for number, job in enumerate(jobs):
                yield from _part_of(job(), number, len(jobs))
    except RuntimeError as error:
        yield Skipped(f"pictures: {error}")


def _part_of(events: Iterator[Event], number: int, jobs: int) -> Iterator[Event]:
    """Events of one of several jobs, of which each says how much of its own is done."""
    for event in events:
        if isinstance(event, Doing):
            event = replace(event, part=(number + event.part) / jobs)
        yield event


def _looks(plan: Plan, name: str) -> list[tuple[tuple[int, int], str]]:
    """Sizes of pictures and views to measure a scene with."""
    views = scenes.views(name)
    if plan.quick:
        return [(scenes.PICTURES[0], views[0])]
    return [(picture, view) for picture in scenes.PICTURES for view in views]


def _beside(plan: Plan, name: str, which: str) -> Iterator[Event]:
    """Frames of one scene by one of the RENDERERS."""
    yield Doing(f"{name}: loading", 0.0)
    try:
        renderer = RENDERERS[which]()
    except (ImportError, RuntimeError) as error:
        yield Skipped(f"{which}: {error}")
        return
    splats = scenes.load(name)
    renderer.show(splats)
    looks = _looks(plan, name)
    for index, (picture, view) in enumerate(looks):
        cameras = scenes.VIEWS[view](splats, *picture, STEPS)
        size = f"{picture[0]}x{picture[1]}"
        yield Doing(f"{name}, {size}, {view}, {which}", index / len(looks))

        def frame(number: int, cameras: list[Camera] = cameras) -> float:
            return milliseconds(partial(renderer.draw, cameras[number % STEPS]))

        times = plan.budget.spend(frame, embedded.WARM_UP)
        yield Measurement.of(
            "frame", "ms", times, name, len(splats), renderer.device,
            picture=size, view=view, variant=which, order="its own",
        )  # fmt: skip


def _scene(plan: Plan, name: str, chosen: Sequence[str], maps: int) -> Iterator[Event]:
    """All measurements of one scene, as so many maps, by the display's renderer."""
    yield Doing(f"{name}: loading", 0.0)
    renderer = embedded.open_renderer()
    bench = Bench(renderer)
    before = _trimmed_memory()
    splats = scenes.load(name)
    count = len(splats)
    for number in range(maps):
        target = renderer.add_map() if number else renderer
        rendering.insert_all(target, splats[number::maps])
    # Sorters other than a graphics card sort one map alone.
    kinds = {kind: order for kind, order in ORDERS.items() if maps == 1 or kind == ON_CARD}
    looks = _looks(plan, name)
    for index, (picture, view) in enumerate(looks):
        cameras = scenes.VIEWS[view](splats, *picture, STEPS)
        orders = _sorted(splats, cameras)
        bench.view.look(cameras[0])
        bench.view.draw(sort_now=True)  # which uploads all that waits
        for variant in chosen:
            drawn = variants()[variant]
            bench.put_box(place(splats) if drawn.translucent else None)
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
    if maps > 1:
        return  # the memory of one map is what is compared
    bench.put_box(None)
    report = bench.view.draw()
    del splats, orders
    memory = {
        "GPU memory": report["gpu_bytes"],
        "host memory": _trimmed_memory() - before,
        "GPU memory of the map": report["map_bytes"],
    }
    for what, used in memory.items():
        labels = {"scene": name, "splats": count, "gpu": renderer.renderer_info}
        yield Measurement.of(what, "MB", used / 1e6, **labels)
        yield Measurement.of(f"{what} a splat", "bytes", used / count, **labels)


class Bench:
    """A renderer with a map, and one view of it, to time frames of."""

    def __init__(self, renderer: Renderer) -> None:
        self.view = embedded.View(renderer)
        self._renderer = renderer
        self._finish = embedded.gl_finish()
        self._untouched = type(renderer.settings)()

    def use(self, values: dict[str, Any]) -> None:
        """These settings, and all others as they are by default."""
        changed = type(self._untouched)()
        embedded.put(changed, values)
        self._renderer.settings = changed

    def put_box(self, place: Place | None) -> None:
        """A translucent box in the middle of a place, as wide as its radius, or none any more."""
        if place:
            self._renderer.set_box(tuple(place.centre.tolist()), (place.radius,) * 3, 0.5)
        else:
            self._renderer.set_box((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))

    def frames(
        self, budget: Budget, cameras: list[Camera], orders: list[NDArray[np.uint32]],
        order: Order, labels: dict[str, Any],
    ) -> Iterator[Measurement]:  # fmt: skip
        """Times of frames with cameras in turn, and of their stages."""
        reports: list[dict[str, Any]] = []

        def frame(index: int) -> float:
            which = index % len(cameras)
            number = self.view.look(cameras[which])
            if order.given:
                self.view.give(number, self._renderer.revision, orders[which])

            def draw() -> None:
                reports.append(self.view.draw(sort_now=order.waits))
                self._finish()

            return milliseconds(draw)

        times = budget.spend(frame, embedded.WARM_UP)
        if order.given and not all(report["order_fresh"] for report in reports):
            raise RuntimeError("the renderer did not take the orders that it was given")
        if self._renderer.failed():
            raise RuntimeError("OpenGL reports an error")
        details = labels | {"drawn": int(reports[-1]["splats"])}
        yield Measurement.of("frame", "ms", times, **details)
        submitting = [1e3 * report["draw_time"] for report in reports[-len(times) :]]
        yield Measurement.of("render thread", "ms", submitting, **details)
        self._renderer.settings.profile = True
        reports.clear()
        PROFILED.spend(frame)
        self._renderer.settings.profile = False
        for stage in reports[-1]["profile"]:
            spent = [1e3 * r["profile"][stage] for r in reports[1:] if stage in r["profile"]]
            yield Measurement.of("stage", "ms", spent, **details, stage=stage)


def _sorted(splats: Splats, cameras: list[Camera]) -> list[NDArray[np.uint32]]:
    from rosplat_sorter.backends import open_backend

    sorter, sorted_map = open_backend("native"), map_of(splats)
    sorter.update(sorted_map, slice(0, sorted_map.rows))
    return [np.array(sorter.order(view_of(camera, splats))) for camera in cameras]


def _trimmed_memory() -> int:
    """Memory of this process after what isn't needed has been given back. [bytes]"""
    gc.collect()
    ctypes.CDLL(None).malloc_trim(0)
    return machine.resident_bytes()
