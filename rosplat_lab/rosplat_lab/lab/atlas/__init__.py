"""The atlas of failures: where methods are known to break, and by how much, as difficulty grows.

`projection`, `coordinates`, `ordering`, `blending` and `fewer` are its chapters, on the `stage`
that they share.
"""

from __future__ import annotations

from collections.abc import Iterator

from rosplat_lab.bench.isolation import isolated
from rosplat_lab.bench.plan import Plan
from rosplat_lab.bench.records import Doing, Event, Measurement
from rosplat_lab.lab.atlas import blending, coordinates, fewer, ordering, projection
from rosplat_lab.lab.atlas.case import Case
from rosplat_lab.lab.atlas.stage import Stage

CASES: dict[str, Case] = (
    projection.CASES | coordinates.CASES | ordering.CASES | blending.CASES | fewer.CASES
)


def measure(plan: Plan) -> Iterator[Event]:
    """The error of every case, by curve and difficulty."""
    from rviz_gaussian_plugin.offscreen import ensure_display

    with ensure_display():
        yield from isolated(_explored, plan.quick)


def _explored(quick: bool) -> Iterator[Event]:
    stage = Stage(quick)
    for number, (name, case) in enumerate(CASES.items()):
        yield Doing(case.title, number / len(CASES))
        for difficulty in stage.some(case.difficulties):
            for curve, error in case.measure(stage, difficulty):
                yield Measurement.of(
                    name, case.unit, error, gpu=stage.graphics, curve=curve,
                    difficulty=float(difficulty),
                )  # fmt: skip
