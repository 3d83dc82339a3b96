"""How the package's nodes begin and end: quietly by a signal, with one line by a user's mistake."""

from __future__ import annotations

import faulthandler
import math
import sys
import time
import traceback
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from threading import Event
from typing import TypeVar

import rclpy
from rclpy.exceptions import (
    InvalidHandle,
    InvalidParameterTypeException,
    InvalidParameterValueException,
)
from rclpy.executors import (
    Executor,
    ExternalShutdownException,
    MultiThreadedExecutor,
    SingleThreadedExecutor,
)
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from rosplat_core.program.output import told
from rosplat_core.splats import InputError
from rosplat_ros.program.arguments import take_ros_arguments_only
from rosplat_ros.program.memory import give_back_large_blocks
from rosplat_ros.program.middleware import prepare_fast_dds
from rosplat_ros.program.mistakes import Mistakes
from rosplat_ros.program.parameter_help import stop_if_asked
from rosplat_ros.program.processes import interrupt_by_signals, since_interrupt, uninterrupted

GRACE = 0.5  # time that callbacks get to end before ROS ends [s]
BREATH = 0.0002  # pause in which a thread can begin with a callback [s]
LAST = 5.0  # time that ROS gets to take a node down before the process is ended [s]
LOST = 3.0  # so long after a signal, its exception counts as lost [s]


AnyNode = TypeVar("AnyNode", bound=Node)


class Cancelled(Exception):
    """What a progress callback raises to end the work."""


def run(program: str, body: Callable[[], None], *, sends_maps: bool = True) -> None:
    """Runs body with ROS set up until it returns, or SIGINT or SIGTERM interrupts it.

    An InputError, RuntimeError, OSError or MemoryError ends the program by a line, with code 1, as
    does a parameter of a wrong type, even use_sim_time, which rclpy reads. sends_maps: as of
    prepare_fast_dds.
    """
    _run(program, body, body.__module__, sends_maps=sends_maps)


def run_node(
    program: str,
    make: Callable[[], AnyNode],
    work: Callable[[AnyNode], None] | None = None,
    threads: int = 1,
    usage: str = "",
) -> None:
    """Runs a node as `run` does: its callbacks in threads of their own, its work in this one.

    work: by default waits for a signal. usage: another way to call the program, for --help.
    """

    def body() -> None:
        node = make()
        with spinning(node, threads):
            (work or wait_for_end)(node)

    _run(program, body, make.__module__, usage)


def _run(
    program: str, body: Callable[[], None], module: str, usage: str = "", sends_maps: bool = True
) -> None:
    take_ros_arguments_only(program, sys.modules[module].__doc__, body, usage)
    give_back_large_blocks()
    prepare_fast_dds(sends_maps=sends_maps)
    try:
        # rclpy's own handlers shut ROS down under code that is just using it.
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        interrupt_by_signals()
        body()
    except (KeyboardInterrupt, Cancelled, ExternalShutdownException) as end:
        _free_frames(end)
    except (
        InputError, RuntimeError, OSError, MemoryError,
        InvalidParameterTypeException, InvalidParameterValueException,
    ) as error:  # fmt: skip
        print(f"{program}: {told(error)}", file=sys.stderr)
        _free_frames(error)
        sys.exit(1)
    finally:
        rclpy.try_shutdown()


def _free_frames(error: BaseException | None) -> None:
    """Destroys what frames of an exception hold, such as a node that was only half made."""
    with _ended_within(LAST):
        while error:
            traceback.clear_frames(error.__traceback__)
            error = error.__context__


def spin(node: Node) -> None:
    """rclpy.spin, which Ctrl-C ends without a traceback."""
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        try:
            rclpy.spin(node)
        except RuntimeError:  # RCLError, if ROS has ended between two waits
            if node.context.ok():
                raise


@contextmanager
def spinning(node: Node, threads: int = 1) -> Iterator[None]:
    """Runs a node's callbacks in threads of their own while the block runs, then destroys it.

    An exception of a callback ends ROS, which the block may see, and is raised here after the
    block. A signal whose exception got lost ends ROS, too.
    """
    stop_if_asked()
    Mistakes(node)
    with uninterrupted():  # Python prints what goes wrong as a half-made executor is destroyed
        executor = MultiThreadedExecutor(threads) if threads > 1 else SingleThreadedExecutor()
    executor.add_node(node)
    begun, ending, ended = Event(), Event(), Event()
    spun: Future[None] | None = None

    def spin() -> None:
        begun.set()
        try:
            # Not executor.spin(): only the end of ROS ends it, in the middle of a callback.
            while not ending.is_set():
                executor.spin_once(0.1)
                if since_interrupt() > LOST:
                    node.context.try_shutdown()
                    return
                if threads > 1:
                    # Up to Jazzy, rclpy hands a callback to its threads again and again until one
                    # begins with it. Without a pause, none of them gets Python's lock.
                    time.sleep(BREATH)
        except BaseException:
            node.context.try_shutdown()
            raise
        finally:
            ended.set()

    with ThreadPoolExecutor(1) as pool:
        try:
            spun = pool.submit(spin)  # Ctrl-C may come when the thread runs, but before spun is set
            yield
        finally:
            ending.set()
            if begun.is_set():  # else it will find `ending` set
                ended.wait()
            _wait_for_callbacks(executor, GRACE)
            node.context.try_shutdown()  # callbacks that still run see that and end
            _wait_for_callbacks(executor, math.inf)
            _print_errors_of_callbacks(executor)
            with _ended_within(LAST):
                executor.shutdown()
                node.destroy_node()
            if spun:
                spun.result()


@contextmanager
def _ended_within(seconds: float) -> Iterator[None]:
    """Ends the process, with code 1 and the place in the code, if the block takes longer.

    Fast DDS 2.14 may wait for itself while other nodes end, and rclpy for it with Python's lock, so
    that no signal helps. faulthandler's thread needs no lock.
    """
    faulthandler.dump_traceback_later(seconds, exit=True, file=2)  # sys.stderr may be a test's
    try:
        yield
    finally:
        faulthandler.cancel_dump_traceback_later()


def _wait_for_callbacks(executor: Executor, timeout: float) -> None:
    # Up to Jazzy, executor.shutdown(timeout) promises this but doesn't wait for other threads.
    deadline = time.monotonic() + timeout
    while not all(task.done() for task in getattr(executor, "_futures", [])):
        if time.monotonic() > deadline:
            return
        time.sleep(0.005)


def _print_errors_of_callbacks(executor: Executor) -> None:
    # rclpy itself reports every error that nobody fetches. Since Kilted, nodes end with ROS: a
    # callback that answers or publishes later raises InvalidHandle, which is no news.
    for task in getattr(executor, "_futures", []):
        error = task.exception()
        if error and not isinstance(error, InvalidHandle):
            print(told(error), file=sys.stderr)


def wait_for_end(node: Node) -> None:
    """Waits until a signal comes or a callback raises."""
    while node.context.ok():
        time.sleep(0.1)
