"""A subscription to a map, with pulls of what it lacks."""

from __future__ import annotations

import time
from collections.abc import Callable
from threading import RLock
from typing import Any

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.client import Client
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from rclpy.task import Future

from rosplat_core.log_text import shown
from rosplat_core.maps import Arrival, MapPull, MapQos, choose_map_qos
from rosplat_core.splats import check_kind
from rosplat_msgs.msg import GaussianArray
from rosplat_msgs.srv import PullMap
from rosplat_ros.batches import array_bytes
from rosplat_ros.own_node import node_of_its_own
from rosplat_ros.program.mistakes import type_name
from rosplat_ros.qos import MAP, overridable

WATCH_PERIOD = 1.0  # [s]
PULL_PERIOD = 0.1  # [s]


class MapReceiver:
    """Hears the publishers of a map's topic, and pulls what is missing from their servers.

    The subscription asks for what `choose_map_qos` says of the publishers, and begins anew when
    that changes. `MapPull` tells batches that come again from a map that is played again, and when
    nothing reaches this process: the receiver then joins the network anew, by a participant of its
    own.
    """

    def __init__(
        self,
        node: Node,
        on_batch: Callable[[GaussianArray, Arrival], None],
        *,
        busy: Callable[[], bool] = lambda: False,
        most_sh_degree: int = 3,
    ) -> None:
        """Subscribes to `gaussians`. on_batch is called for one batch at a time, whatever threads
        the node has.

        busy: whether there is no room for batches. Those that can be pulled later are dropped then,
        but for a REPLACE; others wait in the middleware. most_sh_degree: pulled batches have no
        harmonics above this degree.
        """
        check_kind(node, Node, "node")
        self._node, self._on_batch, self._busy = node, on_batch, busy
        self._most_sh_degree = most_sh_degree
        self._name = "gaussians"  # of the topic for the node, which may remap it
        self.topic = node.resolve_topic_name(self._name)
        self._unheard: set[str] = set()  # policies that keep a publisher from being heard
        self._maps = ("", "")  # the last batch's map_id, and the other one before that
        self._pull = MapPull()
        self._lock = RLock()  # answers to requests come outside of the callback groups
        self._served = False  # pulls are, or were while there were publishers
        self._asked: dict[int, Future] = {}  # answers to come, by the number of the request
        self._qos: MapQos | None = None
        self._subscription: Subscription | None = None
        self._listen()

    @property
    def pulling(self) -> bool:
        """Whether a part of the map is missing and being pulled."""
        return self._pull.pulling

    def pull_again(self) -> None:
        """Tells that there was no memory for a batch, and that those after it weren't applied: all
        of the map is pulled again after a while.
        """
        with self._lock:
            self._pull.restart(time.monotonic())

    def _listen(self) -> None:
        group = MutuallyExclusiveCallbackGroup()
        self._client: Client = self._node.create_client(
            PullMap, f"{self.topic}/pull", callback_group=group
        )
        self._adapt_to_publishers()
        steady = Clock(clock_type=ClockType.STEADY_TIME)  # simulated time may stand still
        self._timers = [
            self._node.create_timer(period, act, group, steady)
            for period, act in (
                (WATCH_PERIOD, self._adapt_to_publishers),
                (PULL_PERIOD, self._tick),
            )
        ]

    def _join_anew(self) -> None:
        """Listens by a participant of its own from now on, in a thread of its own."""
        node = self._node
        node.get_logger().warning(
            f"{self.topic}: a publisher is there, and nothing of it arrives: joining anew"
        )
        for timer in self._timers:
            node.destroy_timer(timer)
        node.destroy_client(self._client)
        if self._subscription:
            node.destroy_subscription(self._subscription)
        self._asked, self._qos, self._subscription = {}, None, None
        self._node, self._name = node_of_its_own(node), self.topic  # remaps nothing
        self._listen()

    def _subscribe(self, chosen: MapQos) -> None:
        """Subscribes, or subscribes anew."""
        self._qos = reliable, transient_local, depth = chosen
        qos = QoSProfile(
            reliability=_RELIABILITY[reliable],
            durability=_DURABILITY[transient_local],
            history=HistoryPolicy.KEEP_LAST,
            depth=depth,
        )
        if self._subscription:
            self._node.destroy_subscription(self._subscription)
        self._pull.subscribed_anew(time.monotonic())
        self._subscription = self._node.create_subscription(
            GaussianArray,
            self._name,
            self._on_message,
            callback_group=_Gate(lambda: self._busy() and not self._is_served()),
            **overridable(MAP, qos),
        )

    def _on_message(self, message: GaussianArray) -> None:
        newest, before = self._maps
        if message.map_id != newest:
            self._maps = message.map_id, newest
            if message.map_id == before and self._node.count_publishers(self.topic) > 1:
                self._node.get_logger().warning(
                    f"{self.topic}: publishers clear each other's map: end all but one of them",
                    throttle_duration_sec=5.0,
                )
        with self._lock:
            self._pull.held = self._busy()
            served, now = self._is_served(), time.monotonic()
            replaces = message.operation == GaussianArray.REPLACE  # drops all that waits
            if self._pull.held and served and not replaces:
                self._pull.miss(labelled(message), now)
            else:
                self._carry_out(self._pull.receive(labelled(message), now, served))

    def _tick(self) -> None:
        with self._lock:
            self._pull.held = self._busy()
            self._carry_out(self._pull.tick(time.monotonic(), self._is_served()))

    def _is_served(self) -> bool:
        return bool(self._client.service_is_ready())

    def _carry_out(self, step: tuple[Any, Any, bool, bool]) -> None:
        batches, request, subscribe_anew, join_anew = step
        if join_anew:
            self._join_anew()
        if request:  # first, so that it is answered meanwhile
            self._send(*request)
        for batch, arrival in batches:
            self._on_batch(batch, arrival)
        if subscribe_anew and self._qos and self._qos[1]:  # it is transient local
            self._subscribe(self._qos)

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
        asked.add_done_callback(lambda answer: self._on_answer(number, sequence, answer))

    def _on_answer(self, number: int, sequence: int, answer: Future) -> None:
        response: PullMap.Response = answer.result()
        with self._lock:
            self._pull.held = self._busy()
            if self._asked.get(number) is not answer:
                return
            if not response.batches:  # no such map there: rclpy is made to take another's answer
                other = self._asked[number] = self._client._pending_requests[sequence] = Future()
                other.add_done_callback(lambda answer: self._on_answer(number, sequence, answer))
            batches = [labelled(message) for message in response.batches]
            now, served = time.monotonic(), self._is_served()
            self._carry_out(self._pull.answer(number, batches, response.next_block, now, served))

    def _adapt_to_publishers(self) -> None:
        known = self._node.get_publishers_info_by_topic(self.topic)
        ours = type_name(GaussianArray)
        offers = [_offer(each.qos_profile) for each in known if each.topic_type == ours]
        self._served = self._is_served() or (self._served and bool(offers))
        qos, best_effort, volatile = choose_map_qos(_MAP, offers, self._served)
        for policy, unheard, better in (
            ("best effort", best_effort, "reliable"),
            ("volatile", volatile, "transient local"),
        ):
            if unheard and policy not in self._unheard:
                self._node.get_logger().warning(
                    f"{self.topic}: a publisher is {policy} beside one that is {better}, and isn't "
                    f"heard: end one of them, or make it {better}, too"
                )
            (self._unheard.add if unheard else self._unheard.discard)(policy)
        if qos != self._qos:
            with self._lock:
                self._subscribe(qos)


