"""A map that grows by 1,000 splats a message: frame rate and memory by the number of splats.

The protocol of ROSplat's paper (figures 3 to 6): every sorting backend on the same growing map.
With ROS 2, publisher, sorter and viewer are three processes; without it, all happens in one.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator

from rosplat_core import rendering
from rosplat_core.cameras import Camera
from rosplat_core.ordering import view_of
from rosplat_core.scenes import PROCEDURAL
from rosplat_core.splats import Splats
from rosplat_lab import machine
from rosplat_lab.bench import embedded, live, scenes
from rosplat_lab.bench.isolation import isolated
from rosplat_lab.bench.plan import Plan
from rosplat_lab.bench.records import Doing, Event, Measurement, Skipped
from rosplat_sorter.backends import BACKENDS, open_backend
from rosplat_sorter.map import SplatMap
from rosplat_tools.emulation.mapping import around
from rosplat_tools.program.processes import ProcessError

SIZE, QUICK_SIZE = 2_000_000, 100_000
BATCH = 1000  # splats a message
RATE = 200.0  # messages a second
POINTS = 25  # numbers of splats at which it is reported
LINGER = 1.0  # watched after the map is whole [s]
STALLED = 60.0  # a map that hasn't grown for so long won't [s]
SORTERS = ("sidecar", "bench")  # how an order's source begins that is not the renderer's own
PICTURE, QUICK_PICTURE = (1280, 720), (320, 180)


def measure(plan: Plan) -> Iterator[Event]:
    """Frame rate, RAM of each process and memory of the GPU, by number of splats and backend."""
    size = max(plan.sizes, default=QUICK_SIZE if plan.quick else SIZE)
    backends, missing = live.backends(plan.backends, live.BUILT_IN, live.GPU)
    yield from missing
    if plan.quick and not plan.backends:
        backends = backends[:2]
    picture = QUICK_PICTURE if plan.quick else PICTURE
    by_ros = live.has_ros() and not plan.one_process
    if not by_ros:
        yield Skipped("processes: publisher, sorter and viewer run in one, without ROS 2")
    for number, backend in enumerate(backends):
        yield Doing(f"to {size:,} splats, {backend}", number / len(backends))
        try:
            if by_ros:
                seen = _over_ros(plan, size, backend, picture)
                yield from _report(size, backend, "three processes", seen)
            else:
                yield from isolated(_in_one_process, size, backend, picture)
        except (ProcessError, RuntimeError) as error:
            yield Skipped(f"{backend}: {error}")


def _over_ros(plan: Plan, size: int, backend: str, picture: tuple[int, int]) -> live.Watched:
    return live.watch(
        plan.out,
        (
            "slam_emulator", "-p", f"path:={PROCEDURAL}{size}", "-p", f"rate:={RATE}",
            "-p", f"batch_size:={BATCH}", "-p", "refine_fraction:=0.0",
            "-p", "prune_fraction:=0.0",
        ),
        backend=backend, radius=scenes.GARDEN, picture=picture,
        until=lambda seen: _grown(seen, size, backend),
    )  # fmt: skip


def _grown(seen: live.Watched, size: int, backend: str) -> bool:
    """Whether the whole map is drawn, by the order that is measured, for a while."""
    if not seen.frames or not seen.ram:
        return False
    last = seen.frames[-1]
    since = next(f["time"] for f in seen.frames if f["splats"] == last["splats"])
    waited = seen.ram[-1][0] - since
    answered = backend not in BACKENDS or last["source"].startswith(SORTERS)
    settled = last["splats"] >= size and answered
    return (settled and waited > LINGER) or waited > STALLED


def _in_one_process(size: int, backend: str, picture: tuple[int, int]) -> Iterator[Event]:
    """The same without messages: the sorter is a thread, the publisher a part of each frame."""
    from rviz_gaussian_plugin.offscreen import ensure_display

    with ensure_display():
        yield from _report(size, backend, "one process", _grow(size, backend, picture))


def _grow(size: int, backend: str, picture: tuple[int, int]) -> live.Watched:
    splats = around(scenes.load(f"{PROCEDURAL}{size}"))
    cameras = scenes.overview(splats, *picture, 360)
    seen = live.Watched()
    gpu_before = machine.gpu_bytes_used()
    renderer = embedded.open_renderer()
    view = embedded.NumberedView(renderer)
    finish = embedded.gl_finish()
    sorter = None
    renderer.settings = embedded.changed({"order": live.order_source(backend)})
    if backend in BACKENDS:
        sorter = SortingThread(backend, splats, view)
    began = sampled = grown = time.time()
    sent = 0
    while time.time() < grown + LINGER:
        due = min(size, BATCH * (1 + int((time.time() - began) * RATE)))
        while sent < due:
            part = slice(sent, min(sent + BATCH, size))
            rendering.insert(renderer, splats, part, sent // BATCH + 1)
            sent = part.stop
        camera = cameras[len(seen.frames) % len(cameras)]
        number = view.look(camera)
        if sorter:
            sorter.ask(sent, number, camera)
        started = time.time()
        report = view.draw()
        finish()
        ended = time.time()
        shown = renderer.splats
        if shown < size:
            grown = ended
        seen.frames.append(
            {
                "time": ended, "frame": ended - started, "splats": shown,
                "source": report["order_source"], "orders": sorter.taken() if sorter else 0,
                "gpu_bytes": report["gpu_bytes"],
                "renderer": renderer.renderer_info,
            }
        )  # fmt: skip
        if ended - sampled >= live.SAMPLE:
            sampled = ended
            seen.ram.append((ended, "all in one", machine.resident_bytes()))
            gpu_now = machine.gpu_bytes_used()
            if gpu_now is not None and gpu_before is not None:
                seen.gpu_bytes.append((ended, gpu_now - gpu_before))
    if sorter:
        sorter.close()
    return seen


class SortingThread:
    """A backend of the sorter that answers a view's newest camera, as the sorter's node does."""

    def __init__(self, backend: str, splats: Splats, view: embedded.NumberedView) -> None:
        self._backend = open_backend(backend)
        self._splats = splats
        self._view = view
        self._map = SplatMap()
        self._wake = threading.Condition()
        self._question: tuple[int, int, Camera] | None = None
        self._given = 0
        self._closing = False
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def ask(self, count: int, number: int, camera: Camera) -> None:
        """For the order of the first `count` splats; a question that still waits is forgotten."""
        with self._wake:
            self._question = (count, number, camera)
            self._wake.notify()

    def taken(self) -> int:
        """How many orders were given since the last call."""
        with self._wake:
            given, self._given = self._given, 0
        return given

    def close(self) -> None:
        """Ends the thread after the sort it is at."""
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
            with self._wake:
                self._given += 1

    def _grow(self, count: int) -> None:
        new = slice(self._map.capacity, count)
        if new.start < new.stop:
            rendering.insert(self._map, self._splats, new, -(-count // BATCH))
            self._backend.update(self._map, self._map.changed_rows)


def _report(size: int, backend: str, by: str, seen: live.Watched) -> Iterator[Measurement]:
    """In POINTS steps of the number of splats."""
    step = max(1, size // POINTS)
    for low in range(0, size, step):
        frames = [f for f in seen.frames if low < f["splats"] <= low + step]
        if not frames:
            continue
        since, until = frames[0]["time"] - frames[0]["frame"], frames[-1]["time"]
        splats = round(sum(f["splats"] for f in frames) / len(frames))
        common = {
            "scene": f"{PROCEDURAL}{size}", "splats": splats, "gpu": frames[0]["renderer"],
            "backend": backend, "by": by,
        }  # fmt: skip
        yield Measurement.of("frame rate", "1/s", len(frames) / (until - since), **common)
        sidecar = sum(f["source"].startswith(SORTERS) for f in frames) / len(frames)
        yield Measurement.of("frames by the sorter's order", "%", 100 * sidecar, **common)
        if backend in BACKENDS:
            orders = sum(f["orders"] for f in frames)
            yield Measurement.of("orders", "1/s", orders / (until - since), **common)
        yield Measurement.of("frame", "ms", [1e3 * f["frame"] for f in frames], **common)
        for program in dict.fromkeys(who for _, who, _ in seen.ram):
            used = [
                b / 1e6 for time, who, b in seen.ram if who == program and since <= time <= until
            ]
            if used:
                yield Measurement.of("RAM", "MB", used, **common, process=program)
        held = [f["gpu_bytes"] / 1e6 for f in frames]
        yield Measurement.of("VRAM", "MB", held, **common, of="the renderer's buffers")
        used = [b / 1e6 for time, b in seen.gpu_bytes if since <= time <= until]
        if used:
            yield Measurement.of("VRAM", "MB", used, **common, of="all that the GPU holds more")
