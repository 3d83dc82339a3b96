"""A map that grows by 1,000 splats a message: frame rate and memory by the number of splats.

The protocol of ROSplat's paper (figures 3 to 6): every sorting backend on the same growing map.
"""

from __future__ import annotations

from collections.abc import Iterator

from rosplat_tools.bench import live
from rosplat_tools.bench.plan import Plan
from rosplat_tools.bench.records import Doing, Event, Measurement, Skipped
from rosplat_tools.processes import ProcessError
from rosplat_tools.scenes import PROCEDURAL

SIZE, QUICK_SIZE = 2_000_000, 100_000
BATCH = 1000  # splats a message
RATE = 50.0  # messages a second
POINTS = 25  # numbers of splats at which it is reported
GARDEN = 2.4  # radius of the procedural scene [m]
STALLED = 60.0  # a map that hasn't grown for so long won't [s]
PICTURE, QUICK_PICTURE = (1280, 720), (320, 180)


def measure(plan: Plan) -> Iterator[Event]:
    """Frame rate, RAM of each process and memory of the GPU, by number of splats and backend."""
    size = max(plan.sizes, default=QUICK_SIZE if plan.quick else SIZE)
    backends, missing = live.backends(plan.backends, built_in=not plan.quick)
    yield from missing
    if plan.quick and not plan.backends:
        backends = backends[:2]
    for number, backend in enumerate(backends):
        yield Doing(f"to {size:,} splats, {backend}", number / len(backends))
        try:
            seen = live.watch(
                plan.out,
                (
                    "slam_emulator", "-p", f"path:={PROCEDURAL}{size}", "-p", f"rate:={RATE}",
                    "-p", f"batch_size:={BATCH}", "-p", "refine_fraction:=0.0",
                    "-p", "prune_fraction:=0.0", "-p", f"history_depth:={2 * size // BATCH + 2}",
                ),
                backend=backend, radius=GARDEN, picture=QUICK_PICTURE if plan.quick else PICTURE,
                until=lambda seen: _grown(seen, size),
            )  # fmt: skip
        except ProcessError as error:
            yield Skipped(f"{backend}: {error}")
            continue
        yield from _report(size, backend, seen)


def _grown(seen: live.Watched, size: int) -> bool:
    if not seen.frames or not seen.ram:
        return False
    last = seen.frames[-1]["splats"]
    first_with_last = next(f for f in seen.frames if f["splats"] == last)
    waited = seen.ram[-1][0] - first_with_last["time"]
    return (last >= size and waited > 1.0) or waited > STALLED


def _report(size: int, backend: str, seen: live.Watched) -> Iterator[Measurement]:
    """In POINTS steps of the number of splats."""
    step = max(1, size // POINTS)
    for low in range(0, size, step):
        frames = [f for f in seen.frames if low < f["splats"] <= low + step]
        if len(frames) < 2:
            continue
        since, until = frames[0]["time"] - frames[0]["frame"], frames[-1]["time"]
        splats = round(sum(f["splats"] for f in frames) / len(frames))
        common = {"scene": f"{PROCEDURAL}{size}", "splats": splats, "backend": backend}
        yield Measurement.of("frame rate", "1/s", len(frames) / (until - since), **common)
        sidecar = sum(f["source"].startswith("sidecar") for f in frames) / len(frames)
        yield Measurement.of("frames by the sorter's order", "%", 100 * sidecar, **common)
        yield Measurement.of("frame", "ms", [1e3 * f["frame"] for f in frames], **common)
        for program in ("publisher", "sorter", "viewer"):
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