class _Gate(MutuallyExclusiveCallbackGroup):
    """Leaves a subscription's messages in the middleware while it is closed."""

    def __init__(self, closed: Callable[[], bool]) -> None:
        super().__init__()
        self._closed = closed

    def can_execute(self, entity: Any) -> bool:
        return not self._closed() and bool(super().can_execute(entity))


_RELIABILITY = {True: ReliabilityPolicy.RELIABLE, False: ReliabilityPolicy.BEST_EFFORT}
_DURABILITY = {True: DurabilityPolicy.TRANSIENT_LOCAL, False: DurabilityPolicy.VOLATILE}


def _offer(qos: QoSProfile) -> tuple[bool, bool, int]:
    """A QoS as `choose_map_qos` takes it: reliable, transient local, depth."""
    reliable = qos.reliability == ReliabilityPolicy.RELIABLE
    return reliable, qos.durability == DurabilityPolicy.TRANSIENT_LOCAL, qos.depth


_MAP = _offer(MAP)


def labelled(message: GaussianArray) -> tuple[str, int, bool, int, GaussianArray]:
    """A batch as MapPull takes it: map, revision, whether it replaces, bytes, the batch."""
    replaces = message.operation == GaussianArray.REPLACE
    size = array_bytes(message) + 1000  # with the rest of the message
    return message.map_id, message.revision, replaces, size, message
