"""How long a picture takes, and what memory a map takes to be drawn."""

from __future__ import annotations

import ctypes
import gc
import threading
from collections.abc import Callable, Iterator
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rosplat_tools.bench import machine, scenes
from rosplat_tools.bench.isolation import isolated
from rosplat_tools.bench.plan import Plan
from rosplat_tools.bench.records import Doing, Event, Measurement, Skipped, milliseconds
from rosplat_tools.bench.sort import map_of, view_of
from rosplat_tools.cameras import Camera
from rosplat_tools.splats import Splats

if TYPE_CHECKING:
    from rviz_gaussian_plugin.offscreen import Renderer

SIZES = (100_000, 500_000, 1_000_000, 2_000_000, 5_000_000)
SOFTWARE_SIZES = (100_000, 500_000, 1_000_000)  # where no GPU draws
QUICK_SIZES = (100_000,)
STREAMED, QUICK_STREAMED = 5_000_000, 200_000
VIEWS = ("overview", "inside")
STEPS = 8  # cameras that take turns

# Settings of the renderer to measure with, by name; each field of RenderSettings that differs.
VARIANTS: dict[str, dict[str, Any]] = {
    "default": {},
    "float blending": {"float_blending": True},
}
QUICK_VARIANTS = ("default",)

# Whose order a frame has.
FRESH = "given"  # a sorter's, for this very camera: what a frame costs beside sorting
WAITING = "sorted in the frame"  # by the renderer itself, which waits
LATE = "sorted beside it"  # by the renderer's own thread, for a camera of some frames ago

# What a frame reports, by name of the measurement. [s]
REPORTED = {"render thread": "draw_time"}

CHUNK = 8_000_000  # as the publisher sends [bytes]
STREAM_TIMEOUT = 120.0  # [s]


def measure(plan: Plan) -> Iterator[Event]:
    """Frame times by scene, picture, view, settings and order; memory; frames of a growing map."""
    try:
        from rviz_gaussian_plugin.offscreen import ensure_display
    except ImportError as error:
        yield Skipped(f"the renderer is not built here: {error}")
        return
    try:
        with ensure_display():
            software: list[bool] = []
            for event in isolated(_hardware):
                if isinstance(event, Measurement):
                    software.append("llvmpipe" in event.gpu or "softpipe" in event.gpu)
            sizes = plan.sizes or (
                QUICK_SIZES if plan.quick else SOFTWARE_SIZES if software[0] else SIZES
            )
            names = scenes.names(sizes, plan.scenes)
            for number, name in enumerate(names):
                yield from isolated(_scene, plan, name, number, len(names) + 1)
            streamed = max(plan.sizes, default=QUICK_STREAMED if plan.quick else STREAMED)
            yield Doing(f"{streamed:,} splats stream in", len(names) / (len(names) + 1))
            yield from isolated(_stream, streamed)
    except RuntimeError as error:
        yield Skipped(f"no pictures: {error}")


def _hardware() -> Iterator[Event]:
    """One measurement that says what draws."""
    yield Measurement.of("", "", 0, gpu=_renderer().renderer_info)


def _renderer() -> Renderer:
    from rviz_gaussian_plugin.offscreen import Renderer

    return Renderer()


def _scene(plan: Plan, name: str, number: int, total: int) -> Iterator[Event]:
    """All measurements of one scene."""
    yield Doing(f"{name}: loading", number / total)
    renderer = _renderer()
    sequence = Sequence(renderer)
    finish = gl_finish()
    before = _trimmed_memory()
    splats = scenes.load(name)
    count = len(splats)
    for part in batches(splats):
        apply(renderer, splats, part, "bench")
    pictures = scenes.PICTURES[:1] if plan.quick else scenes.PICTURES
    views = VIEWS[:1] if plan.quick else VIEWS
    variants = plan.variants or (QUICK_VARIANTS if plan.quick else tuple(VARIANTS))
    jobs = [
        (picture, view, variant) for variant in variants for picture in pictures for view in views
    ]
    for index, (picture, view, variant) in enumerate(jobs):
        text = f"{name}, {picture[0]}x{picture[1]}, {view}, {variant}"
        yield Doing(text, (number + index / len(jobs)) / total)
        try:
            put(renderer.settings, VARIANTS[variant])
        except (AttributeError, KeyError) as error:
            yield Skipped(f"{name}: variant '{variant}': {error}")
            continue
        cameras = scenes.VIEWS[view](splats, *picture, STEPS)
        labels = {
            "scene": name, "splats": count, "gpu": renderer.renderer_info,
            "picture": f"{picture[0]}x{picture[1]}", "view": view, "variant": variant,
        }  # fmt: skip
        yield from _frames(plan, renderer, sequence, finish, splats, cameras, labels)
        put(renderer.settings, defaults(VARIANTS[variant]))
    used = renderer.draw(_VIEW)["gpu_bytes"]
    del splats
    resident = _trimmed_memory() - before
    for what, used_bytes in (("GPU memory", used), ("host memory", resident)):
        labels = {"scene": name, "splats": count, "gpu": renderer.renderer_info}
        yield Measurement.of(what, "MB", used_bytes / 1e6, **labels)
        yield Measurement.of(f"{what} a splat", "bytes", used_bytes / count, **labels)


_VIEW = "bench"


