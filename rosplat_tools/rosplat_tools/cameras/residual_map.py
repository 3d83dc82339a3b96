"""Publishes where the map is wrong: pixels' errors, dealt to the splats that the pixels show."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node

from rosplat_core.lens_warps import Warp
from rosplat_core.rendering import Contributions, posed
from rosplat_msgs.msg import GaussianArray
from rosplat_ros.batches import slots_of
from rosplat_ros.map_publisher import MapPublisher
from rosplat_tools.cameras.comparer import Compared
from rosplat_tools.cameras.drawn_map import DrawnMap
from rosplat_tools.cameras.taken_pictures import Taken

Value = TypeVar("Value", bound=np.generic)

CHANNEL = "residual"
PERIOD = 2.0  # between two sendings, at least [s]
KEPT = 0.9  # share of a splat's sums that each picture of it keeps
LEAST_WEIGHT = 0.25  # of a splat, over its pictures; with less it has no value [px]
LEAST_CHANGE = 0.005  # values that change by less aren't sent again


class ResidualMap:
    """Publishes a copy of a map on `residuals`, in the same slots, with a channel "residual".

    A splat's value is the mean error of the pixels that show it, weighted by its contribution to
    each, over about the last ten pictures of it. Writing a splat resets its value; a REPLACE or a
    MOVE resets all values.
    """

    def __init__(self, node: Node, drawn_map: DrawnMap) -> None:
        self._map = drawn_map
        self._map.applied = self._on_batch
        self._publisher = MapPublisher(node, topic="residuals")
        self._due = 0.0  # earliest time of the next sending
        self._pending = False  # whether pictures came since the last sending
        self._begin()

    def _begin(self) -> None:
        """Resets all values; the next sending has the whole map."""
        self._sums = np.zeros((2, 0), np.float32)  # by slot: errors times weights, and weights
        self._written = np.zeros(0, bool)  # by slot, whether it was written since the last sending
        self._slots: NDArray[np.uint32] | None = None  # in use at the last sending
        self._values = np.zeros(0, np.float32)  # by slot, as they were sent

    def _on_batch(self, batch: GaussianArray) -> None:
        if batch.operation in (GaussianArray.REPLACE, GaussianArray.MOVE):
            self._begin()
            return
        slots = slots_of(batch)
        self._written = grown(self._written, int(slots.max(initial=0)) + 1)
        self._written[slots] = True
        self._sums[:, slots[slots < self._sums.shape[1]]] = 0

    def add(self, found: Compared, warp: Warp, taken: Taken[Any]) -> None:
        """Deals the errors of those of a picture's pixels that count."""
        counts = found.mask.astype(np.float32)
        renderer = self._map.renderer
        sheets = warp.sheets(renderer.model)
        of_pixels = zip(
            sheets.cameras(taken.world_to_lens, *taken.clip),
            sheets.back(found.errors * counts),
            sheets.back(counts),
            strict=True,
        )
        dealt = Contributions(), Contributions()
        for (camera, curve), *residuals in of_pixels:
            for sums, residual in zip(dealt, residuals, strict=True):
                renderer.contribute(posed(camera), sums, residual=residual, lens=curve)
        errors, weights = (sums.residual for sums in dealt)
        self._sums = grown(self._sums, len(weights))
        shown = np.flatnonzero(weights > 0)
        self._sums[:, shown] *= KEPT
        self._sums[:, shown] += np.stack([errors[shown], weights[shown]])
        self._pending = True

    def publish(self) -> None:
        """Sends the splats that have changed, if a sending is due."""
        if not self._pending or time.monotonic() < self._due:
            return
        self._pending, self._due = False, time.monotonic() + PERIOD
        slots, drawn = self._map.renderer.snapshot()
        capacity = self._map.books.capacity
        errors, weights = grown(self._sums, capacity)[:, slots]
        with np.errstate(all="ignore"):
            values = np.where(weights >= LEAST_WEIGHT, errors / weights, np.float32(np.nan))
        splats = replace(drawn.with_sh_degree(0), channels={CHANNEL: values})
        self._publisher.frame_id = self._map.frame_id
        if self._slots is None:
            self._publisher.replace(replace(splats[:0], channels={}))
            self._publisher.expect(len(slots))
            changed = np.ones(len(slots), bool)
        else:
            if len(gone := np.setdiff1d(self._slots, slots)):
                self._publisher.delete(gone)
            before = grown(self._values, capacity, np.nan)[slots]
            same = np.abs(values - before) <= LEAST_CHANGE
            written = grown(self._written, capacity)[slots]
            changed = ~same & ~(np.isnan(values) & np.isnan(before)) | written
        if changed.any():
            self._publisher.upsert(slots[changed], splats[changed])
        self._slots, self._written = slots, np.zeros(0, bool)
        self._values = np.full(capacity, np.nan, np.float32)
        self._values[slots] = values


def grown(by_slot: NDArray[Value], capacity: int, by: float = 0.0) -> NDArray[Value]:
    """The array, its last axis padded to at least the number of a map's slots."""
    more = max(0, capacity - by_slot.shape[-1])
    widths = [(0, 0)] * (by_slot.ndim - 1) + [(0, more)]
    return np.pad(by_slot, widths, constant_values=by)
