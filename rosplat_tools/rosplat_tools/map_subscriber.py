"""A map of rosplat_core that is kept as its topic has it."""

from __future__ import annotations

import time
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node
from std_msgs.msg import Header

from rosplat_core.log_text import shown
from rosplat_core.maps import Arrival, BatchError
from rosplat_msgs.msg import GaussianArray
from rosplat_sorter.batches import apply
from rosplat_sorter.map_subscription import MapSubscription

PATIENCE = 3.0  # how long a map that is sent anew is waited for [s]
TELL_EVERY = 5.0  # [s]


class MapSubscriber:
    """Hears `gaussians`, pulls what is missing, and applies all of it to a map.

    target: what has the `apply` and the books of a GaussianMap. Batches are applied in the node's
    callbacks, one at a time; what comes too fast for that is pulled later.
    """

    def __init__(
        self, node: Node, target: Any, callback_group: CallbackGroup | None = None
    ) -> None:
        self._node, self._target = node, target
        self._map_id = ""
        self._patient_until = 0.0
        self._told_of_missed = False
        self.header = Header()
        """Of the last batch that was applied."""
        self.edits = 0
        """Batches that were applied: the map is another one when it grows."""
        self.refused = 0
        """Batches that weren't, for they contradict themselves or need too much memory."""
        self._subscription = MapSubscription(node, self._take, callback_group)
        self.topic = self._subscription.topic

    @property
    def whole(self) -> bool:
        """Whether nothing of the map is known to be missing.

        A map that begins anew is whole when all that its publisher announced is there, or after
        three seconds; one that batches are missing of and nobody answers pulls of, when it is sent
        anew.
        """
        if not self.edits or self._target.pulled or self._subscription.pulling:
            return False
        if self._target.missed:
            if not self._told_of_missed:
                self._told_of_missed = True
                self._node.get_logger().warning(
                    f"{self.topic}: {self._target.missed} batches are missing, and nobody answers "
                    "pulls: waiting for the map to be sent anew"
                )
            return False
        self._told_of_missed = False
        return bool(self._target.complete) or time.monotonic() > self._patient_until

    def _take(self, batch: GaussianArray, arrival: Arrival) -> None:
        try:
            apply(self._target, batch, arrival)
        except (BatchError, MemoryError) as error:
            self.refused += 1
            self._node.get_logger().error(
                f"{self.topic}: batch {batch.revision} is refused, {self.refused} so far: "
                f"{shown(str(error) or 'not enough memory', 300)}",
                throttle_duration_sec=TELL_EVERY,
            )
            return
        if batch.operation == GaussianArray.REPLACE or batch.map_id != self._map_id:
            self._map_id = batch.map_id
            self._patient_until = time.monotonic() + PATIENCE
        self.header = batch.header
        self.edits += 1
