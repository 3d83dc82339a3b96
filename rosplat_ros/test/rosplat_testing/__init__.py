"""For tests of what hears or sends maps: what a map's topic adds up to, in plain NumPy."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from typing import Any

from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from rosplat_core.maps import Arrival
from rosplat_msgs.msg import GaussianArray
from rosplat_ros.map_receiver import MapReceiver
from rosplat_testing.slot_map import SlotMap, apply

PATIENCE = 180.0  # with programs, however busy the machine is [s]


class Listener:
    """What a map's topic adds up to, as seen by `node`."""

    def __init__(self, node: Node) -> None:
        self.batches: list[GaussianArray] = []
        self.map: SlotMap | None = None
        self._node = node
        self._clients: dict[str, Any] = {}
        self._executor = SingleThreadedExecutor(context=node.context)
        self._executor.add_node(node)
        MapReceiver(node, self._receive)

    def _receive(self, batch: GaussianArray, _: Arrival) -> None:
        self.batches.append(batch)
        if self.map is None:
            assert batch.operation == batch.REPLACE
            self.map = SlotMap()
        with contextlib.suppress(ValueError):  # who refuses a batch keeps the map
            apply(batch, self.map)

    def wait(self, until: Callable[[], object], timeout: float = PATIENCE) -> None:
        """Receives until something holds; fails the test where it doesn't come to."""
        deadline = time.monotonic() + timeout
        while not until():
            assert time.monotonic() < deadline, "timed out"
            self._executor.spin_once(0.1)

    def spin_once(self) -> None:
        """Receives what comes next, if something does soon."""
        self._executor.spin_once(0.1)

    def wait_for(self, count: int) -> None:
        """Until the map holds exactly count splats."""
        self.wait(lambda: self.map is not None and len(self.map) == count)

    def request(self, kind: Any, name: str, **request: object) -> Any:
        """Calls a service in the node's namespace; returns the future of its answer."""
        # One for all calls: a server may not know a new client yet when it answers.
        if name not in self._clients:
            self._clients[name] = self._node.create_client(kind, name)
        client = self._clients[name]
        self.wait(client.service_is_ready)
        return client.call_async(kind.Request(**request))

    def call(self, kind: Any, name: str, **request: object) -> Any:
        """Calls a service and waits for its answer; once more where that got lost.

        A server that began just now may answer before it knows its client.
        """
        futures = [self.request(kind, name, **request)]
        patient_until = time.monotonic() + 20

        def answered() -> bool:
            if len(futures) == 1 and time.monotonic() > patient_until:
                futures.append(self.request(kind, name, **request))
            return any(future.done() for future in futures)

        self.wait(answered)
        return next(future.result() for future in futures if future.done())
