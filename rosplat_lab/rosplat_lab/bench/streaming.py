"""How long pictures take while a map streams in, and until one shows all of it."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import takewhile
from time import perf_counter

from rosplat_core import rendering
from rosplat_lab.bench import embedded, scenes
from rosplat_lab.bench.records import Doing, Event, Measurement, Skipped

TIMEOUT = 120.0  # [s]
SETTLED = 0.5  # a picture that hasn't changed for so long is whole [s]


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


def measure(count: int) -> Iterator[Event]:
    """Frames while a map arrives as fast as it can be taken, the camera moving until it is sent."""
    yield Doing(f"{count:,} splats stream in", 0.0)
    (name,) = scenes.names((count,), ())
    renderer = embedded.open_renderer()
    finish = embedded.gl_finish()
    splats = scenes.load(name)
    view = embedded.NumberedView(renderer)
    cameras = scenes.overview(splats, *scenes.PICTURES[0], 360)
    view.set_camera(cameras[0])
    view.draw()
    finish()

    publisher = threading.Thread(target=rendering.insert_all, args=(renderer, splats))
    frames: list[Frame] = []
    start = perf_counter()
    publisher.start()
    sent = whole = False
    while not whole and perf_counter() - start < TIMEOUT:
        if not sent:
            sent = not publisher.is_alive()
            view.set_camera(cameras[len(frames) % len(cameras)])
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
        yield Skipped(f"{name} was not seen whole within {TIMEOUT:.0f} s")
