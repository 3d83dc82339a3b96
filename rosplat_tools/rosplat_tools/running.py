"""How the package's nodes begin and end: quietly by a signal, with one line by a user's mistake."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from threading import Event

import rclpy
from rclpy.executors import MultiThreadedExecutor, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from rosplat_tools.splats import SceneError


class Cancelled(Exception):
    """What a progress callback raises to end the work."""


def run(program: str, body: Callable[[], None]) -> None:
    """Runs body with ROS set up until it returns, or SIGINT or SIGTERM interrupts it.

    A SceneError or RuntimeError ends the program with its text and exit code 1.
    """
    # rclpy's own handlers shut ROS down under code that is just using it.
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.default_int_handler)
    try:
        body()
    except (KeyboardInterrupt, Cancelled):
        pass
    except (SceneError, RuntimeError) as error:
        print(f"{program}: {error}", file=sys.stderr)
        sys.exit(1)
    finally:
        rclpy.try_shutdown()


@contextmanager
def spinning(node: Node, threads: int = 1) -> Iterator[Future[None]]:
    """Runs a node's callbacks in threads of their own while the block runs, then destroys it.

    Gives what is done when the node can't go on.
    """
    executor = MultiThreadedExecutor(threads) if threads > 1 else SingleThreadedExecutor()
    executor.add_node(node)
    ending = Event()

    def spin() -> None:
        # Not executor.spin: only the end of ROS ends that, in the middle of a callback.
        while not ending.is_set():
            executor.spin_once(0.1)

    try:
        with ThreadPoolExecutor(1) as pool:
            try:
                yield pool.submit(spin)
            finally:
                ending.set()
    finally:
        node.context.try_shutdown()  # long work in other threads sees that, and gives up
        executor.shutdown()
        node.destroy_node()


def wait_for_end(spin: Future[None]) -> None:
    """Until a signal comes, or the node of `spinning` fails: then raises what it raised."""
    while not spin.done():
        wait([spin], 0.2)  # in short turns: a signal is only seen between them
    spin.result()
