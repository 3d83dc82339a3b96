"""From a camera's pose to the picture that knows it, through three processes: publisher, sorter and
viewer, watched from outside."""

from __future__ import annotations

import itertools
import json
import sys
import time
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from rosplat_core.program import machine
from rosplat_core.splats import InputError
from rosplat_lab.bench import scenes
from rosplat_lab.bench.plan import GPU, PROCESSOR, Plan
from rosplat_lab.bench.records import Doing, Event, Measurement, Skipped
from rosplat_lab.programs import Programs
from rosplat_ros.program.processes import ProcessError, quoted
from rosplat_sorter.backends import BACKENDS, Unavailable, open_backend

SIZES, QUICK_SIZES = (100_000, 500_000, 1_000_000), (50_000,)
RATES = (30.0, 60.0)  # at which the camera moves [Hz]
QUICK_RATES = (30.0,)
SECONDS, QUICK_SECONDS = 6.0, 3.0  # watched
SETTLING = 1.0  # not measured: the map is still uploaded [s]
PICTURE, QUICK_PICTURE = (1920, 1080), (320, 180)
SAMPLE = 0.2  # between looks at the processes' memory [s]
ENCODINGS = ("inline", "packed", "shared memory")  # of SplatOrder, by number
START_TIMEOUT = 300.0  # until the first frame of a complete map [s]

Frame = dict[str, Any]
"""A line that moving_viewer writes."""


@dataclass
class Watched:
    """What was seen.

    ram: of each program, times, and bytes then. most_ram: the most bytes that each had. idle_ram:
    bytes of the sorter before any view asked for an order, 0 without a sorter. Times are of
    time.time().
    """

    frames: list[Frame] = field(default_factory=list)
    ram: dict[str, list[tuple[float, int]]] = field(default_factory=lambda: defaultdict(list))
    most_ram: dict[str, int] = field(default_factory=dict)
    idle_ram: int = 0


def measure(plan: Plan) -> Iterator[Event]:
    """Latencies and memory by scene, rate of the camera and backend."""
    backends: list[str] = []
    for name in _wanted(plan):
        try:
            if name in BACKENDS:
                open_backend(name, gpu_only=BACKENDS[name].gpu and not plan.backends)
            backends.append(name)
        except Unavailable as error:
            yield Skipped(f"{name}: {error}")
    if plan.quick and not plan.backends:
        backends = backends[:1]
    names = scenes.names(plan.sizes or (QUICK_SIZES if plan.quick else SIZES), plan.scenes)
    rates = QUICK_RATES if plan.quick else RATES
    jobs = list(itertools.product(names, backends, rates))
    for number, (name, backend, rate) in enumerate(jobs):
        yield Doing(f"{name}, {backend}, {rate:.0f} Hz", number / len(jobs))
        try:
            seen = _watch(plan, name, backend, rate)
        except (ProcessError, TimeoutError) as error:
            yield Skipped(f"{name}, {backend}, {rate:.0f} Hz: {error}")
            continue
        yield from _report(name, backend, rate, seen)


def _wanted(plan: Plan) -> list[str]:
    """The backends asked for, else all; GPU and PROCESSOR are the viewer's own.

    A backend that needs a GPU runs with an NVIDIA one, or where it is asked for by name. Raises
    InputError for an unknown name.
    """
    if not plan.backends:
        return [*BACKENDS, GPU if machine.nvidia_gpu()[0] else PROCESSOR]
    known = (*BACKENDS, GPU, PROCESSOR)
    for name in plan.backends:
        if name not in known:
            raise InputError(f"unknown backend '{name}', known are {', '.join(known)}")
    return [*plan.backends]


