"""A map that is received and drawn in one process, without a screen."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from rclpy.node import Node

from rosplat_core.log_text import shown
from rosplat_core.maps import Arrival
from rosplat_core.rendering import CpuRenderer
from rosplat_msgs.msg import GaussianArray
from rosplat_sorter.batches import apply, array_bytes
from rosplat_sorter.map_subscription import MapSubscription

MOST_WAITING = 1 << 25  # of batches, while a picture is drawn [bytes]


class DrawnMap:
    """Hears `gaussians`. ROS's threads hand batches over; one thread takes them, and draws."""

    def __init__(self, node: Node, heard: Callable[[], None]) -> None:
        """heard: called whenever a batch has come."""
        self.renderer = CpuRenderer()
        self.frame_id = ""
        self.edits = 0
        """Batches that were taken."""
        self._announced = False  # whether all that the publisher announced has been there
        self._node, self._heard = node, heard
        self._waiting: deque[tuple[GaussianArray, Arrival]] = deque()
        self._subscription = MapSubscription(node, self._hear, busy=self._is_busy)
        self.topic = self._subscription.topic

    def _is_busy(self) -> bool:
        return sum(array_bytes(batch) for batch, _ in tuple(self._waiting)) > MOST_WAITING

    def _hear(self, batch: GaussianArray, arrival: Arrival) -> None:
        self._waiting.append((batch, arrival))
        self._heard()

    def take(self) -> None:
        """Takes what has come since. Of the drawing thread."""
        while self._waiting:
            batch, arrival = self._waiting.popleft()
            try:
                report = apply(self.renderer, batch, arrival)
            except (ValueError, MemoryError) as error:  # no message may end the node
                reason = shown(error, 300) or "out of memory"
                self._warn(f"batch {batch.revision} is refused: {reason}")
                continue
            self.frame_id = batch.header.frame_id
            self.edits += 1
            if batch.operation == GaussianArray.REPLACE:
                self._announced = False
            # What is deleted later, and what a late pull has no more of, isn't missing.
            self._announced |= arrival is Arrival.LAST or self.renderer.map.complete
            if report["dropped"]:
                self._warn(f"{report['dropped']} splats with invalid values are left out")

    def problem(self) -> str:
        """Why a picture of the map would show less than there is; empty where it wouldn't."""
        books = self.renderer.map
        if not books.revision:
            return f"{self.topic}: no map has come yet"
        if not books.splats and not books.pulled and not books.missed:
            return f"{self.topic}: the map is empty"
        if books.missed or books.pulled or not self._announced:
            missing = f"{books.missed} batches are missing" if books.missed else "more is to come"
            return f"{self.topic}: the map isn't complete: {books.splats:,} splats, {missing}"
        return ""

    def _warn(self, text: str) -> None:
        self._node.get_logger().warning(f"{self.topic}: {text}", throttle_duration_sec=5.0)
