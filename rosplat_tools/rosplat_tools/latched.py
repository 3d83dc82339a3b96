"""Subscriptions to somebody else's topic: the publishers decide the QoS."""

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
    """Hears all publishers of a topic, and what its first publishers keep for late subscribers if
    all of them do.

    A subscription hears only publishers that offer what it asks for. So it is reliable while all of
    them are, and best effort else. It becomes transient local once publishers are known and all of
    them are, and volatile for good once another one comes.
    """

    def __init__(
        self,
        node: Node,
        kind: type,
        topic: str,
        heard: Callable[[Any], None],
        profile: QoSProfile,
    ) -> None:
        """profile: of the subscription until publishers are known; parameters override it."""
        self._node, self._given, self._profile = node, (kind, topic), profile
        self._heard = heard
        self.topic = node.resolve_topic_name(topic)
        # Whether the publishers are latched, and reliable; None: no publisher is known yet.
        self._offered: tuple[bool, bool] | None = None
        self._early: deque[Any] = deque(maxlen=EARLY)  # heard until then; some come again
        self._subscription = self._subscribe()
        steady = Clock(clock_type=ClockType.STEADY_TIME)  # simulated time may stand still
        self._timer = node.create_timer(WATCH_PERIOD, self._adapt_to_publishers, clock=steady)

    def close(self) -> None:
        """Hears no more."""
        self._node.destroy_timer(self._timer)
        self._node.destroy_subscription(self._subscription)

    def _subscribe(self) -> Any:
        adapted = copy(self._profile)
        if self._offered:
            latched, reliable = self._offered
            if latched:
                adapted.durability = DurabilityPolicy.TRANSIENT_LOCAL
            adapted.reliability = (
                ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT
            )
        return self._node.create_subscription(
            *self._given, self._on_message, **overridable(self._profile, adapted)
        )

    def _on_message(self, message: Any) -> None:
        if self._offered is None:
            self._early.append(message)
        elif message in self._early:
            return
        else:
            self._early.clear()
        self._heard(message)

    def _adapt_to_publishers(self) -> None:
        publishers = self._node.get_publishers_info_by_topic(self.topic)
        if not publishers:
            return
        offers = zip(*(_offer(publisher.qos_profile) for publisher in publishers), strict=True)
        latched, reliable = map(all, offers)
        latched &= reliable  # best effort hears nothing that was kept
        if self._offered and not self._offered[0]:
            latched = False
        before, self._offered = self._offered, (latched, reliable)
        asked = _offer(self._subscription.qos_profile)  # as parameters may have it
        if self._offered not in (before, asked):
            self._node.destroy_subscription(self._subscription)
            self._subscription = self._subscribe()


def _offer(qos: QoSProfile) -> tuple[bool, bool]:
    """Whether a QoS is latched, and reliable."""
    return (
        qos.durability == DurabilityPolicy.TRANSIENT_LOCAL,
        qos.reliability == ReliabilityPolicy.RELIABLE,
    )
