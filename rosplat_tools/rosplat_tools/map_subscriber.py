"""Keeps a map of rosplat_core equal to the map that a topic publishes."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from typing import Any

from rclpy.node import Node
from std_msgs.msg import Header

from rosplat_core.log_text import counted, shown
from rosplat_core.maps import Arrival
from rosplat_msgs.msg import GaussianArray
from rosplat_ros.batches import array_bytes
from rosplat_ros.map_receiver import MapReceiver

MOST_WAITING = 1 << 25  # of batches; batches beyond that are pulled later [bytes]
PATIENCE = 3.0  # how long problem() waits for a map that begins anew [s]


class MapSubscriber:
    """Hears `gaussians` and pulls missing batches. ROS's threads hand the batches over;
    apply_waiting() applies them, in the thread that uses the map.
    """

    def __init__(
        self,
        node: Node,
        target: Any,
        heard: Callable[[], None],
        *,
        most_sh_degree: int = 3,
    ) -> None:
        """target: a GaussianMap, or an object with one as its `map`. heard: called whenever a batch
        has come. most_sh_degree: harmonics above it aren't pulled.
        """
        self._node, self._target, self._heard = node, target, heard
        self.books = getattr(target, "map", target)
        self.header = Header()
        """Header of the last applied batch."""
        self.edits = 0
        """Number of applied batches. It grows whenever the map changes."""
        self.applied: Callable[[GaussianArray], None] = lambda batch: None
        """Called by apply_waiting() with each applied batch."""
        self._refused = self._dropped = 0  # refused batches, and dropped splats
        self._announced = False  # whether the map has held all that was announced
        self._began = self._applied = 0.0  # times of the last REPLACE and of the last batch [s]
        self._waiting: deque[tuple[GaussianArray, Arrival]] = deque()
        self._subscription = MapReceiver(
            node,
            self._on_batch,
            busy=lambda: self._backlog() > MOST_WAITING,
            most_sh_degree=most_sh_degree,
        )
        self.topic = self._subscription.topic

    def _backlog(self) -> int:
        return sum(array_bytes(batch) for batch, _ in tuple(self._waiting))

    def _on_batch(self, batch: GaussianArray, arrival: Arrival) -> None:
        self._waiting.append((batch, arrival))
        self._heard()

    def apply_waiting(self) -> None:
        """Applies the batches that wait by now. Call it from one thread at a time."""
        for _ in range(len(self._waiting)):  # those that come meanwhile can keep it from ending
            batch, arrival = self._waiting.popleft()
            try:
                dropped = self._target.apply(batch, arrival)["dropped"]
            except (ValueError, MemoryError) as error:  # no message may end the node
                self._refused += 1
                reason = shown(error, 300) or "out of memory"
                self._warn(f"batch {batch.revision} is refused, {self._refused} so far: {reason}")
                if isinstance(error, MemoryError):
                    self._waiting.clear()
                    self._subscription.pull_again()
                    return
                continue
            self.header = batch.header
            self.edits += 1
            self._applied = time.monotonic()
            if batch.operation == GaussianArray.REPLACE:
                self._announced, self._began = False, self._applied
            self._announced |= self.books.complete  # what is deleted later isn't missing
            self.applied(batch)
            if dropped:
                self._dropped += dropped
                self._warn(f"{counted(dropped, 'splat', 'splats')} with invalid values left out")

    def problem(self) -> str:
        """Why this copy of the map isn't whole; empty if it is.

        A map that begins anew counts as whole once all that its publisher announced has come, or
        after three seconds: it may be a map that grows.
        """
        books = self.books
        if not self.edits:
            return f"{self.topic}: no map has come yet"
        early = not self._announced and time.monotonic() - self._began < PATIENCE
        if books.missed or books.pulled or early:
            missing = "more is to come"
            if books.missed:
                missing = f"{counted(books.missed, 'batch is', 'batches are')} missing"
            splats = counted(books.splats, "splat", "splats")
            return f"{self.topic}: the map isn't complete: {splats}, {missing}"
        return ""

    def figures(self) -> dict[str, object]:
        """Values of the map for /diagnostics, by the names that all nodes use."""
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
