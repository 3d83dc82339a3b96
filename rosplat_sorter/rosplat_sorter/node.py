"""Sorts a map's splats for each view of it, back to front.

Only displays whose Order Source is Sidecar need a sorter. It hears `gaussians/view`, holds the map
of `gaussians` while a view wants orders, and publishes them on `gaussians/order`.
"""

from __future__ import annotations

import contextlib
import os
import sys
import time
from threading import Event

from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.parameter import Parameter

from rosplat_msgs.msg import SplatOrder, ViewCamera
from rosplat_ros import qos
from rosplat_ros.diagnostics import Diagnostics, Report
from rosplat_ros.map_receiver import MapReceiver
from rosplat_ros.program.parameters import declare
from rosplat_ros.program.running import run, spinning
from rosplat_sorter.backends import AUTO, BACKENDS
from rosplat_sorter.order_slots import pack
from rosplat_sorter.worker import Answer, Worker

THROTTLE = 5.0  # least time between two lines of the log of one kind [s]
FORGET_AFTER = 60.0  # without a view that wants an order, until the map is forgotten [s]
WATCH_PERIOD = 1.0  # of the look for such a view [s]
CHOICES = (AUTO, *BACKENDS)
SETTINGS = ("backend", "threads")
LOSSES = ("Batches dropped", "Splats dropped", "Views dropped")


class _AtWork:
    """What exists while views want orders: the worker, which has the map, and a subscription."""

    def __init__(self, node: SorterNode, backend: str, threads: int) -> None:
        self.worker = worker = Worker(node, backend, threads)
        self._map = MapReceiver(node, worker.edit, busy=lambda: worker.busy, most_sh_degree=0)
        self._spoilt = 0  # sum of the LOSSES at the last report
        self.wanted = time.monotonic()  # when a view last wanted an order

    def pull_again(self) -> None:
        """Pulls all of the map again, after a while."""
        self._map.pull_again()

    def report(self) -> Report:
        """Warns of a backlog, a map that isn't whole, and of losses since the last report."""
        figures = self.worker.figures()
        spoilt, before = sum(figures[name] for name in LOSSES), self._spoilt
        self._spoilt = spoilt
        if self.worker.busy:
            return Report("more batches wait than may", figures, warns=True)
        if spoilt > before:
            return Report("batches, splats or views were dropped", figures, warns=True)
        if figures["Batches missed"]:
            return Report("the map is incomplete", figures, warns=True)
        return Report("the map is pulled" if self._map.pulling else "sorts", figures)


