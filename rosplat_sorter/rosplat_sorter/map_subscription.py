"""How Python hears of a map."""

from __future__ import annotations

import time
from collections.abc import Callable
from threading import RLock

from rclpy.callback_groups import CallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy
from rclpy.subscription import Subscription
from rclpy.task import Future

from rosplat_msgs.msg import GaussianArray
from rosplat_msgs.srv import PullMap
from rosplat_sorter.edits import array_bytes
from rosplat_sorter.log_text import shown
from rosplat_sorter.map_pull import Arrival, Label, MapPull, Request, Step
from rosplat_sorter.qos import MAP, MAP_VOLATILE

WATCH_PERIOD = 1.0  # [s]
PULL_PERIOD = 0.1  # [s]


class MapSubscription:
    """Hears the publishers of a map's topic, and pulls what is missing from who serves that.

    A subscription that asks for what was sent before doesn't match a publisher that keeps nothing:
    where there is no other, it asks for less. It never hears one batch twice, which would take the
    map back to it.
    """

    def __init__(
        self,
        node: Node,
        on_batch: Callable[[GaussianArray, Arrival], None],
        callback_group: CallbackGroup | None = None,
    ) -> None:
        """Subscribes to `gaussians`. on_batch is called for one batch at a time, whatever threads
        the node has.
        """
        self._node, self._on_batch, self._group = node, on_batch, callback_group
        self.topic = node.resolve_topic_name("gaussians")
        self._qos = MAP
        self._mixed = False  # what publishers keep
        self._maps = ("", "")  # of the last batch, and the one before that
        self._pull: MapPull[GaussianArray] = MapPull()
        self._lock = RLock()  # the answers to requests come outside of the group
        self._client = node.create_client(
            PullMap, f"{self.topic}/pull", callback_group=callback_group
        )
        self._answer: Future | None = None  # that is waited for
        self._subscription = self._subscribe()
        steady = Clock(clock_type=ClockType.STEADY_TIME)  # simulated time may stand still
        node.create_timer(WATCH_PERIOD, self._meet_publishers, callback_group, steady)
        node.create_timer(PULL_PERIOD, self._tick, callback_group, steady)

    @property
    def pulling(self) -> bool:
        """Whether a part of the map is missing that is on its way."""
        return self._pull.pulling

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
        with self._lock:
            self._do(self._pull.hear(label(message), message, time.monotonic(), self._served()))

    def _tick(self) -> None:
        with self._lock:
            self._do(self._pull.tick(time.monotonic(), self._served()))

    def _served(self) -> bool:
        return bool(self._client.service_is_ready())

    def _do(self, step: Step[GaussianArray]) -> None:
        if step.request:  # first, so that it is answered meanwhile
            self._send(step.request)
        for message, arrival in step.batches:
            self._on_batch(message, arrival)

    def _send(self, request: Request) -> None:
        if not request.first_block:
            self._node.get_logger().info(
                f"{self.topic}: what is missing of map '{shown(request.map_id)}' after revision "
                f"{request.after_revision} is pulled",
                throttle_duration_sec=5.0,
            )
        if self._answer:  # it has come, or doesn't count any more
            self._client.remove_pending_request(self._answer)
        self._answer = self._client.call_async(
            PullMap.Request(
                map_id=request.map_id,
                after_revision=request.after_revision,
                first_block=request.first_block,
            )
        )
        self._answer.add_done_callback(lambda answer: self._take(request.number, answer))

    def _take(self, number: int, answer: Future) -> None:
        response: PullMap.Response = answer.result()
        batches = [(label(message), message) for message in response.batches]
        with self._lock:
            now, served = time.monotonic(), self._served()
            self._do(self._pull.answer(number, batches, response.next_block, now, served))

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


def label(message: GaussianArray) -> Label:
    """What counts of a batch where others may be missing."""
    return Label(
        message.map_id,
        message.revision,
        message.operation == GaussianArray.REPLACE,
        array_bytes(message) + 1000,  # and the rest of it
    )
