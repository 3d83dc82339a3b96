"""How long a picture takes, and what memory a map takes to be drawn."""

from __future__ import annotations

import ctypes
import gc
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import takewhile
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rosplat_lab import machine
from rosplat_lab.bench import embedded, scenes
from rosplat_lab.bench.isolation import isolated
from rosplat_lab.bench.plan import VARIANTS, Plan
from rosplat_lab.bench.records import Budget, Doing, Event, Measurement, Skipped, milliseconds
from rosplat_lab.bench.sort import map_of, view_of
from rosplat_tools.cameras import Camera
from rosplat_tools.splats import SceneError, Splats

if TYPE_CHECKING:
    from rviz_gaussian_plugin.offscreen import Renderer

SIZES = (100_000, 500_000, 1_000_000, 2_000_000, 5_000_000)
SOFTWARE_SIZES = (100_000, 500_000)  # where no GPU draws
QUICK_SIZES = (50_000,)
STREAMED, QUICK_STREAMED = 5_000_000, 100_000
VIEWS = ("overview", "inside")
STEPS = 8  # cameras that take turns
STREAM_TIMEOUT = 120.0  # [s]
SETTLED = 0.5  # a picture that hasn't changed for so long is whole [s]
PROFILED = Budget(least=3, most=30, seconds=0.5)  # frames whose stages are measured

QUICK_VARIANTS = ("default",)
SOFTWARE_VARIANTS = ("default", "translucent")  # where no GPU draws


@dataclass(frozen=True)
class Order:
    """Whose order frames have. given: a sorter's, for each camera; waits: sorted in the frame."""

    settings: dict[str, Any] = field(default_factory=dict)
    given: bool = False
    waits: bool = False


ORDERS = {
    "given": Order({"order": "SIDECAR"}, given=True),  # what a frame costs beside sorting
    "sorted in the frame, CPU": Order({"order": "BUILT_IN"}, waits=True),
    "sorted beside it, CPU": Order({"order": "BUILT_IN"}),  # for a camera of some frames ago
    "sorted in the frame, GPU": Order({"order": "GPU"}),
}


def measure(plan: Plan) -> Iterator[Event]:
    """Frame times by scene, picture, view, settings and order; memory; frames of a growing map."""
    unknown = set(plan.variants) - VARIANTS.keys()
    if unknown:
        known = ", ".join(VARIANTS)
        raise SceneError(f"unknown variant '{unknown.pop()}', known are {known}")
    try:
        from rviz_gaussian_plugin.offscreen import ensure_display
    except ImportError as error:
        yield Skipped(f"the renderer is not built here: {error}")
        return
    try:
        with ensure_display():
            (drawing,) = isolated(_hardware)
            software = isinstance(drawing, Measurement) and "llvmpipe" in drawing.gpu
            sizes = plan.sizes or (
                QUICK_SIZES if plan.quick else SOFTWARE_SIZES if software else SIZES
            )
            variants = plan.variants or (
                QUICK_VARIANTS if plan.quick else SOFTWARE_VARIANTS if software else tuple(VARIANTS)
            )
            plan = replace(plan, variants=variants)
            names = scenes.names(sizes, plan.scenes)
            for number, name in enumerate(names):
                yield from isolated(_scene, plan, name, number, len(names) + 1)
            streamed = max(plan.sizes, default=QUICK_STREAMED if plan.quick else STREAMED)
            yield Doing(f"{streamed:,} splats stream in", len(names) / (len(names) + 1))
            yield from isolated(_stream, streamed)
    except RuntimeError as error:
        yield Skipped(f"pictures: {error}")


def _hardware() -> Iterator[Event]:
    """One measurement that says what draws."""
    yield Measurement.of("", "", 0, gpu=embedded.open_renderer().renderer_info)


