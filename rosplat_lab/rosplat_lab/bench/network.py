"""Orders of a sorter on another machine, over a line of gigabit Ethernet: DDS alone.

By UDP as programs of this project are started, and by TCP as Fast DDS offers it for large data.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator

from rosplat_core.scenes import PROCEDURAL
from rosplat_lab.bench import live
from rosplat_lab.bench.line import Line, NoLine
from rosplat_lab.bench.plan import Plan
from rosplat_lab.bench.records import Doing, Event, Measurement, Skipped
from rosplat_ros.program.processes import ProcessError

SIZES, QUICK_SIZES = (250_000, 500_000, 1_000_000, 2_000_000), (100_000,)
RATES, QUICK_RATES = (30.0, 60.0), (30.0,)  # at which the camera moves [Hz]
SECONDS, QUICK_SECONDS = 10.0, 2.0  # watched
PICTURE = (320, 180)  # small: what counts is that its order is there
RATE = "1gbit"
TRANSPORTS: dict[str, dict[str, str]] = {  # with the environment that asks for each
    "UDP": {},
    "TCP": {"FASTDDS_BUILTIN_TRANSPORTS": "LARGE_DATA"},
}
QUICK_TRANSPORTS = ("UDP",)  # Fast DDS 2.14 doesn't always find others by TCP


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
                    yield from _report(plan, line, size, backend, transport, rate)
        except NoLine as error:
            yield Skipped(f"network: {error}")
            return
        except (ProcessError, TimeoutError) as error:
            yield Skipped(f"{size:,} splats, {backend}, {transport}: {error}")


def _report(
    plan: Plan, line: Line, size: int, backend: str, transport: str, rate: float
) -> Iterator[Event]:
    begun = live.until_ordered()
    marks: list[tuple[float, int]] = []  # times, and bytes that had come to the viewer

    def watched(seen: live.Watched) -> bool:
        if not begun(seen):
            return False
        marks.append((time.time(), line.received("there")))
        return marks[-1][0] - marks[0][0] >= (QUICK_SECONDS if plan.quick else SECONDS)

    scene = f"{PROCEDURAL}{size}"
    seen = live.watch(
        plan.out, ("ply_publisher", "-p", f"path:={scene}"), backend=backend, rate=rate,
        picture=PICTURE, until=watched, line=line, environment=TRANSPORTS[transport],
    )  # fmt: skip
    (began, before), (ended, after) = marks[0], marks[-1]
    came = [arrival for frame in seen.frames for arrival in frame["arrivals"]]
    orders = [arrival for arrival in came if began <= arrival["time"] < ended]
    if not orders:
        raise TimeoutError("no more orders came")
    common = {
        "scene": scene, "splats": seen.frames[-1]["splats"], "rate": rate,
        "backend": backend, "line": RATE, "transport": transport,
        "orders": live.ENCODINGS[orders[-1]["encoding"]],
    }  # fmt: skip
    yield Measurement.of("orders", "1/s", len(orders) / (ended - began), **common)
    ways = [1e3 * (order["time"] - order["looked"]) for order in orders]
    yield Measurement.of("pose to order", "ms", ways, **common)
    sorting = [1e3 * order["sort_time"] for order in orders]
    yield Measurement.of("of which sorting", "ms", sorting, **common)
    yield Measurement.of("bytes of an order", "MB", orders[-1]["bytes"] / 1e6, **common)
    on_the_line = 8e-6 * (after - before) / (ended - began)
    yield Measurement.of("on the line", "Mbit/s", on_the_line, **common)
