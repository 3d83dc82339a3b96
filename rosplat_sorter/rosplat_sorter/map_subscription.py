"""How Python hears of a map."""

from __future__ import annotations

import time
from collections.abc import Callable
from threading import RLock
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.node import Node, NodeNameNonExistentError
from rclpy.qos import DurabilityPolicy
from rclpy.subscription import Subscription
from rclpy.task import Future

from rosplat_core.log_text import shown
from rosplat_msgs.msg import GaussianArray
from rosplat_msgs.srv import PullMap
from rosplat_sorter.edits import array_bytes
from rosplat_sorter.map_pull import Arrival, Label, MapPull, Request, Step
from rosplat_sorter.qos import MAP, MAP_VOLATILE, SERVED_MAP

WATCH_PERIOD = 1.0  # [s]
PULL_PERIOD = 0.1  # [s]


class MapSubscription:
    """Hears the publishers of a map's topic, and pulls what is missing from who serves that.

    A subscription that asks for what was sent before doesn't match a publisher that keeps nothing:
    where there is no other, it asks for less; and so it does where pulls are known to be served
    when it begins. It never hears one batch twice, which would take the map back to it.
    """

    def __init__(
        self,
        node: Node,
        on_batch: Callable[[Any, Arrival], None],
        callback_group: CallbackGroup | None = None,
        *,
        keep: Callable[[GaussianArray], tuple[Any, int]] = lambda m: (m, array_bytes(m)),
        busy: Callable[[], bool] = lambda: False,
    ) -> None:
        """Subscribes to `gaussians`. on_batch is called for one batch at a time, whatever threads
        the node has.

        keep: what on_batch wants of a message, and the memory that it takes [bytes]; by default all
        of it. busy: whether there is no room for batches: they are dropped then, and pulled later.
        """
        self._node, self._on_batch, self._group = node, on_batch, callback_group
        self._keep, self._busy = keep, busy
        self.topic = node.resolve_topic_name("gaussians")
        self.complete = 0
        """The last revision of which on_batch was handed all; what came since is of later ones."""
        self._mixed = False  # what publishers keep
        self._maps = ("", "")  # of the last batch, and the one before that
        self._pull: MapPull[Any] = MapPull()
        self._lock = RLock()  # the answers to requests come outside of the group
        self._qos = SERVED_MAP if self._server_is_known() else MAP
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
            self._pull.held = self._busy()
            if self._pull.held:
                self._pull.miss(label(message))
            else:
                batch = self._batch(message)
                self._do(self._pull.hear(*batch, time.monotonic(), self._served()))

    def _tick(self) -> None:
        with self._lock:
            self._pull.held = self._busy()
            self._do(self._pull.tick(time.monotonic(), self._served()))

    def _batch(self, message: GaussianArray) -> tuple[Label, Any]:
        batch, size = self._keep(message)
        return label(message, size), batch

    def _served(self) -> bool:
        return bool(self._client.service_is_ready())

    def _server_is_known(self) -> bool:
        """Whether some node serves pulls, ready or not. A service that has clients alone is listed,
        too, but by no node.
        """
        for node, namespace in self._node.get_node_names_and_namespaces():
            try:
                services = self._node.get_service_names_and_types_by_node(node, namespace)
            except NodeNameNonExistentError:  # it has just ended
                continue
            if any(name == f"{self.topic}/pull" for name, _ in services):
                return True
        return False

    def _do(self, step: Step[Any]) -> None:
        if step.request:  # first, so that it is answered meanwhile
            self._send(step.request)
        self.complete = min(self.complete, self._pull.complete)
        for batch, arrival in step.batches:
            self._on_batch(batch, arrival)
        self.complete = self._pull.complete

    def _send(self, request: Request) -> None:
        if not request.first_block:
            missing = f"what map '{shown(request.map_id)}' has since {request.after_revision}"
            self._node.get_logger().info(
                f"{self.topic}: {missing if request.map_id else 'the map'} is pulled",
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
        pending = self._client._pending_requests  # all that tells of the number that ROS gave it
        sequence = next((key for key, asked in pending.items() if asked is self._answer), 0)
        self._answer.add_done_callback(lambda answer: self._take(request.number, sequence, answer))

    def _take(self, number: int, sequence: int, answer: Future) -> None:
        response: PullMap.Response = answer.result()
        with self._lock:
            self._pull.held = self._busy()
            if answer is not self._answer:
                return
            if not response.batches:  # rclpy takes the first answer for the only one
                self._answer = self._client._pending_requests[sequence] = Future()
                self._answer.add_done_callback(lambda other: self._take(number, sequence, other))
            batches = [self._batch(message) for message in response.batches]
            now, served = time.monotonic(), self._served()
            self._do(self._pull.answer(number, batches, response.next_block, now, served))

    def _meet_publishers(self) -> None:
        publishers = self._node.get_publishers_info_by_topic(self.topic)
        if not publishers:
            return
        durabilities = {publisher.qos_profile.durability for publisher in publishers}
        qos = MAP if DurabilityPolicy.TRANSIENT_LOCAL in durabilities else MAP_VOLATILE
        mixed = len(durabilities) > 1
        if self._qos is SERVED_MAP and self._server_is_known():
            return  # it hears all of them
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


def label(message: GaussianArray, size: int = 0) -> Label:
    """What counts of a batch where others may be missing. size: of its arrays. [bytes]"""
    replaces = message.operation == GaussianArray.REPLACE
    return Label(message.map_id, message.revision, replaces, size + 1000)  # and the rest of it
