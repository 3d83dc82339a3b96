"""Subscriptions that hear what was published once, before they began."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from copy import copy
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from rosplat_ros.qos import overridable

WATCH_PERIOD = 1.0  # [s]
EARLY = 8  # messages that are remembered until publishers are known


class LatchedSubscription:
    """Hears a topic, and what its first publishers keep for late subscribers if all of them do.

    A transient local subscription doesn't hear a volatile publisher. So it becomes transient local
    once publishers are known and all of them are, and volatile for good once another one comes.
    """

    def __init__(
        self,
        node: Node,
        kind: type,
        topic: str,
        heard: Callable[[Any], None],
        profile: QoSProfile,
    ) -> None:
        """profile: of a volatile subscription; parameters override it."""
        self._node, self._given, self._profile = node, (kind, topic), profile
        self._heard = heard
        self.topic = node.resolve_topic_name(topic)
        self._latched: bool | None = None  # no publisher is known yet
        self._early: deque[Any] = deque(maxlen=EARLY)  # heard until then; some come again
        self._subscription = self._subscribe()
        steady = Clock(clock_type=ClockType.STEADY_TIME)  # simulated time may stand still
        node.create_timer(WATCH_PERIOD, self._meet_publishers, clock=steady)

    def _subscribe(self) -> Any:
        adapted = copy(self._profile)
        if self._latched:  # best effort hears nothing that was kept
            adapted.durability = DurabilityPolicy.TRANSIENT_LOCAL
            adapted.reliability = ReliabilityPolicy.RELIABLE
        return self._node.create_subscription(
            *self._given, self._hear, **overridable(self._profile, adapted)
        )

    def _hear(self, message: Any) -> None:
        if self._latched is None:
            self._early.append(message)
        elif message in self._early:
            return
        else:
            self._early.clear()
        self._heard(message)

    def _meet_publishers(self) -> None:
        publishers = [
            publisher.qos_profile
            for publisher in self._node.get_publishers_info_by_topic(self.topic)
        ]
        latched = all(
            qos.durability == DurabilityPolicy.TRANSIENT_LOCAL
            and qos.reliability == ReliabilityPolicy.RELIABLE
            for qos in publishers
        )
        if not publishers or self._latched is False:
            return
        changes = latched != bool(self._latched)
        self._latched = latched
        if changes:
            self._node.destroy_subscription(self._subscription)
            self._subscription = self._subscribe()
