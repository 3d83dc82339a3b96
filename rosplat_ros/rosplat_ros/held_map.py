"""Keeps a map of rosplat_core equal to the map that a topic publishes."""

from __future__ import annotations

import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from typing import Any

from rclpy.node import Node
from std_msgs.msg import Header

from rosplat_core.log_text import counted, shown
from rosplat_core.maps import Arrival
from rosplat_msgs.msg import GaussianArray
from rosplat_ros.batches import array_bytes
from rosplat_ros.map_receiver import MapReceiver
from rosplat_ros.program.said_once import Throttled

MOST_WAITING = 1 << 25  # of batches; while there are more, no more should come [bytes]
POLL = 0.005  # between two looks at what nothing tells of, such as TF [s]
PATIENCE = 3.0  # how long problem() waits for a map that begins anew [s]


class HeldMap:
    """A map, and the batches that wait to edit it: any thread hands them over, the thread that uses
    the map applies them.
    """

    def __init__(self, target: Any, topic: str, log: Throttled) -> None:
        """target: a GaussianMap, or an object with one as its `map`. topic: of the map."""
        self._target, self.topic, self._log = target, topic, log
        self.books = getattr(target, "map", target)
        self.header = Header()
        """Header of the last applied batch."""
        self.edits = 0
        """Number of applied batches. It grows whenever the map changes."""
        self.came = threading.Event()
        """Set whenever something has come that the thread which uses the map should look at."""
        self.applied: Callable[[GaussianArray], None] = lambda batch: None
        """Called by apply_waiting() with each applied batch."""
        self.pull_again: Callable[[], None] = lambda: None
        """Called when there was no memory for a batch: all of the map has to come again."""
        self._refused = self._dropped = 0  # refused batches, and dropped splats
        self._announced = False  # whether the map has held all that was announced
        self._began = 0.0  # time of the last REPLACE [s]
        self._applied = time.monotonic()  # of the last batch; at first, of the start [s]
        self._lock = threading.RLock()  # of the next two
        self._waiting: deque[tuple[GaussianArray, Arrival]] = deque()
        self._backlog = 0  # of these and of the one that is being applied [bytes]

    @property
    def waits(self) -> bool:
        """Whether a batch waits."""
        return bool(self._waiting)

    @property
    def busy(self) -> bool:
        """Whether too many batches wait."""
        return self._backlog > MOST_WAITING

    def add(self, batch: GaussianArray, arrival: Arrival = Arrival.HEARD) -> None:
        """Takes a batch; forgets those that it replaces. Waits for nothing."""
        with self._lock:
            if batch.operation == GaussianArray.REPLACE:
                self._forget()
            self._waiting.append((batch, arrival))
            self._backlog += array_bytes(batch)
        self.came.set()

    def _forget(self) -> None:
        """Drops all batches but the one that is being applied."""
        with self._lock:
            self._backlog -= sum(array_bytes(batch) for batch, _ in self._waiting)
            self._waiting.clear()

    def apply_waiting(self, most: int = sys.maxsize) -> None:
        """Applies the batches that wait by now, until `most` bytes are applied. Call it from one
        thread at a time.
        """
        applied = 0
        for _ in range(len(self._waiting)):  # those that come meanwhile can keep it from ending
            with self._lock:
                if not self._waiting or applied >= most:
                    return
                waiting = self._waiting.popleft()
            size = array_bytes(waiting[0])
            try:
                self._apply(*waiting)
            finally:
                del waiting  # frees its memory before the count of waiting bytes falls
                with self._lock:
                    self._backlog -= size
            applied += size

    def _apply(self, batch: GaussianArray, arrival: Arrival) -> None:
        which = f"{batch.revision} of map '{shown(batch.map_id)}'"
        try:
            report = self._target.apply(batch, arrival)
        except (ValueError, MemoryError) as error:  # no message may end the node
            self._refused += 1
            reason = shown(error, 300) or "out of memory"
            self._log.warn(
                "batch",
                f"{self.topic}: batch {which} dropped: {reason} ({self._refused} dropped so far)",
            )
            if isinstance(error, MemoryError):
                self._forget()
                self.pull_again()
            return
        self.header = batch.header
        self.edits += 1
        self._applied = time.monotonic()
        if batch.operation == GaussianArray.REPLACE:
            self._announced, self._began = False, self._applied
        self._announced |= self.books.complete  # what is deleted later isn't missing
        if report["missed"]:
            self._log.warn(
                "gap",
                f"{self.topic}: missed {counted(report['missed'], 'batch', 'batches')} before "
                f"{which}; the map may be incomplete ({self.books.missed} missed so far)",
            )
        if report["dropped"]:
            self._dropped += report["dropped"]
            self._log.warn(
                "splats",
                f"{self.topic}: {counted(report['dropped'], 'splat', 'splats')} of batch "
                f"{batch.revision} dropped: a value is not finite, or a quaternion is zero, or a "
                f"scale negative ({self._dropped} dropped so far)",
            )
        self.applied(batch)

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

    def figures(self) -> dict[str, Any]:
        """Values of the map for /diagnostics, by the names that all nodes use. From any thread."""
        return {
            "Map": self.books.map_id,
            "Revision": self.books.revision,
            "Splats": self.books.splats,
            "Age (s)": round(time.monotonic() - self._applied, 3),
            "Backlog (bytes)": self._backlog,
            "Batches missed": self.books.missed,
            "Batches dropped": self._refused,
            "Splats dropped": self._dropped,
        }


class MapSubscriber(HeldMap):
    """Hears `gaussians`, and pulls missing batches."""

    def __init__(self, node: Node, target: Any, *, most_sh_degree: int = 3) -> None:
        """target: as of HeldMap. most_sh_degree: harmonics above it aren't pulled."""
        log = Throttled(node.get_logger())
        super().__init__(target, node.resolve_topic_name("gaussians"), log)
        self._node = node
        self.receiver = MapReceiver(
            node, self.add, busy=lambda: self.busy, most_sh_degree=most_sh_degree
        )
        self.pull_again = self.receiver.pull_again

    def turns(self, period: float = POLL) -> Iterator[None]:
        """Applies batches, and yields, until ROS ends: whenever something has come, and once in a
        period [s].
        """
        while self._node.context.ok():
            self.came.wait(period)
            self.came.clear()
            self.apply_waiting()
            yield
