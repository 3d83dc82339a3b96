"""Answers a map's services, though nobody spins its author's node."""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.exceptions import InvalidHandle
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node

PATIENCE = 5.0  # for the thread to end [s]
LOOK = 0.5  # from one look at the author's node to the next [s]


class ServiceThread:
    """Answers a service in a thread of its own, until it is closed, or its node or ROS ends.

    rclpy's executors take whole nodes, so the thread has a hidden node beside the author's.
    """

    def __init__(self, node: Node, kind: type, name: str, serve: Callable[[Any, Any], Any]) -> None:
        self.node = rclpy.create_node(
            f"_{node.get_name()}{name.replace('/', '_')}",
            namespace=node.get_namespace(),
            context=node.context,
            use_global_arguments=False,  # these would rename it, too
            start_parameter_services=False,
            enable_rosout=False,
        )
        self.node.create_service(kind, name, serve)
        self._author = node
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.node.create_timer(LOOK, self._end_with_author, clock=steady)
        self._executor = SingleThreadedExecutor(context=node.context)
        self._executor.add_node(self.node)
        self._ended = threading.Event()
        self._ending = self.node.create_guard_condition(self._ended.set)
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    def start(self) -> None:
        """Begins to answer."""
        self._thread.start()

    def _end_with_author(self) -> None:
        try:
            self._author.get_name()
        except InvalidHandle:  # its node was destroyed
            self._ended.set()

    def _run(self) -> None:
        try:
            # spin_until_future_complete would keep a function for each callback that it ever ran.
            while self.node.context.ok() and not self._ended.is_set():
                self._executor.spin_once()
        except ExternalShutdownException:
            pass
        except InvalidHandle:
            if self.node.context.ok():  # else the node ended with ROS, as it does since Kilted
                raise
        finally:
            self._executor.shutdown()
            self.node.destroy_node()

    def close(self) -> None:
        """Ends the service after the current answer."""
        with suppress(InvalidHandle):  # the thread has ended, or ends with ROS
            self._ending.trigger()
        if self._thread.is_alive() and self._thread is not threading.current_thread():
            self._thread.join(PATIENCE)
