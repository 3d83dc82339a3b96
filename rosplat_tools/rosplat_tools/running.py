"""How the package's nodes begin and end: quietly by a signal, with one line by a user's mistake."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import contextmanager

import rclpy
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor
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
def spinning(node: Node, threads: int = 2) -> Iterator[Future[None]]:
    """Runs a node's callbacks in threads of their own while the block runs, then destroys it.

    Gives what is done when the node can't go on.
    """
    executor = MultiThreadedExecutor(num_threads=threads)
    executor.add_node(node)

    def spin() -> None:
        try:
            executor.spin()
        except ExternalShutdownException:
            pass
        except Exception:
            if node.context.ok():  # else it was told to end in the middle of a message
                raise

    with ThreadPoolExecutor(1) as pool:
        try:
            yield pool.submit(spin)
        finally:
            node.context.try_shutdown()
    node.destroy_node()


def wait_for_end(spin: Future[None]) -> None:
    """Until a signal comes, or the node of `spinning` fails: then raises what it raised."""
    while not spin.done():
        wait([spin], 0.2)  # in short turns: a signal is only seen between them
    spin.result()