def _watch(plan: Plan, scene: str, backend: str, rate: float) -> Watched:
    """Runs the three until so long after a complete map's first order.

    rate: at which the camera turns [Hz]. Raises ProcessError if one of them ends by itself,
    TimeoutError if no such order comes.
    """
    seen = Watched()
    width, height = QUICK_PICTURE if plan.quick else PICTURE
    # Beside a sorter, the viewer draws by the sorter's orders alone.
    source = "sidecar" if backend in BACKENDS else "auto"
    with Programs(plan.out / "log") as processes:
        trace = processes.folder / "trace.json"
        trace.unlink(missing_ok=True)
        programs = {}
        if backend in BACKENDS:
            programs["sorter"] = processes.node(
                "rosplat_sorter", "sorter", "-p", f"backend:={backend}"
            )
            while "waits for a view" not in processes.said("sorter"):
                processes.check()
                time.sleep(0.05)
            seen.idle_ram = machine.resident_bytes(programs["sorter"].pid)
        programs["viewer"] = processes.start(
            "viewer",
            [
                sys.executable, "-m", "rosplat_lab.bench.moving_viewer", *processes.remap,
                "-p", f"trace:={quoted(trace)}", "-p", f"rate:={rate}",
                "-p", f"width:={width}", "-p", f"height:={height}",
                "-p", f"order_source:={source}",
            ],
        )  # fmt: skip
        while not trace.exists():  # the viewer is ready, and misses nothing
            processes.check()
            time.sleep(0.05)
        programs["publisher"] = processes.node(
            "rosplat_tools", "ply_publisher", "-p", f"path:={quoted(scene)}", name="publisher"
        )
        with trace.open(encoding="utf-8") as lines:
            rest = ""
            began = time.monotonic()
            end: float | None = None
            while end is None or time.monotonic() < end:
                time.sleep(SAMPLE)
                processes.check()
                now = time.time()
                for name, process in programs.items():
                    resident = machine.resident_bytes(process.pid)
                    seen.ram[name].append((now, resident))
                    # Linux knows both only nearly: the peak may be less than what is resident.
                    known = max(resident, seen.most_ram.get(name, 0))
                    seen.most_ram[name] = max(machine.peak_bytes(process.pid), known)
                text = rest + lines.read()
                *complete, rest = text.split("\n")
                new = [json.loads(line) for line in complete]
                seen.frames += new
                if end is None and any(map(_is_answered, new)):
                    end = time.monotonic() + SETTLING + (QUICK_SECONDS if plan.quick else SECONDS)
                if end is None and time.monotonic() - began > START_TIMEOUT:
                    raise TimeoutError("no complete map was seen, or nobody sorted it")
    return seen


def _is_answered(frame: Frame) -> bool:
    """Whether the frame shows a complete map, and an order has come or is fresh."""
    return bool(frame["complete"] and (frame["arrivals"] or frame["fresh"]))


def _report(name: str, backend: str, rate: float, seen: Watched) -> Iterator[Event]:
    began = next(frame["time"] for frame in seen.frames if _is_answered(frame))
    frames = [frame for frame in seen.frames if frame["time"] >= began + SETTLING]
    if not frames:
        yield Skipped(f"{name}, {backend}, {rate:.0f} Hz: a frame takes longer than it is watched")
        return
    arrivals = [arrival for frame in frames for arrival in frame["arrivals"]]
    common = {
        "scene": name, "splats": frames[-1]["splats"], "gpu": frames[-1]["renderer"],
        "rate": rate, "backend": backend,
    }  # fmt: skip
    carried = Counter(ENCODINGS[arrival["encoding"]] for arrival in arrivals)
    common["orders"] = carried.most_common(1)[0][0] if carried else "none"
    latencies = np.array([frame["latency"] for frame in frames])
    if np.isfinite(latencies).any():
        latencies = latencies[np.isfinite(latencies)]
        yield Measurement("pose to picture", "ms", 1e3 * latencies, **common)
    known = [arrival for arrival in arrivals if np.isfinite(arrival["looked"])]
    if known:
        ways = np.array([arrival["time"] - arrival["looked"] for arrival in known])
        sorting = np.array([arrival["sort_time"] for arrival in known])
        yield Measurement("pose to order", "ms", 1e3 * ways, **common)
        yield Measurement("of which sorting", "ms", 1e3 * sorting, **common)
        yield Measurement("of which waiting and on the way", "ms", 1e3 * (ways - sorting), **common)
    yield Measurement("frame", "ms", [1e3 * frame["frame"] for frame in frames], **common)
    span = frames[-1]["time"] - frames[0]["time"]
    if span > 0:
        yield Measurement("frame rate", "1/s", (len(frames) - 1) / span, **common)
    for program, ram in seen.ram.items():
        used = [(when, count / 1e6) for when, count in ram if count]
        settled = [count for when, count in used if when >= frames[0]["time"]]
        most = seen.most_ram[program] / 1e6
        yield Measurement("RAM", "MB", settled or used[-1][1], **common, process=program)
        yield Measurement("most RAM", "MB", most, **common, process=program)
    if seen.idle_ram:
        yield Measurement("idle RAM", "MB", seen.idle_ram / 1e6, **common, process="sorter")
