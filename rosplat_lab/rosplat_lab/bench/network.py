"""Orders of a sorter on another machine, over a line of gigabit Ethernet: DDS alone.

By UDP as programs of this project are started, and by TCP as Fast DDS offers it for large data.
"""

from __future__ import annotations

import itertools
import json
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from rosplat_core.scenes import PROCEDURAL
from rosplat_lab.bench import live
from rosplat_lab.bench.line import Line, NoLine
from rosplat_lab.bench.plan import Plan
from rosplat_lab.bench.records import Doing, Event, Measurement, Skipped
from rosplat_tools.program.processes import ProcessError, Processes, node_command

SIZES, QUICK_SIZES = (250_000, 500_000, 1_000_000, 2_000_000), (100_000,)
RATES, QUICK_RATES = (30.0, 60.0), (30.0,)  # at which the camera moves [Hz]
SECONDS, QUICK_SECONDS = 10.0, 2.0  # watched
RATE = "1gbit"
TRANSPORTS: dict[str, dict[str, str]] = {  # and the environment that asks for them
    "UDP": {},
    "TCP": {"FASTDDS_BUILTIN_TRANSPORTS": "LARGE_DATA"},
}
QUICK_TRANSPORTS = ("UDP",)  # Fast DDS 2.14 doesn't always find others by TCP
PATIENCE = 60.0  # with the first order of all splats [s]

Order = dict[str, Any]
"""A line that far_viewer writes."""


def measure(plan: Plan) -> Iterator[Event]:
    """Orders a second, their way from pose to slots, and what is on the line meanwhile."""
    sizes = plan.sizes or (QUICK_SIZES if plan.quick else SIZES)
    backends, missing = live.backends(plan.backends or ("native",))
    yield from missing
    rates = QUICK_RATES if plan.quick else RATES
    transports = QUICK_TRANSPORTS if plan.quick else tuple(TRANSPORTS)
    jobs = list(itertools.product(sizes, backends, transports))
    for number, (size, backend, transport) in enumerate(jobs):
        yield Doing(f"{size:,} splats, {backend}, {transport}", number / len(jobs))
        try:
            with Line(RATE) as line:
                for rate in rates:
                    seconds = QUICK_SECONDS if plan.quick else SECONDS
                    yield from _report(plan, line, size, backend, transport, rate, seconds)
        except NoLine as error:
            yield Skipped(f"network: {error}")
            return
        except (ProcessError, TimeoutError) as error:
            yield Skipped(f"{size:,} splats, {backend}, {transport}: {error}")


def _report(
    plan: Plan, line: Line, size: int, backend: str, transport: str, rate: float, seconds: float
) -> Iterator[Measurement]:
    orders, received, span = watch(
        plan.out / "log", line, size,
        backend=backend, transport=transport, rate=rate, seconds=seconds,
    )  # fmt: skip
    ways = [1e3 * (order["time"] - order["looked"]) for order in orders]
    common = {
        "scene": f"{PROCEDURAL}{size}", "splats": orders[-1]["slots"], "rate": rate,
        "backend": backend, "line": RATE, "transport": transport,
        "orders": live.ENCODINGS[orders[-1]["encoding"]],
    }  # fmt: skip
    yield Measurement.of("orders", "1/s", len(orders) / span, **common)
    yield Measurement.of("pose to order", "ms", ways, **common)
    sorting = [1e3 * order["sort_time"] for order in orders]
    yield Measurement.of("of which sorting", "ms", sorting, **common)
    yield Measurement.of("bytes of an order", "MB", orders[-1]["bytes"] / 1e6, **common)
    yield Measurement.of("on the line", "Mbit/s", 8e-6 * received / span, **common)


def watch(
    log: Path, line: Line, size: int, *, backend: str, transport: str, rate: float, seconds: float
) -> tuple[list[Order], int, float]:
    """Orders that came in so many seconds, the bytes that came meanwhile, and how long it was [s].

    The map and its sorter are on one machine, the viewer on another. Raises ProcessError, and
    TimeoutError where no order of all splats comes.
    """
    trace = log / "trace.json"
    trace.unlink(missing_ok=True)
    publisher = node_command(
        "rosplat_tools", "ply_publisher", "--ros-args", "-p", f"path:={PROCEDURAL}{size}"
    )
    sorter = node_command("rosplat_sorter", "sorter", "--ros-args", "-p", f"backend:={backend}")
    viewer = [
        sys.executable, "-m", "rosplat_lab.bench.far_viewer", "--ros-args",
        "-p", f"trace:={trace}", "-p", f"rate:={rate}",
    ]  # fmt: skip
    settings = TRANSPORTS[transport]
    with Processes(log) as processes:
        processes.start("far_viewer", line.at("there", viewer), **settings)
        processes.start("sorter", line.at("here", sorter), **settings)
        processes.start("publisher", line.at("here", publisher), **settings)
        _await(lambda: any(o["slots"] == size for o in _orders(trace)), processes)
        began, before = time.time(), line.received("there")
        time.sleep(seconds)
        received, ended = line.received("there") - before, time.time()
        processes.check()
    orders = [order for order in _orders(trace) if began <= order["time"] < ended]
    if not orders:
        raise TimeoutError("no more orders came")
    return orders, received, ended - began


def _orders(trace: Path) -> list[Order]:
    """Those that have come, but for a line that is being written."""
    if not trace.exists():
        return []
    *complete, _ = trace.read_text().split("\n")
    return [json.loads(line) for line in complete]


def _await(condition: Callable[[], bool], processes: Processes) -> None:
    deadline = time.monotonic() + PATIENCE
    while not condition():
        processes.check()
        if time.monotonic() > deadline:
            raise TimeoutError("no order of all splats came")
        time.sleep(0.1)
