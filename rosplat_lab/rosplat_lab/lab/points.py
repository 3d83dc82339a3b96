"""What records of the laboratory say: a point for each way and scene, and those that pay."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from rosplat_lab.bench.records import Record
from rosplat_lab.lab.ways import DEFAULT, ERROR, TIME

LEAST_NOISE = 0.02  # least part of a time: repeated runs may agree by chance
LEAST_GAIN = 0.5  # smaller differences nobody sees [dB]


@dataclass(frozen=True)
class Point:
    """A way to draw a scene: what it takes, and how far its pictures are from the reference's."""

    setting: str
    family: str
    aside: str
    """Why it is not held against others, empty where it is."""
    scene: str
    splats: int
    ms: float | None
    """Time of a frame; None of a model."""
    ms_noise: float
    """By how much the median of a run's passes was above the least."""
    psnr: float
    psnr_noise: float
    worst_view: float
    """PSNR of the worst of the views. [dB]"""
    worst_pixel: float
    """The largest difference of a pixel in a channel; 1 is black for white."""
    drawn: int
    """Splats in a view, on average; 0 where that isn't known."""


def points(records: Sequence[Record]) -> list[Point]:
    """The points of a run's records, in their order."""
    times = {_key(record): record for record in records if record.name == TIME}
    found = []
    for record in records:
        if record.name != ERROR:
            continue
        labels, time = record.parameters, times.get(_key(record))
        found.append(
            Point(
                str(labels["setting"]), str(labels["family"]), str(labels["aside"]),
                Path(record.scene).stem, record.splats,
                time.p50 if time else None, time.p50 - time.least if time else 0.0,
                record.p50, record.most - record.least,
                float(labels.get("worst_view", record.p50)),
                float(labels.get("worst_pixel", 0.0)), int(labels.get("drawn", 0)),
            )
        )  # fmt: skip
    return found


def by_scene(found: Iterable[Point]) -> list[list[Point]]:
    """The points of each scene, in their order."""
    scenes: dict[str, list[Point]] = {}
    for point in found:
        scenes.setdefault(point.scene, []).append(point)
    return list(scenes.values())


def _key(record: Record) -> tuple[object, ...]:
    labels = record.parameters
    return record.scene, labels["setting"], labels["aside"]


def frontier(found: Iterable[Point]) -> list[Point]:
    """The points that no other beats in both time and PSNR, fastest first.

    A slower point must gain decibels, and one with fewer must gain time, by more than passes
    differ. Of equals the first stays. Points with an `aside` are left out.
    """
    candidates = [p for p in found if p.ms is not None and not p.aside]
    chosen: list[Point] = []
    for point in sorted(candidates, key=lambda p: (p.ms or 0, -p.psnr)):
        if chosen and abs(point.psnr - chosen[-1].psnr) <= _gain(point, chosen[-1]):
            first = candidates.index(point) < candidates.index(chosen[-1])
            if first and (point.ms or 0) - (chosen[-1].ms or 0) <= _noise(point, chosen[-1]):
                chosen[-1] = point
            continue
        if chosen and point.psnr < chosen[-1].psnr:
            continue
        while chosen and (point.ms or 0) - (chosen[-1].ms or 0) <= _noise(point, chosen[-1]):
            chosen.pop()
        chosen.append(point)
    return chosen


def _gain(a: Point, b: Point) -> float:
    return max(a.psnr_noise, b.psnr_noise, LEAST_GAIN)


def _noise(a: Point, b: Point) -> float:
    return max(a.ms_noise, b.ms_noise, LEAST_NOISE * (a.ms or 0))


def for_decibels(found: Iterable[Point], least: float) -> Point | None:
    """The fastest of a frontier with so many decibels."""
    return next((p for p in frontier(found) if p.psnr >= least), None)


def verdict(found: Sequence[Point]) -> str:
    """Whether the default is justified by the points of a scene, and by which figures."""
    default = next(p for p in found if p.setting == DEFAULT)
    best = frontier(found)
    assert default.ms is not None
    said = f"{default.ms:.3g} ms, {default.psnr:.1f} dB"
    if default in best:
        slower = [p for p in best if p.psnr > default.psnr]
        if not slower:
            return f"on the frontier, and nothing is more exact ({said})"
        more = f"{slower[0].setting} has {slower[0].psnr:.1f} dB in {slower[0].ms:.3g} ms"
        return f"on the frontier ({said}); {more}"
    better = [
        p for p in best
        if p.psnr > default.psnr - LEAST_GAIN and default.ms - (p.ms or 0) > _noise(default, p)
    ]  # fmt: skip
    names = ", ".join(f"{p.setting} ({p.ms:.3g} ms, {p.psnr:.1f} dB)" for p in better)
    return f"beaten ({said}) by {names}" if names else f"within the noise of the frontier ({said})"