def _scene(plan: Plan, name: str, number: int, total: int) -> Iterator[Event]:
    """All measurements of one scene."""
    yield Doing(f"{name}: loading", number / total)
    renderer = embedded.open_renderer()
    bench = Bench(renderer)
    before = _trimmed_memory()
    splats = scenes.load(name)
    count = len(splats)
    for revision, part in enumerate(embedded.batches(splats), 1):
        embedded.insert(renderer, splats, part, revision)
    pictures = scenes.PICTURES[:1] if plan.quick else scenes.PICTURES
    views = VIEWS[:1] if plan.quick else VIEWS
    jobs = [(picture, view) for picture in pictures for view in views]
    for index, (picture, view) in enumerate(jobs):
        cameras = scenes.VIEWS[view](splats, *picture, STEPS)
        orders = _sorted(splats, cameras)
        bench.view.look(cameras[0])
        bench.view.draw(sort_now=True)  # which uploads all that waits
        for variant in plan.variants:
            bench.put_box(scenes.place(splats) if VARIANTS[variant].translucent else None)
            size = f"{picture[0]}x{picture[1]}"
            yield Doing(f"{name}, {size}, {view}, {variant}", (number + index / len(jobs)) / total)
            labels = {
                "scene": name, "splats": count, "gpu": renderer.renderer_info,
                "picture": size, "view": view, "variant": variant,
            }  # fmt: skip
            for kind, order in ORDERS.items():
                try:
                    bench.use(VARIANTS[variant].settings | order.settings)
                except AttributeError as error:
                    if number == index == 0:
                        yield Skipped(f"{variant}, {kind}: this renderer has it not: {error}")
                    continue
                yield from bench.frames(
                    plan.budget, cameras, orders, order, labels | {"order": kind}
                )
    bench.put_box(None)
    report = bench.view.draw()
    del splats, orders
    memory = {"GPU memory": report["gpu_bytes"], "host memory": _trimmed_memory() - before}
    if "map_bytes" in report:
        memory["GPU memory of the map"] = report["map_bytes"]
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
        """These settings, and all others as they are by default. Raises AttributeError."""
        changed = type(self._untouched)()
        embedded.put(changed, values)
        self._renderer.settings = changed

    def put_box(self, place: scenes.Place | None) -> None:
        """A translucent box in the middle of a place, as wide as its radius, or none any more."""
        if place:
            self._renderer.set_box(tuple(place.centre.tolist()), (place.radius,) * 3, 0.5)
        else:
            self._renderer.set_box((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 1.0)  # opaque, but nothing

    def frames(
        self, budget: Budget, cameras: list[Camera], orders: list[NDArray[np.uint32]],
        order: Order, labels: dict[str, Any],
    ) -> Iterator[Measurement]:  # fmt: skip
        """Times of frames with cameras in turn; of their stages where the renderer tells them."""
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

        times = budget.spend(frame)
        if order.given and not all(report["order_fresh"] for report in reports):
            raise RuntimeError("the renderer did not take the orders that it was given")
        if self._renderer.failed():
            raise RuntimeError("OpenGL reports an error")
        details = labels | {"drawn": int(reports[-1]["splats"])}
        yield Measurement.of("frame", "ms", times, **details)
        submitting = [1e3 * report["draw_time"] for report in reports[1:]]
        yield Measurement.of("render thread", "ms", submitting, **details)
        if hasattr(self._renderer.settings, "profile"):
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
    sorter.update(sorted_map, slice(0, len(sorted_map)))
    return [np.array(sorter.order(view_of(camera, splats))) for camera in cameras]


@dataclass(frozen=True)
class Frame:
    """A frame of a map that streams in. [s]"""

    ended: float
    took: float
    drawn: int
    fresh: bool
    """Whether it was sorted for its very camera, and for all that it draws."""


def whole_since(frames: list[Frame]) -> float:
    """The end of the first frame from which on all draw what the last one does. [s]"""
    last = frames[-1]
    alike = takewhile(
        lambda frame: (frame.drawn, frame.fresh) == (last.drawn, last.fresh), reversed(frames)
    )
    return min(frame.ended for frame in alike)


def _stream(count: int) -> Iterator[Event]:
    """Frames while a map arrives as fast as it can be taken, the camera moving until it is sent."""
    (name,) = scenes.names((count,), ())
    renderer = embedded.open_renderer()
    finish = embedded.gl_finish()
    splats = scenes.load(name)
    view = embedded.View(renderer)
    cameras = scenes.overview(splats, *scenes.PICTURES[0], 360)
    view.look(cameras[0])
    view.draw()
    finish()

    def publish() -> None:
        for revision, part in enumerate(embedded.batches(splats), 1):
            embedded.insert(renderer, splats, part, revision)

    publisher = threading.Thread(target=publish)
    frames: list[Frame] = []
    start = perf_counter()
    publisher.start()
    sent = whole = False
    while not whole and perf_counter() - start < STREAM_TIMEOUT:
        if not sent:
            sent = not publisher.is_alive()
            view.look(cameras[len(frames) % len(cameras)])
        began = perf_counter()
        report = view.draw()
        finish()
        ended = perf_counter()
        frames.append(Frame(ended, ended - began, report["splats"], report["order_fresh"]))
        whole = sent and frames[-1].fresh and ended - whole_since(frames) > SETTLED
    publisher.join()
    end = whole_since(frames)
    labels = {"scene": name, "splats": count, "gpu": renderer.renderer_info}
    times = [1e3 * frame.took for frame in frames if frame.ended <= end]
    yield Measurement.of("frame while a map streams in", "ms", times, **labels)
    if whole and renderer.splats == count:
        yield Measurement.of("from the first batch to the picture", "s", end - start, **labels)
    else:
        yield Skipped(f"{name} was not seen whole within {STREAM_TIMEOUT:.0f} s")


def _trimmed_memory() -> int:
    """Memory of this process after what isn't needed has been given back. [bytes]"""
    gc.collect()
    ctypes.CDLL(None).malloc_trim(0)
    return machine.resident_bytes()