class SorterNode(Node):
    """Hears `gaussians/view`; while views want orders, `gaussians`; publishes `gaussians/order`.

    No callback waits for anything: parameters are answered at once. unwanted is set once no view
    has wanted an order for a minute; the process should then begin anew, without a map.
    """

    def __init__(self) -> None:
        self._at_work: _AtWork | None = None  # first: since Kilted, half-made nodes are destroyed
        super().__init__("sorter")
        self._said: dict[str, float] = {}
        about = "What sorts; auto takes the fastest backend that works here"
        declare(self, "backend", AUTO, about, choices=CHOICES, changes=True)
        about = "Threads of a backend on the CPU; 0: one for each core."
        declare(self, "threads", 0, about, 0, 256, changes=True)
        # Remapping the map's topic takes the others along.
        topic = self.resolve_topic_name("gaussians")
        self._order = self.create_publisher(
            SplatOrder, f"{topic}/order", **qos.overridable(qos.ORDER)
        )
        self.unwanted = Event()
        self._is_told = hasattr(self, "add_post_set_parameters_callback")  # since Iron
        self.add_on_set_parameters_callback(self._validate)
        if self._is_told:
            self.add_post_set_parameters_callback(self._use)
        self.create_subscription(
            ViewCamera, f"{topic}/view", self._on_view, **qos.overridable(qos.VIEW)
        )
        Diagnostics(self, topic, self._report)
        self.get_logger().info(f"waits for a view that wants an order, on {topic}/view")

    def destroy_node(self) -> None:
        if self._at_work:
            self._at_work.worker.close()
        super().destroy_node()

    def _on_view(self, message: ViewCamera) -> None:
        if not message.sequence:
            return  # no order is wanted
        if not self._at_work:
            self._at_work = _AtWork(self, *(self.get_parameter(name).value for name in SETTINGS))
            steady = Clock(clock_type=ClockType.STEADY_TIME)
            self.create_timer(WATCH_PERIOD, self._watch, clock=steady)
        self._at_work.wanted = time.monotonic()
        self._at_work.worker.set_camera(message)

    def _report(self) -> Report:
        return self._at_work.report() if self._at_work else Report("no view wants an order", {})

    def _watch(self) -> None:
        wanted = self._at_work and time.monotonic() - self._at_work.wanted <= FORGET_AFTER
        if not wanted and not self.unwanted.is_set():
            self.get_logger().info("no view wants an order: the map is forgotten")
            self.unwanted.set()

    # --- What the worker calls, from its own thread -----------------------------------------------

    def publish(self, answer: Answer) -> None:
        message = SplatOrder(
            header=answer.header,
            view_id=answer.view_id,
            sequence=answer.sequence,
            map_id=answer.map_id,
            revision=answer.revision,
            backend=answer.backend,
            sort_time=answer.sort_time,
            count=len(answer.slots),
            segment=answer.segment,
            generation=answer.generation,
        )
        if answer.generation:
            message.encoding = SplatOrder.SHARED
        else:
            message.encoding = SplatOrder.PACKED
            message.slot_bits = answer.slot_bits
            message.packed = pack(answer.slots, answer.slot_bits)
        if self.context.ok():
            self._order.publish(message)

    def inform(self, subject: str, text: str) -> None:
        if self._take_turn(f"info {subject}"):
            self.get_logger().info(text)

    def warn(self, subject: str, text: str) -> None:
        if self._take_turn(subject):
            self.get_logger().warning(text)

    def pull_again(self) -> None:
        if self._at_work:
            self._at_work.pull_again()

    def _take_turn(self, subject: str) -> bool:
        """Returns whether a subject may be logged now; it then rests."""
        now = time.monotonic()
        silent = now - self._said.get(subject, -THROTTLE) < THROTTLE
        if not silent:
            self._said[subject] = now
        return not silent

    # --- What ROS calls ---------------------------------------------------------------------------

    def _validate(self, parameters: list[Parameter]) -> SetParametersResult:
        values = {parameter.name: parameter.value for parameter in parameters}
        if values.get("backend", AUTO) not in CHOICES:
            reason = f"unknown backend '{values['backend']}', known are {', '.join(CHOICES)}"
            return SetParametersResult(successful=False, reason=reason)
        if not self._is_told:
            self._use(parameters)
        return SetParametersResult(successful=True)

    def _use(self, parameters: list[Parameter]) -> None:
        values = {parameter.name: parameter.value for parameter in parameters}
        if self._at_work and values.keys() & set(SETTINGS):
            self._at_work.worker.use(
                *(values.get(name, self.get_parameter(name).value) for name in SETTINGS)
            )


def _begin_anew(parameters: list[str]) -> None:
    """Executes the program anew, to give back all memory.

    Middleware and libraries for GPUs keep some as long as their program runs. Whoever started the
    process sees the same one. parameters: "NAME:=VALUE" each, to keep.
    """
    for file in map(int, os.listdir("/proc/self/fd")):  # middleware leaves some open
        if file > 2:
            with contextlib.suppress(OSError):
                os.set_inheritable(file, False)
    settings = [word for parameter in parameters for word in ("-p", parameter)]
    os.execv(sys.executable, [sys.executable, *sys.argv, "--ros-args", *settings])


def main() -> None:
    """Runs the node until it is told to end; exit code 1 where a parameter makes no sense."""
    run("sorter", _sort, sends_maps=False)


def _sort() -> None:
    node = SorterNode()
    with spinning(node):
        while node.context.ok() and not node.unwanted.wait(0.1):
            pass
        settings = [f"{name}:={node.get_parameter(name).value}" for name in SETTINGS]
    if node.unwanted.is_set():
        _begin_anew(settings)