def _frames(
    plan: Plan, renderer: Renderer, sequence: Sequence, finish: Callable[[], None],
    splats: Splats, cameras: list[Camera], labels: dict[str, Any],
) -> Iterator[Event]:  # fmt: skip
    """Frames of a moving camera with each kind of order."""
    from rosplat_sorter.backends import open_backend

    sorter = open_backend("native")
    sorted_map = map_of(splats)
    sorter.update(sorted_map, slice(0, len(sorted_map)))
    orders = [np.array(sorter.order(view_of(camera, splats))) for camera in cameras]
    for kind in (FRESH, WAITING, LATE):
        reports: list[dict[str, Any]] = []

        def frame(index: int, kind: str = kind, reports: list[dict[str, Any]] = reports) -> float:
            which = index % len(cameras)
            number = sequence.look(cameras[which])
            if kind == FRESH:
                renderer.set_order(
                    _VIEW, number, renderer.map_id, renderer.revision, "bench", 0.0, orders[which]
                )

            def draw() -> None:
                reports.append(renderer.draw(_VIEW, built_in=kind == WAITING))
                finish()

            return milliseconds(draw)

        times = plan.budget.spend(frame)
        if kind == FRESH and not all(report["order_fresh"] for report in reports):
            raise RuntimeError("the renderer did not take the orders that it was given")
        if renderer.failed():
            raise RuntimeError("OpenGL reports an error")
        details = labels | {"order": kind, "drawn": int(reports[-1]["splats"])}
        yield Measurement.of("frame", "ms", times, **details)
        for what, key in REPORTED.items():
            seconds = [report[key] for report in reports[1:] if key in report]
            if seconds:
                yield Measurement.of(what, "ms", 1e3 * np.array(seconds), **details)


def _stream(count: int) -> Iterator[Event]:
    """Frames while a map arrives as fast as it can be taken, the camera moving."""
    name = scenes.names((count,), ())[0]
    renderer = _renderer()
    finish = gl_finish()
    splats = scenes.load(name)
    sequence = Sequence(renderer)
    cameras = scenes.overview(splats, *scenes.PICTURES[0], 360)
    sequence.look(cameras[0])
    renderer.draw(_VIEW)
    finish()

    def publish() -> None:
        for part in batches(splats):
            apply(renderer, splats, part, "bench")

    publisher = threading.Thread(target=publish)
    times: list[float] = []
    start = perf_counter()
    publisher.start()
    arrived = shown = 0.0
    while not shown and perf_counter() - start < STREAM_TIMEOUT:
        sequence.look(cameras[len(times) % len(cameras)])
        began = perf_counter()
        report = renderer.draw(_VIEW)
        finish()
        times.append(1e3 * (perf_counter() - began))
        if not publisher.is_alive():
            arrived = arrived or perf_counter()
            if report["splats"] > 0.5 * count:
                shown = perf_counter()
    publisher.join()
    labels = {"scene": name, "splats": count, "gpu": renderer.renderer_info}
    yield Measurement.of("frame while a map streams in", "ms", times, **labels)
    if shown:
        yield Measurement.of("from the first batch to the picture", "s", shown - start, **labels)


class Sequence:
    """Numbers the cameras of a view."""

    def __init__(self, renderer: Renderer) -> None:
        self._renderer = renderer
        self._number = 0

    def look(self, camera: Camera) -> int:
        """Poses the view's camera; returns its number."""
        self._number += 1
        self._renderer.set_camera(
            _VIEW, self._number, tuple(camera.position.tolist()),
            tuple(camera.orientation.tolist()), int(camera.orthographic), camera.fx, camera.fy,
            camera.cx, camera.cy, camera.width, camera.height, camera.near, camera.far,
        )  # fmt: skip
        return self._number


def batches(splats: Splats) -> Iterator[slice]:
    """The batches in which a publisher would send them."""
    step = max(1, CHUNK * len(splats) // max(1, splats.nbytes))
    for start in range(0, len(splats), step):
        yield slice(start, min(start + step, len(splats)))


def apply(renderer: Renderer, splats: Splats, part: slice, map_id: str) -> None:
    """Gives the renderer a batch; the first one begins the map."""
    step = max(1, CHUNK * len(splats) // max(1, splats.nbytes))
    renderer.apply(
        0 if part.start == 0 else 1, part.start, part.stop - part.start, _NO_SLOTS,
        splats.sh_degree, splats.antialiased, tuple(splats.origin.tolist()),
        splats.positions[part].ravel(), splats.orientations[part].ravel(),
        splats.scales[part].ravel(), splats.opacities[part], splats.sh[part].ravel(),
        map_id, part.start // step + 1, len(splats),
    )  # fmt: skip


_NO_SLOTS: NDArray[np.uint32] = np.zeros(0, np.uint32)


def put(settings: Any, values: dict[str, Any]) -> None:
    """Sets fields of RenderSettings, enumerations by name.

    Raises AttributeError for a field that this build doesn't have, KeyError for an unknown name.
    """
    for name, value in values.items():
        members = getattr(type(getattr(settings, name)), "__members__", None)
        setattr(settings, name, members[value] if members else value)


def defaults(values: dict[str, Any]) -> dict[str, Any]:
    """What a renderer begins with in these fields."""
    from rviz_gaussian_plugin.offscreen import RenderSettings

    fresh = RenderSettings()
    found = {name: getattr(fresh, name) for name in values}
    return {name: getattr(value, "name", value) for name, value in found.items()}


def gl_finish() -> Callable[[], None]:
    """OpenGL's glFinish, of the context that is current: waits until all is drawn."""
    finish = ctypes.CDLL("libGL.so.1").glFinish
    finish.restype = None
    return lambda: finish()


def _trimmed_memory() -> int:
    """Memory of this process after what isn't needed has been given back. [bytes]"""
    gc.collect()
    ctypes.CDLL(None).malloc_trim(0)
    return machine.resident_bytes()
