"""A map that grows by 1,000 splats a message: frame rate and memory by the number of splats.

The protocol of ROSplat's paper (figures 3 to 6): every sorting backend on the same growing map. All
happens in one process, without messages: the sorter is a thread, the publisher a part of each
frame.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from rosplat_core import rendering
from rosplat_core.cameras import Camera
from rosplat_core.ordering import view_of
from rosplat_core.scenes import PROCEDURAL
from rosplat_core.splats import Splats
from rosplat_lab.bench import embedded, live, scenes
from rosplat_lab.bench.isolation import isolated
from rosplat_lab.bench.plan import Plan
from rosplat_lab.bench.records import Doing, Event, Measurement, Skipped
from rosplat_sorter.backends import BACKENDS, open_backend
from rosplat_sorter.map import SplatMap
from rosplat_tools.emulation.mapping import around

if TYPE_CHECKING:
    from rviz_gaussian_plugin.offscreen import Renderer

SIZE, QUICK_SIZE = 2_000_000, 100_000
BATCH = 1000  # splats a message
RATE = 200.0  # messages a second
POINTS = 25  # numbers of splats at which it is reported
LINGER = 1.0  # watched after the map is whole [s]
PICTURE, QUICK_PICTURE = (1280, 720), (320, 180)


@dataclass(frozen=True)
class Frame:
    """A frame of the map as far as it had grown."""

    ended: float
    """[s]"""
    took: float
    """[s]"""
    splats: int
    by_sorter: bool
    """Whether its order was the backend's, not the renderer's own."""
    gpu_bytes: int


def measure(plan: Plan) -> Iterator[Event]:
    """Frame rate and the renderer's memory on the GPU, by number of splats and backend."""
    size = max(plan.sizes, default=QUICK_SIZE if plan.quick else SIZE)
    backends, missing = live.backends(plan.backends, live.BUILT_IN, live.GPU)
    yield from missing
    if plan.quick and not plan.backends:
        backends = backends[:2]
    picture = QUICK_PICTURE if plan.quick else PICTURE
    for number, backend in enumerate(backends):
        yield Doing(f"to {size:,} splats, {backend}", number / len(backends))
        try:
            yield from isolated(_grow, size, backend, picture)
        except RuntimeError as error:
            yield Skipped(f"{backend}: {error}")


def _grow(size: int, backend: str, picture: tuple[int, int]) -> Iterator[Event]:
    from rviz_gaussian_plugin.offscreen import ensure_display

    with ensure_display():
        renderer = embedded.open_renderer()
        frames = _drawn(renderer, size, backend, picture)
        yield from _report(size, backend, renderer.renderer_info, frames)
        del renderer  # while its display is there


def _drawn(renderer: Renderer, size: int, backend: str, picture: tuple[int, int]) -> list[Frame]:
    splats = around(scenes.load(f"{PROCEDURAL}{size}"))
    cameras = scenes.overview(splats, *picture, 360)
    view = embedded.NumberedView(renderer)
    finish = embedded.gl_finish()
    renderer.settings = embedded.changed({"order": live.order_source(backend)})
    sorter = SortingThread(backend, splats, view) if backend in BACKENDS else None
    frames: list[Frame] = []
    began = grown = time.time()
    sent = 0
    while time.time() < grown + LINGER:
        due = min(size, BATCH * (1 + int((time.time() - began) * RATE)))
        while sent < due:
            part = slice(sent, min(sent + BATCH, size))
            rendering.insert(renderer, splats, part, sent // BATCH + 1)
            sent = part.stop
        camera = cameras[len(frames) % len(cameras)]
        number = view.look(camera)
        if sorter:
            sorter.ask(sent, number, camera)
        started = time.time()
        report = view.draw()
        finish()
        ended = time.time()
        shown, by_sorter = renderer.splats, report["order_source"] == "bench"
        frames.append(Frame(ended, ended - started, shown, by_sorter, report["gpu_bytes"]))
        if shown < size:
            grown = ended
    if sorter:
        sorter.close()
    return frames


class SortingThread:
    """A backend of the sorter that answers a view's newest camera, as the sorter's node does."""

    def __init__(self, backend: str, splats: Splats, view: embedded.NumberedView) -> None:
        self._backend = open_backend(backend)
        self._splats = splats
        self._view = view
        self._map = SplatMap()
        self._wake = threading.Condition()
        self._question: tuple[int, int, Camera] | None = None
        self._closing = False
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def ask(self, count: int, number: int, camera: Camera) -> None:
        """Asks for an order of the first `count` splats. A question that still waits is dropped."""
        with self._wake:
            self._question = (count, number, camera)
            self._wake.notify()

    def close(self) -> None:
        """Ends the thread after its current sort."""
        with self._wake:
            self._closing = True
            self._wake.notify()
        self._thread.join()

    def _run(self) -> None:
        while True:
            with self._wake:
                self._wake.wait_for(lambda: self._closing or self._question)
                if self._closing or self._question is None:
                    return
                (count, number, camera), self._question = self._question, None
            self._grow(count)
            order = self._backend.order(view_of(camera, self._splats))
            self._view.give(number, self._map.revision, order)

    def _grow(self, count: int) -> None:
        new = slice(self._map.capacity, count)
        if new.start < new.stop:
            rendering.insert(self._map, self._splats, new, -(-count // BATCH))
            self._backend.update(self._map, self._map.changed_rows)


def _report(size: int, backend: str, drawing: str, frames: list[Frame]) -> Iterator[Measurement]:
    """Figures of frames, in POINTS steps of the number of splats."""
    step = max(1, size // POINTS)
    for low in range(0, size, step):
        seen = [frame for frame in frames if low < frame.splats <= low + step]
        if not seen:
            continue
        common: dict[str, Any] = {
            "scene": f"{PROCEDURAL}{size}", "gpu": drawing, "backend": backend,
            "splats": round(sum(frame.splats for frame in seen) / len(seen)),
        }  # fmt: skip
        span = seen[-1].ended - (seen[0].ended - seen[0].took)
        yield Measurement.of("frame rate", "1/s", len(seen) / span, **common)
        by_sorter = sum(frame.by_sorter for frame in seen) / len(seen)
        yield Measurement.of("frames by the sorter's order", "%", 100 * by_sorter, **common)
        yield Measurement.of("frame", "ms", [1e3 * frame.took for frame in seen], **common)
        held = [frame.gpu_bytes / 1e6 for frame in seen]
        yield Measurement.of("the renderer's buffers", "MB", held, **common)
