"""The map coloured by where it is wrong: errors of pixels dealt to the splats that they show."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
from rclpy.node import Node

from rosplat_core.rendering import Contributions, posed
from rosplat_core.splats import Splats
from rosplat_tools.cameras.comparer import Compared
from rosplat_tools.cameras.drawn_map import DrawnMap
from rosplat_tools.map_publisher import MapPublisher

CHANNEL = "residual"
PERIOD = 2.0  # between two sendings, at least [s]
LEAST_WEIGHT = 0.25  # of a splat in all pictures, for a value [px]
LEAST_CHANGE = 0.005  # of a value that is sent again


class ResidualMap:
    """Publishes a copy of a map on `residuals`, its splats with a channel "residual".

    A splat's value is the mean error of the pixels that show it, weighted by what it contributes to
    each, over all pictures since the map's last edit.
    """

    def __init__(self, node: Node, drawn_map: DrawnMap) -> None:
        self._map = drawn_map
        self._publisher = MapPublisher(node, topic="residuals")
        self._sent = 0.0  # when it was
        self._pending = False  # whether pictures came since
        self._edits = -1  # of the map that the rest is of
        self._errors, self._weights = Contributions(), Contributions()
        self._splats: Splats | None = None
        self._slots = np.zeros(0, np.uint32)  # of the splats in the map
        self._values = np.zeros(0, np.float32)  # as sent

    def add(self, found: Compared, near: float, far: float) -> None:
        """Deals the errors of a picture's pixels, of those that count."""
        if self._edits != self._map.edits:
            self._edits, self._splats = self._map.edits, None
            self._errors, self._weights = Contributions(), Contributions()
        counts = found.mask.astype(np.float32)
        of_pixels = zip(
            found.warp.cameras(found.world_to_lens, near, far),
            found.warp.back(found.errors * counts),
            found.warp.back(counts),
            strict=True,
        )
        for camera, error, weight in of_pixels:
            renderer = self._map.renderer
            renderer.contribute(posed(camera), self._errors, residual=error)
            renderer.contribute(posed(camera), self._weights, residual=weight)
        self._pending = True

    def publish(self) -> None:
        """Sends what has changed, if that is due."""
        if not self._pending or time.monotonic() - self._sent < PERIOD:
            return
        self._pending = False
        renderer = self._map.renderer
        fresh = self._splats is None
        if self._splats is None:
            drawn = renderer.splats()
            self._slots = drawn.pop("slots")
            self._splats = Splats(**drawn, antialiased=self._map.books.antialiased)
        errors, weights = self._errors.residual[self._slots], self._weights.residual[self._slots]
        with np.errstate(all="ignore"):
            values = np.where(weights >= LEAST_WEIGHT, errors / weights, np.float32(np.nan))
        splats = replace(self._splats, channels={CHANNEL: values})
        self._publisher.frame_id = self._map.frame_id
        if fresh:
            self._publisher.replace(splats)
            self._values = values
            self._sent = time.monotonic()
            return
        same = np.abs(values - self._values) <= LEAST_CHANGE
        changed = np.flatnonzero(~same & ~(np.isnan(values) & np.isnan(self._values)))
        if len(changed):
            self._publisher.upsert(changed, splats[changed])
            self._values[changed] = values[changed]
        self._sent = time.monotonic()
