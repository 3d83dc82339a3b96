"""Runs publisher, sorter and viewer as processes, and watches them from outside."""

from __future__ import annotations

import importlib
import json
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rosplat_core.program import machine
from rosplat_core.splats import InputError
from rosplat_lab.bench import records
from rosplat_lab.programs import Programs
from rosplat_ros.program.processes import node_command, quoted
from rosplat_sorter.backends import BACKENDS, Unavailable, open_backend

GPU = "gpu"  # the viewer's GPU sorts, no sorter runs
PROCESSOR = "processor"  # the viewer's rasteriser sorts, without a graphics card and a sorter
SAMPLE = 0.2  # between looks at the processes' memory [s]
ENCODINGS = ("inline", "packed", "shared memory")  # of SplatOrder, by number
START_TIMEOUT = 300.0  # until the first frame of a complete map [s]

Frame = dict[str, Any]
"""A line that moving_viewer writes."""


@dataclass
class Watched:
    """What was seen.

    ram: time, program, bytes. most_ram: the most bytes that each program had. idle_ram: bytes of
    the sorter before any view asked for an order, 0 without a sorter. Times are of time.time().
    """

    frames: list[Frame] = field(default_factory=list)
    ram: list[tuple[float, str, int]] = field(default_factory=list)
    most_ram: dict[str, int] = field(default_factory=dict)
    idle_ram: int = 0


def watch(
    out: Path,
    publisher: Sequence[str],
    *,
    backend: str,
    rate: float,
    picture: tuple[int, int],
    seconds: float,
) -> Watched:
    """Runs the three for so many seconds after a complete map's first order.

    publisher: an executable of rosplat_tools and its arguments. backend: of the sorter, or
    GPU or PROCESSOR. rate: at which the camera turns [Hz]. Raises ProcessError if one of them
    ends by itself, TimeoutError if no such order comes.
    """
    log = out / "log"
    trace = log / "trace.json"
    seen = Watched()
    # Beside a sorter, the viewer draws by the sorter's orders alone.
    source = "sidecar" if backend in BACKENDS else "auto"
    with Programs(log) as processes:
        trace.unlink(missing_ok=True)
        programs = {}
        if backend in BACKENDS:
            sorter = node_command(
                "rosplat_sorter", "sorter", *processes.remap, "-p", f"backend:={backend}"
            )
            programs["sorter"] = processes.start("sorter", sorter)
            while "waits for a view" not in processes.said("sorter"):
                processes.check()
                time.sleep(0.05)
            seen.idle_ram = machine.resident_bytes(programs["sorter"].pid)
        programs["viewer"] = processes.start(
            "viewer",
            [
                sys.executable, "-m", "rosplat_lab.bench.moving_viewer", *processes.remap,
                "-p", f"trace:={quoted(trace)}", "-p", f"rate:={rate}",
                "-p", f"width:={picture[0]}", "-p", f"height:={picture[1]}",
                "-p", f"order_source:={source}",
            ],
        )  # fmt: skip
        while not trace.exists():  # the viewer is ready, and misses nothing
            processes.check()
            time.sleep(0.05)
        command = node_command("rosplat_tools", publisher[0], *processes.remap, *publisher[1:])
        programs["publisher"] = processes.start("publisher", command)
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
                    seen.ram.append((now, name, resident))
                    # Linux knows both only nearly: the peak may be less than what is resident.
                    known = max(resident, seen.most_ram.get(name, 0))
                    seen.most_ram[name] = max(machine.peak_bytes(process.pid), known)
                text = rest + lines.read()
                *complete, rest = text.split("\n")
                new = [json.loads(line) for line in complete]
                seen.frames += new
                if end is None and any(map(is_answered, new)):
                    end = time.monotonic() + seconds
                if end is None and time.monotonic() - began > START_TIMEOUT:
                    raise TimeoutError("no complete map was seen, or nobody sorted it")
    return seen


def has_ros() -> bool:
    """Whether ROS 2 and this workspace's messages can be imported."""
    try:
        importlib.import_module("rclpy")
        importlib.import_module("rosplat_msgs.msg")
    except ImportError:
        return False
    return True


def is_answered(frame: Frame) -> bool:
    """Whether the frame shows a complete map, and an order has come or is fresh."""
    return bool(frame["complete"] and (frame["arrivals"] or frame["fresh"]))


def backends(asked: Sequence[str], *own: str) -> tuple[list[str], list[records.Skipped]]:
    """Backends that run here, and why others don't; own: the viewer's GPU, PROCESSOR.

    A backend that needs a GPU runs with an NVIDIA one, or where it is asked for by name. Raises
    InputError for an unknown name.
    """
    names = list(asked or BACKENDS)
    if not asked:
        card = bool(machine.nvidia_gpu()[0])
        names += [name for name in own if name != (PROCESSOR if card else GPU)]
    found, missing = [], []
    for name in names:
        if name not in (*BACKENDS, *own):
            raise InputError(f"unknown backend '{name}', known are {', '.join((*BACKENDS, *own))}")
        try:
            if name in BACKENDS:
                open_backend(name, gpu_only=BACKENDS[name].gpu and not asked)
            found.append(name)
        except Unavailable as error:
            missing.append(records.Skipped(f"{name}: {error}"))
    return found, missing
