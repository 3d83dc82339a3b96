"""A map of rosplat_core that is kept as its topic has it."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from typing import Any

from rclpy.node import Node
from std_msgs.msg import Header

from rosplat_core.log_text import shown
from rosplat_core.maps import Arrival
from rosplat_msgs.msg import GaussianArray
from rosplat_sorter.batches import apply, array_bytes
from rosplat_sorter.map_subscription import MapSubscription

MOST_WAITING = 1 << 25  # of batches; what comes beyond that is pulled later [bytes]
PATIENCE = 3.0  # how long a map that begins anew is waited for [s]


class MapSubscriber:
    """Hears `gaussians` and pulls what is missing. ROS's threads hand batches over; take() applies
    them, in the thread of whoever uses the map.
    """

    def __init__(
        self,
        node: Node,
        target: Any,
        heard: Callable[[], None] | None = None,
        *,
        most_sh_degree: int = 3,
    ) -> None:
        """target: a GaussianMap, or what has one as its `map`. heard: called whenever a batch has
        come; by default it is take(). most_sh_degree: what is pulled has no harmonics above it.
        """
        self._node, self._target, self._heard = node, target, heard or self.take
        self.books = getattr(target, "map", target)
        self.header = Header()
        """Of the last batch that was applied."""
        self.edits = 0
        """Batches that were applied: the map is another one when it grows."""
        self.applied: Callable[[GaussianArray], None] = lambda batch: None
        """Is told of each of them, by take()."""
        self._refused = self._dropped = 0  # batches, and splats
        self._announced = False  # whether all that the publisher announced has been there
        self._began = self._applied = 0.0  # the map, and its last batch
        self._waiting: deque[tuple[GaussianArray, Arrival]] = deque()
        self._subscription = MapSubscription(
            node,
            self._hear,
            busy=lambda: self._backlog() > MOST_WAITING,
            most_sh_degree=most_sh_degree,
        )
        self.topic = self._subscription.topic

    def _backlog(self) -> int:
        return sum(array_bytes(batch) for batch, _ in tuple(self._waiting))

    def _hear(self, batch: GaussianArray, arrival: Arrival) -> None:
        self._waiting.append((batch, arrival))
        self._heard()

    def take(self) -> None:
        """Applies what has come since. In one thread at a time."""
        while self._waiting:
            batch, arrival = self._waiting.popleft()
            try:
                dropped = apply(self._target, batch, arrival)["dropped"]
            except (ValueError, MemoryError) as error:  # no message may end the node
                self._refused += 1
                reason = shown(error, 300) or "out of memory"
                self._warn(f"batch {batch.revision} is refused, {self._refused} so far: {reason}")
                continue
            self.header = batch.header
            self.edits += 1
            self._applied = time.monotonic()
            if batch.operation == GaussianArray.REPLACE:
                self._announced, self._began = False, self._applied
            # What is deleted later, and what a late pull has no more of, isn't missing.
            self._announced |= arrival is Arrival.LAST or self.books.complete
            self.applied(batch)
            if dropped:
                self._dropped += dropped
                self._warn(f"{dropped} splats with invalid values are left out")

    def problem(self) -> str:
        """Why less of the map is here than there is; empty where all of it is.

        A map that begins anew is waited for until all that its publisher announced is there, or
        for three seconds: it may be one that grows.
        """
        books = self.books
        if not self.edits:
            return f"{self.topic}: no map has come yet"
        early = not self._announced and time.monotonic() - self._began < PATIENCE
        if books.missed or books.pulled or early:
            missing = f"{books.missed} batches are missing" if books.missed else "more is to come"
            return f"{self.topic}: the map isn't complete: {books.splats:,} splats, {missing}"
        return ""

    def figures(self) -> dict[str, object]:
        """What /diagnostics has of a map, by the words that all nodes use."""
        return {
            "Map": self.books.map_id,
            "Revision": self.books.revision,
            "Splats": self.books.splats,
            "Age (s)": round(time.monotonic() - self._applied, 3),
            "Backlog (bytes)": self._backlog(),
            "Batches missed": self.books.missed,
            "Batches dropped": self._refused,
            "Splats dropped": self._dropped,
        }

    def _warn(self, text: str) -> None:
        self._node.get_logger().warning(f"{self.topic}: {text}", throttle_duration_sec=5.0)
