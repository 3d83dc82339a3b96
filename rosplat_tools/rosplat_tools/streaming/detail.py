"""Which chunks of a scene to hold at which level of detail, for views of it. Knows no ROS.

The error of a chunk in a view is the distance between its splats there, in pixels. From nothing,
the step that mends the largest error is taken again and again, until errors are small enough or the
budget is spent.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rosplat_core.posed_camera import PosedCamera
from rosplat_core.quaternions import to_matrices
from rosplat_core.view import OVERSCAN
from rosplat_tools.streaming.slot_allocator import slots_for

Array = NDArray[np.float64]

NOTHING = -1  # the level of a chunk that is not held

# Factor on the errors of levels that are held, so that views that move a little don't have the same
# chunks fetched and dropped in turn.
LOYALTY = 1.5
# Factor on the errors of chunks outside of a view. It isn't 0 because cameras turn.
BEHIND = 1 / 16


@dataclass(frozen=True)
class Levels:
    """Chunks and their levels: bounds (n, 3) [m]; splats of each level, the coarsest first."""

    low: Array
    high: Array
    counts: Sequence[tuple[int, ...]]

    @cached_property
    def sizes(self) -> Array:
        """(n,) diagonals. [m]"""
        sizes: Array = np.linalg.norm(self.high - self.low, axis=1)
        return sizes

    @cached_property
    def table(self) -> NDArray[np.int64]:
        """(n, most levels) counts, 0 where a chunk has no such level."""
        table = np.zeros((len(self.counts), max(map(len, self.counts), default=0)), np.int64)
        for row, counts in zip(table, self.counts, strict=True):
            row[: len(counts)] = counts
        return table


def magnification(chunks: Levels, views: Sequence[PosedCamera]) -> Array:
    """(n,) pixels that a metre takes at each chunk's nearest point, in the view where it is most.

    Without a view all have one value, too small for more than their coarsest level.
    """
    most = np.full(len(chunks.low), 1e-6)
    for view in views:
        eye = np.asarray(view.position)
        nearest = np.clip(eye, chunks.low, chunks.high)
        distance = np.maximum(np.linalg.norm(nearest - eye, axis=1), max(view.near_clip, 1e-3))
        focal = max(view.fx, view.fy) * view.extent_scale
        scale = np.full(len(most), focal) if view.orthographic else focal / distance
        most = np.maximum(most, np.where(in_sight(chunks, view), scale, BEHIND * scale))
    return most


def in_sight(chunks: Levels, view: PosedCamera) -> NDArray[np.bool_]:
    """(n,) whether a view may show chunks, widened by OVERSCAN as orders are: cameras move."""
    ends = np.stack([chunks.low, chunks.high])
    which = np.indices((2, 2, 2)).reshape(3, 8)
    corners = np.stack([ends[which[axis], :, axis] for axis in range(3)], axis=2)  # (8, n, 3)
    x, y, z = np.moveaxis((corners - view.position) @ to_matrices(view.orientation), 2, 0)
    depth = np.ones_like(z) if view.orthographic else z
    seen: NDArray[np.bool_] = (z > view.near_clip).any(axis=0) & (z < view.far_clip).any(axis=0)
    for along, focal, centre, size in (
        (x, view.fx, view.cx, view.width),
        (y, view.fy, view.cy, view.height),
    ):
        reach = OVERSCAN * max(size - centre, centre) / focal
        seen &= (along <= reach * depth).any(axis=0) & (along >= -reach * depth).any(axis=0)
    return seen


def errors(chunks: Levels, scale: Array) -> Array:
    """(n, 1 + most levels) errors of each chunk: when it isn't held, then at each level [px].

    0 for lacking levels. scale: (n,) [px/m]. Splats lie on surfaces: the distance between
    them goes with the root of their number.
    """
    wide = chunks.sizes * scale
    apart = np.where(chunks.table > 0, wide[:, None] / np.sqrt(np.maximum(chunks.table, 1)), 0)
    return np.column_stack([wide, apart])


def choose(chunks: Levels, scale: Array, held: ArrayLike, budget: int, target: float) -> list[int]:
    """The level of each chunk, or NOTHING.

    scale: (n,) pixels that a metre takes. held: each chunk's level now. budget: the most
    slots in all. target: errors that are small enough [px]; chunks with smaller errors still have
    their coarsest level while the budget allows it.
    """
    table = chunks.table
    urgency = errors(chunks, scale)[:, :-1]  # of the step to each level
    step = np.arange(table.shape[1])
    stays = step <= np.asarray(held)[:, None]  # levels that are held
    urgency = np.where(stays, LOYALTY * urgency, urgency)
    urgency[(table == 0) | (~stays & (step > 0) & (urgency <= target))] = -1  # not wanted
    # A step needs the step before it, and so is no more urgent.
    urgency = np.minimum.accumulate(urgency, axis=1)
    more = np.diff(slots_for(table), axis=1, prepend=0)

    order = np.argsort(-urgency, axis=None, kind="stable")
    order = order[: np.count_nonzero(urgency >= 0)]
    levels = [NOTHING] * len(table)
    full = set[int]()  # chunks whose next step the budget has no room for
    for chunk, level, cost in zip(
        (order // len(step)).tolist(),
        (order % len(step)).tolist(),
        more.ravel()[order].tolist(),
        strict=True,
    ):
        if cost > budget:
            full.add(chunk)
        elif chunk not in full:
            budget -= cost
            levels[chunk] = level
    return levels
