"""Methods by what their points have in common: medians, spreads, and the Pareto frontier."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from rosplat_lab.lab.points import Point

METRICS = {"psnr": True, "ssim": True, "flip": False, "worst": False}  # whether more is better
TIMES = {"ms": "sorting and drawing", "pose_ms": "pose to draw"}

Spread = tuple[float, float, float]
"""10 %, 50 % and 90 % quantile."""


@dataclass(frozen=True)
class Summary:
    """A method over the cameras and scenes of its points."""

    method: str
    family: str
    aside: str
    count: int
    ms: Spread | None
    pose_ms: Spread | None
    values: dict[str, Spread]
    """By the names of METRICS."""


def summarise(points: Iterable[Point]) -> list[Summary]:
    """A summary for each method, in the order in which they first appear."""
    groups: dict[str, list[Point]] = defaultdict(list)
    for point in points:
        groups[point.method].append(point)
    return [
        Summary(
            method,
            group[0].family,
            group[0].aside,
            len(group),
            _spread([point.ms for point in group if point.ms is not None]),
            _spread([point.pose_ms for point in group if point.pose_ms is not None]),
            {
                name: _spread([getattr(point, name) for point in group]) or (0, 0, 0)
                for name in METRICS
            },
        )
        for method, group in groups.items()
    ]


def _spread(values: Sequence[float]) -> Spread | None:
    if not values:
        return None
    low, middle, high = np.quantile(values, [0.1, 0.5, 0.9])
    return float(low), float(middle), float(high)


def front(summaries: Iterable[Summary], metric: str = "psnr", time: str = "ms") -> list[Summary]:
    """Those that no other beats in both a time of TIMES and a metric (by medians), fastest first.

    Of equals the first stays. What is to be seen aside, has no time, or was not measured in as many
    views as others, is left out.
    """
    better = 1 if METRICS[metric] else -1
    candidates = [s for s in summaries if getattr(s, time) and not s.aside]
    most = max((s.count for s in candidates), default=0)
    timed = [
        (getattr(s, time)[1], -better * s.values[metric][1], s)
        for s in candidates
        if s.count == most
    ]
    best, chosen = float("inf"), []
    for _, loss, summary in sorted(timed, key=lambda entry: entry[:2]):
        if loss < best:
            best = loss
            chosen.append(summary)
    return chosen
