"""How Python hears of a map."""

from __future__ import annotations

from collections.abc import Callable

from rclpy.callback_groups import CallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy
from rclpy.subscription import Subscription

from rosplat_msgs.msg import GaussianArray
from rosplat_sorter.qos import MAP, MAP_VOLATILE

WATCH_PERIOD = 1.0  # [s]


class MapSubscription:
    """Hears the publishers of a map's topic that keep their batches for who joins late.

    One that asks for such doesn't match a publisher that keeps none: where there is no other, it
    asks for less. It never hears one batch twice, which would take the map back to it.
    """

    def __init__(
        self,
        node: Node,
        on_batch: Callable[[GaussianArray], None],
        callback_group: CallbackGroup | None = None,
    ) -> None:
        """Subscribes to `gaussians`. A group for the callback must not be reentrant."""
        self._node, self._on_batch, self._group = node, on_batch, callback_group
        self.topic = node.resolve_topic_name("gaussians")
        self._qos = MAP
        self._mixed = False  # what publishers keep
        self._maps = ("", "")  # of the last batch, and the one before that
        self._subscription = self._subscribe()
        steady = Clock(clock_type=ClockType.STEADY_TIME)  # simulated time may stand still
        node.create_timer(WATCH_PERIOD, self._meet_publishers, callback_group, steady)

    def _subscribe(self) -> Subscription:
        return self._node.create_subscription(
            GaussianArray, "gaussians", self._hear, self._qos, callback_group=self._group
        )

    def _hear(self, message: GaussianArray) -> None:
        now, before = self._maps
        if message.map_id != now:
            self._maps = message.map_id, now
            if message.map_id == before and self._node.count_publishers(self.topic) > 1:
                self._node.get_logger().warning(
                    f"{self.topic}: publishers clear each other's map: end all but one of them",
                    throttle_duration_sec=5.0,
                )
        self._on_batch(message)

    def _meet_publishers(self) -> None:
        publishers = self._node.get_publishers_info_by_topic(self.topic)
        if not publishers:
            return
        durabilities = {publisher.qos_profile.durability for publisher in publishers}
        qos = MAP if DurabilityPolicy.TRANSIENT_LOCAL in durabilities else MAP_VOLATILE
        mixed = len(durabilities) > 1
        if mixed and not self._mixed:
            self._node.get_logger().warning(
                f"{self.topic}: a publisher is volatile beside one that is transient local, and "
                "isn't heard: end one of them, or make it transient local, too"
            )
        self._mixed = mixed
        if qos is not self._qos:
            self._qos = qos
            self._node.destroy_subscription(self._subscription)
            self._subscription = self._subscribe()
