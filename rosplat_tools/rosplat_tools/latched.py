"""Subscriptions that hear what was published once, before they began."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from rosplat_sorter.qos import overridable

WATCH_PERIOD = 1.0  # [s]


class LatchedSubscription:
    """Hears a topic, and what its publishers keep for late subscribers if all of them do.

    A transient local subscription doesn't hear a volatile publisher. So it becomes transient local,
    and hears the last message again, once publishers are known and all of them are.
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
        self._node, self._given, self._profile = node, (kind, topic, heard), profile
        self.topic = node.resolve_topic_name(topic)
        self._latched = False
        self._subscription = self._subscribe()
        steady = Clock(clock_type=ClockType.STEADY_TIME)  # simulated time may stand still
        node.create_timer(WATCH_PERIOD, self._meet_publishers, clock=steady)

    def _subscribe(self) -> Any:
        adapted = copy(self._profile)
        if self._latched:  # best effort hears nothing that was kept
            adapted.durability = DurabilityPolicy.TRANSIENT_LOCAL
            adapted.reliability = ReliabilityPolicy.RELIABLE
        return self._node.create_subscription(*self._given, **overridable(self._profile, adapted))

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
        if publishers and latched != self._latched:
            self._latched = latched
            self._node.destroy_subscription(self._subscription)
            self._subscription = self._subscribe()
