"""From a camera's pose to the picture that knows it, through three processes."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Iterator

import numpy as np

from rosplat_lab.bench import live, scenes
from rosplat_lab.bench.plan import Plan
from rosplat_lab.bench.records import Doing, Event, Measurement, Skipped
from rosplat_ros.program.processes import ProcessError, quoted

SIZES, QUICK_SIZES = (100_000, 500_000, 1_000_000), (50_000,)
RATES = (30.0, 60.0)  # at which the camera moves [Hz]
QUICK_RATES = (30.0,)
SECONDS, QUICK_SECONDS = 6.0, 3.0  # watched
SETTLING = 1.0  # not measured: the map is still uploaded [s]
PICTURE, QUICK_PICTURE = (1920, 1080), (320, 180)


def measure(plan: Plan) -> Iterator[Event]:
    """Latencies and memory by scene, rate of the camera and backend."""
    backends, missing = live.backends(plan.backends, live.GPU, live.PROCESSOR)
    yield from missing
    if plan.quick and not plan.backends:
        backends = backends[:1]
    names = scenes.names(plan.sizes or (QUICK_SIZES if plan.quick else SIZES), plan.scenes)
    rates = QUICK_RATES if plan.quick else RATES
    jobs = list(itertools.product(names, backends, rates))
    for number, (name, backend, rate) in enumerate(jobs):
        yield Doing(f"{name}, {backend}, {rate:.0f} Hz", number / len(jobs))
        try:
            seen = live.watch(
                plan.out, ("ply_publisher", "-p", f"path:={quoted(name)}"),
                backend=backend, rate=rate,
                picture=QUICK_PICTURE if plan.quick else PICTURE,
                seconds=SETTLING + (QUICK_SECONDS if plan.quick else SECONDS),
            )  # fmt: skip
        except (ProcessError, TimeoutError) as error:
            yield Skipped(f"{name}, {backend}, {rate:.0f} Hz: {error}")
            continue
        yield from _report(name, backend, rate, seen)


def _report(name: str, backend: str, rate: float, seen: live.Watched) -> Iterator[Event]:
    began = next(frame["time"] for frame in seen.frames if live.is_answered(frame))
    frames = [frame for frame in seen.frames if frame["time"] >= began + SETTLING]
    if not frames:
        yield Skipped(f"{name}, {backend}, {rate:.0f} Hz: a frame takes longer than it is watched")
        return
    arrivals = [arrival for frame in frames for arrival in frame["arrivals"]]
    common = {
        "scene": name, "splats": frames[-1]["splats"], "gpu": frames[-1]["renderer"],
        "rate": rate, "backend": backend,
    }  # fmt: skip
    carried = Counter(live.ENCODINGS[arrival["encoding"]] for arrival in arrivals)
    common["orders"] = carried.most_common(1)[0][0] if carried else "none"
    latencies = np.array([frame["latency"] for frame in frames])
    if np.isfinite(latencies).any():
        latencies = latencies[np.isfinite(latencies)]
        yield Measurement.of("pose to picture", "ms", 1e3 * latencies, **common)
    known = [arrival for arrival in arrivals if np.isfinite(arrival["looked"])]
    if known:
        ways = np.array([arrival["time"] - arrival["looked"] for arrival in known])
        sorting = np.array([arrival["sort_time"] for arrival in known])
        yield Measurement.of("pose to order", "ms", 1e3 * ways, **common)
        yield Measurement.of("of which sorting", "ms", 1e3 * sorting, **common)
        yield Measurement.of(
            "of which waiting and on the way", "ms", 1e3 * (ways - sorting), **common
        )
    yield Measurement.of("frame", "ms", [1e3 * frame["frame"] for frame in frames], **common)
    span = frames[-1]["time"] - frames[0]["time"]
    if span > 0:
        yield Measurement.of("frame rate", "1/s", (len(frames) - 1) / span, **common)
    for program in dict.fromkeys(program for _, program, _ in seen.ram):
        used = [bytes_ for time, who, bytes_ in seen.ram if who == program and bytes_]
        settled = [
            bytes_ / 1e6 for time, who, bytes_ in seen.ram
            if who == program and bytes_ and time >= frames[0]["time"]
        ]  # fmt: skip
        values = settled or [used[-1] / 1e6]
        yield Measurement.of("RAM", "MB", values, **common, process=program)
        yield Measurement.of(
            "most RAM", "MB", seen.most_ram[program] / 1e6, **common, process=program
        )
    if seen.idle_ram:
        yield Measurement.of("idle RAM", "MB", seen.idle_ram / 1e6, **common, process="sorter")
