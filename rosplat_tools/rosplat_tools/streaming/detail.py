"""Which chunks of a scene to hold at which level of detail, for views of it. Knows no ROS.

The error of a chunk in a view is the distance between its splats there, in pixels. From nothing,
the step that mends the largest error is taken again and again, until errors are small enough or the
budget is spent.
"""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rosplat_sorter.camera import Camera
from rosplat_sorter.slot_pages import SLOTS_PER_PAGE
from rosplat_sorter.view import OVERSCAN, rotation_matrix

Array = NDArray[np.float64]

NOTHING = -1  # the level of a chunk that is not held

# What is held already counts for so many times its error, so that views that move a little don't
# have the same chunks fetched and dropped in turn.
LOYALTY = 1.5
# What a view doesn't show counts for so much of its error: cameras turn.
BEHIND = 1 / 16


@dataclass(frozen=True)
class Levels:
    """Chunks and their levels: bounds (n, 3) [m]; splats of each level, the coarsest first."""

    low: Array
    high: Array
    counts: Sequence[tuple[int, ...]]

    @property
    def sizes(self) -> Array:
        """(n,) diagonals. [m]"""
        sizes: Array = np.linalg.norm(self.high - self.low, axis=1)
        return sizes


def magnification(chunks: Levels, views: Sequence[Camera]) -> Array:
    """(n,) pixels that a metre takes at each chunk's nearest point, in the view where it is most.

    Without a view all are alike, and too small to be worth more than their coarsest level.
    """
    most = np.full(len(chunks.low), 1e-6)
    for view in views:
        eye = np.asarray(view.position)
        nearest = np.clip(eye, chunks.low, chunks.high)
        distance = np.maximum(np.linalg.norm(nearest - eye, axis=1), max(view.near_clip, 1e-3))
        focal = max(view.fx, view.fy) * view.extent_scale
        scale = np.full(len(most), focal) if view.orthographic else focal / distance
        most = np.maximum(most, np.where(_in_sight(chunks, view), scale, BEHIND * scale))
    return most


def _in_sight(chunks: Levels, view: Camera) -> NDArray[np.bool_]:
    """(n,) whether a view, as wide as orders are for cameras that move, may show chunks."""
    ends = np.stack([chunks.low, chunks.high])
    which = np.indices((2, 2, 2)).reshape(3, 8)
    corners = np.stack([ends[which[axis], :, axis] for axis in range(3)], axis=2)  # (8, n, 3)
    x, y, z = np.moveaxis((corners - view.position) @ rotation_matrix(*view.orientation), 2, 0)
    depth = np.ones_like(z) if view.orthographic else z
    seen = (z > view.near_clip).any(axis=0) & (z < view.far_clip).any(axis=0)
    for along, focal, centre, size in (
        (x, view.fx, view.cx, view.width),
        (y, view.fy, view.cy, view.height),
    ):
        reach = OVERSCAN * max(size - centre, centre) / focal
        seen &= (along <= reach * depth).any(axis=0) & (along >= -reach * depth).any(axis=0)
    return seen


def errors(chunks: Levels, scale: Array) -> list[tuple[float, ...]]:
    """For each chunk, its error when it isn't held, then at each level [px]; scale: (n,) [px/m].

    Splats lie on surfaces: the distance between them goes with the root of their number.
    """
    return [
        (float(wide), *(float(wide) / count**0.5 for count in counts))
        for wide, counts in zip(chunks.sizes * scale, chunks.counts, strict=True)
    ]


def slots_for(count: int) -> int:
    """How many slots a level of so many splats takes: whole pages."""
    return -(-count // SLOTS_PER_PAGE) * SLOTS_PER_PAGE


def choose(
    chunks: Levels, scale: Array, held: Sequence[int], budget: int, target: float
) -> list[int]:
    """The level of each chunk, or NOTHING.

    scale: (n,) pixels that a metre takes. held: the levels that there are now. budget: the most
    slots in all. target: errors that are small enough [px]; but all chunks have their coarsest
    level while the budget allows it, however small they are.
    """
    found = errors(chunks, scale)
    levels = [NOTHING] * len(chunks.counts)

    def urgency(chunk: int) -> float:
        """Of the chunk's next step; 0 where none is worth it."""
        level = levels[chunk]
        if level + 1 == len(chunks.counts[chunk]):
            return 0.0
        error = found[chunk][level + 1]
        if level < held[chunk]:
            return LOYALTY * error  # it may stay as long as nothing else needs its place
        return error if level == NOTHING or error > target else 0.0

    steps = [(-urgency(chunk), chunk) for chunk in range(len(levels))]
    heapq.heapify(steps)
    while steps:
        worth, chunk = heapq.heappop(steps)
        if not worth:
            break
        counts, level = chunks.counts[chunk], levels[chunk]
        more = slots_for(counts[level + 1]) - (slots_for(counts[level]) if level >= 0 else 0)
        if more <= budget:
            budget -= more
            levels[chunk] += 1
            heapq.heappush(steps, (-urgency(chunk), chunk))
    return levels
