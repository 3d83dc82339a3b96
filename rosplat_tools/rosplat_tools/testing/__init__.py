"""For tests of what hears or sends maps: a ROS node, what a map's topic adds up to.

A conftest.py names it: `pytest_plugins = ["rosplat_tools.testing"]`.
"""

from __future__ import annotations

import contextlib
import signal
import subprocess
import sys
import time
import uuid
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from rosplat_core.maps import Arrival
from rosplat_msgs.msg import GaussianArray
from rosplat_sorter.map_subscription import MapSubscription
from rosplat_tools.testing.slot_map import SlotMap, apply

PATIENCE = 180.0  # with programs, however busy the machine is [s]


@pytest.fixture
def node() -> Iterator[Node]:
    """A node in a context and a namespace of its own, where no other test is heard."""
    context = rclpy.Context()
    rclpy.init(context=context)
    made = rclpy.create_node("test", namespace=f"/test_{uuid.uuid4().hex}", context=context)
    yield made
    made.destroy_node()
    context.try_shutdown()


@pytest.fixture
def start(node: Node) -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """Starts a program of rosplat_tools, or package.module, in the namespace of `node`."""
    started: list[subprocess.Popen[str]] = []

    def start(program: str, **parameters: object) -> subprocess.Popen[str]:
        arguments = ["--ros-args", "-r", f"__ns:={node.get_namespace()}"]
        for name, value in parameters.items():
            arguments += ["-p", f"{name}:={value}"]
        module, main = (program, "main") if "." in program else ("rosplat_tools.commands", program)
        process = subprocess.Popen(
            [sys.executable, "-c", f"from {module} import {main}; exit({main}())", *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
        )
        started.append(process)
        return process

    yield start
    for process in started:
        process.send_signal(signal.SIGINT)
        try:
            process.communicate(timeout=PATIENCE)
        except subprocess.TimeoutExpired:
            process.kill()
            raise


class Listener:
    """What a map's topic adds up to, as seen by `node`."""

    def __init__(self, node: Node) -> None:
        self.batches: list[GaussianArray] = []
        self.map: SlotMap | None = None
        self._node = node
        self._clients: dict[str, Any] = {}
        self._executor = SingleThreadedExecutor(context=node.context)
        self._executor.add_node(node)
        MapSubscription(node, self._receive)

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


@pytest.fixture
def listener(node: Node) -> Listener:
    return Listener(node)
