"""A subscription to a map, with pulls of what it lacks."""

from __future__ import annotations

import time
from collections.abc import Callable
from copy import copy
from enum import Enum
from threading import RLock
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.client import Client
from rclpy.clock import Clock, ClockType
from rclpy.node import Node, NodeNameNonExistentError
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from rclpy.task import Future

from rosplat_core.log_text import shown
from rosplat_core.maps import Arrival, MapPull
from rosplat_msgs.msg import GaussianArray
from rosplat_msgs.srv import PullMap
from rosplat_ros.batches import array_bytes
from rosplat_ros.program.mistakes import type_name
from rosplat_ros.qos import MAP, SERVED_MAP, overridable

WATCH_PERIOD = 1.0  # [s]
PULL_PERIOD = 0.1  # [s]


class MapReceiver:
    """Hears the publishers of a map's topic, and pulls what is missing from their servers.

    A transient local subscription doesn't match a volatile publisher, nor a reliable one a best
    effort publisher. So the subscription asks for less where all publishers offer less, or where
    pulls are known to be served when it begins. It never hears a batch twice, which would take the
    map back to that batch.
    """

    def __init__(
        self,
        node: Node,
        on_batch: Callable[[GaussianArray, Arrival], None],
        callback_group: CallbackGroup | None = None,
        *,
        busy: Callable[[], bool] = lambda: False,
        most_sh_degree: int = 3,
    ) -> None:
        """Subscribes to `gaussians`. on_batch is called for one batch at a time, whatever threads
        the node has.

        busy: whether there is no room for batches. They are dropped then, and pulled later.
        most_sh_degree: pulled batches have no harmonics above this degree.
        """
        self._node, self._on_batch, self._group, self._busy = node, on_batch, callback_group, busy
        self._most_sh_degree = most_sh_degree
        self.topic = node.resolve_topic_name("gaussians")
        self._mixed: set[str] = set()  # policies in which publishers differ
        self._maps = ("", "")  # the last batch's map_id, and the other one before that
        self._pull = MapPull()
        self._lock = RLock()  # answers to requests come outside of the callback group
        self._pulls = self._server_is_known()  # whether it has been since the beginning
        self._qos = self._qos_for(self._publishers())
        self._client: Client = node.create_client(
            PullMap, f"{self.topic}/pull", callback_group=callback_group
        )
        self._asked: dict[int, Future] = {}  # answers to come, by the number of the request
        self._subscription = self._subscribe()
        steady = Clock(clock_type=ClockType.STEADY_TIME)  # simulated time may stand still
        node.create_timer(WATCH_PERIOD, self._meet_publishers, callback_group, steady)
        node.create_timer(PULL_PERIOD, self._tick, callback_group, steady)

    @property
    def pulling(self) -> bool:
        """Whether a part of the map is missing and being pulled."""
        return self._pull.pulling

    def lose(self) -> None:
        """Tells that there was no memory for a batch, and that those after it weren't applied: all
        of the map is pulled again after a while.
        """
        with self._lock:
            self._pull.lose(time.monotonic())

    def _subscribe(self) -> Subscription:
        return self._node.create_subscription(
            GaussianArray,
            "gaussians",
            self._hear,
            callback_group=self._group,
            **overridable(MAP, self._qos),
        )

    def _publishers(self) -> list[QoSProfile]:
        """The QoS that the topic's publishers of GaussianArray offer."""
        known = self._node.get_publishers_info_by_topic(self.topic)
        ours = type_name(GaussianArray)
        return [publisher.qos_profile for publisher in known if publisher.topic_type == ours]

    def _qos_for(self, publishers: list[QoSProfile]) -> QoSProfile:
        qos = copy(SERVED_MAP if self._pulls else MAP)
        if publishers and all(p.durability != qos.durability for p in publishers):
            qos.durability = DurabilityPolicy.VOLATILE
        if publishers and all(p.reliability != qos.reliability for p in publishers):
            qos.reliability = ReliabilityPolicy.BEST_EFFORT
        return qos

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
                self._pull.miss(labelled(message))
            else:
                self._do(self._pull.hear(labelled(message), time.monotonic(), self._served()))

    def _tick(self) -> None:
        with self._lock:
            self._pull.held = self._busy()
            self._do(self._pull.tick(time.monotonic(), self._served()))

    def _served(self) -> bool:
        return bool(self._client.service_is_ready())

    def _server_is_known(self) -> bool:
        """Whether some node serves pulls, ready or not. (The graph's list of all services would
        also have a service with clients alone.)
        """
        for node, namespace in self._node.get_node_names_and_namespaces():
            try:
                services = self._node.get_service_names_and_types_by_node(node, namespace)
            except NodeNameNonExistentError:  # it has just ended
                continue
            if any(name == f"{self.topic}/pull" for name, _ in services):
                return True
        return False

    def _do(self, step: tuple[Any, Any]) -> None:
        batches, request = step
        if request:  # first, so that it is answered meanwhile
            self._send(*request)
        for batch, arrival in batches:
            self._on_batch(batch, arrival)

    def _send(self, number: int, map_id: str, after_revision: int, first_block: int) -> None:
        if self._pull.pulling and not first_block:
            what = f"map '{shown(map_id)}' after revision {after_revision}" if map_id else "the map"
            self._node.get_logger().info(
                f"{self.topic}: pulling {what}",
                throttle_duration_sec=5.0,
            )
        for old in [old for old in self._asked if not self._pull.awaits(old)]:
            self._client.remove_pending_request(self._asked.pop(old))
        asked = self._asked[number] = self._client.call_async(
            PullMap.Request(
                map_id=map_id,
                after_revision=after_revision,
                first_block=first_block,
                most_sh_degree=self._most_sh_degree,
            )
        )
        pending = self._client._pending_requests  # only this has the request's number in ROS
        sequence = next((key for key, future in pending.items() if future is asked), 0)
        asked.add_done_callback(lambda answer: self._take(number, sequence, answer))

    def _take(self, number: int, sequence: int, answer: Future) -> None:
        response: PullMap.Response = answer.result()
        with self._lock:
            self._pull.held = self._busy()
            if self._asked.get(number) is not answer:
                return
            if not response.batches:  # no such map there: rclpy is made to take another's answer
                other = self._asked[number] = self._client._pending_requests[sequence] = Future()
                other.add_done_callback(lambda answer: self._take(number, sequence, answer))
            batches = [labelled(message) for message in response.batches]
            now, served = time.monotonic(), self._served()
            self._do(self._pull.answer(number, batches, response.next_block, now, served))

    def _meet_publishers(self) -> None:
        publishers = self._publishers()
        if not publishers:
            return
        self._pulls = self._pulls and self._server_is_known()
        qos = self._qos_for(publishers)
        for policy in ("durability", "reliability"):
            asked = getattr(qos, policy)
            others = {getattr(publisher, policy) for publisher in publishers} - {asked}
            if others and asked in (DurabilityPolicy.TRANSIENT_LOCAL, ReliabilityPolicy.RELIABLE):
                if policy not in self._mixed:
                    self._warn_of_unheard(others.pop(), asked)
                self._mixed.add(policy)
            else:
                self._mixed.discard(policy)
        if qos != self._qos:
            self._qos = qos
            self._node.destroy_subscription(self._subscription)
            self._subscription = self._subscribe()

    def _warn_of_unheard(self, policy: Enum, asked: Enum) -> None:
        lesser, better = (each.name.lower().replace("_", " ") for each in (policy, asked))
        self._node.get_logger().warning(
            f"{self.topic}: a publisher is {lesser} beside one that is {better}, and isn't heard: "
            f"end one of them, or make it {better}, too"
        )


def labelled(message: GaussianArray) -> tuple[str, int, bool, int, GaussianArray]:
    """A batch as MapPull takes it: map, revision, whether it replaces, bytes, the batch."""
    replaces = message.operation == GaussianArray.REPLACE
    size = array_bytes(message) + 1000  # with the rest of the message
    return message.map_id, message.revision, replaces, size, message
