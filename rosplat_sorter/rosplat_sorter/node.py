"""Sorts a map's splats for each view of it, back to front.

Only displays whose Order Source is Sidecar need a sorter. It hears `gaussians/view`, holds the map
of `gaussians` while a view wants orders, and publishes them on `gaussians/order`.
"""

from __future__ import annotations

import contextlib
import os
import sys
import time

from rcl_interfaces.msg import SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

from rosplat_msgs.msg import SplatOrder, ViewCamera
from rosplat_ros import qos
from rosplat_ros.diagnostics import Diagnostics, Report
from rosplat_ros.held_map import MapSubscriber
from rosplat_ros.program.parameters import declare
from rosplat_ros.program.running import run, spinning
from rosplat_ros.program.said_once import Throttled
from rosplat_sorter.backends import AUTO, BACKENDS
from rosplat_sorter.map import SplatMap
from rosplat_sorter.worker import Worker

FORGET_AFTER = 60.0  # without a view that wants an order, until the map is forgotten [s]
CHOICES = (AUTO, *BACKENDS)
SETTINGS = ("backend", "threads")
LOSSES = ("Batches dropped", "Splats dropped", "Views dropped")


class SorterNode(Node):
    """Hears `gaussians/view`; while views want orders, `gaussians`; publishes `gaussians/order`.

    No callback waits for anything: parameters are answered at once.
    """

    def __init__(self) -> None:
        self._worker: Worker | None = None  # first: since Kilted, half-made nodes are destroyed
        super().__init__("sorter")
        about = "What sorts; auto takes the fastest backend that works here"
        declare(self, "backend", AUTO, about, choices=CHOICES, changes=True)
        about = "Threads of a backend on the CPU; 0: one for each core."
        declare(self, "threads", 0, about, 0, 256, changes=True)
        # Remapping the map's topic takes the others along.
        topic = self.resolve_topic_name("gaussians")
        self._order = self.create_publisher(
            SplatOrder, f"{topic}/order", **qos.overridable(qos.ORDER)
        )
        self._spoilt = 0  # sum of the LOSSES at the last report
        self._wanted = 0.0  # when a view last wanted an order
        self._is_told = hasattr(self, "add_post_set_parameters_callback")  # since Iron
        self.add_on_set_parameters_callback(self._validate)
        if self._is_told:
            self.add_post_set_parameters_callback(self._use)
        self.create_subscription(
            ViewCamera, f"{topic}/view", self._on_view, **qos.overridable(qos.VIEW)
        )
        Diagnostics(self, topic, self._report)
        self.get_logger().info(f"waits for a view that wants an order, on {topic}/view")

    @property
    def unwanted(self) -> bool:
        """Whether no view has wanted an order for a minute: the process should begin anew, without
        a map.
        """
        return bool(self._worker) and time.monotonic() - self._wanted > FORGET_AFTER

    def destroy_node(self) -> None:
        if self._worker:
            self._worker.close()
        super().destroy_node()

    def _on_view(self, message: ViewCamera) -> None:
        if not message.sequence:
            return  # no order is wanted
        self._wanted = time.monotonic()
        if not self._worker:
            self._map = MapSubscriber(self, SplatMap(), most_sh_degree=0)
            settings = (self.get_parameter(name).value for name in SETTINGS)
            log = Throttled(self.get_logger())
            self._worker = Worker(self._map, self.publish, log, *settings)
        self._worker.set_camera(message)

    def _report(self) -> Report:
        """Warns of a backlog, a map that isn't whole, and of losses since the last report."""
        if not self._worker:
            return Report("no view wants an order", {})
        figures = self._worker.figures()
        spoilt, before = sum(figures[name] for name in LOSSES), self._spoilt
        self._spoilt = spoilt
        if self._map.busy:
            return Report("more batches wait than may", figures, warns=True)
        if spoilt > before:
            return Report("batches, splats or views were dropped", figures, warns=True)
        if figures["Batches missed"]:
            return Report("the map is incomplete", figures, warns=True)
        return Report("the map is pulled" if self._map.receiver.pulling else "sorts", figures)

    def publish(self, order: SplatOrder) -> None:
        """Publishes an order, from the worker's thread."""
        if self.context.ok():
            self._order.publish(order)

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
        if self._worker and values.keys() & set(SETTINGS):
            self._worker.use(
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
        while node.context.ok() and not node.unwanted:
            time.sleep(0.1)
        begins_anew = node.context.ok()
        if begins_anew:
            node.get_logger().info("no view wants an order: the map is forgotten")
        settings = [f"{name}:={node.get_parameter(name).value}" for name in SETTINGS]
    if begins_anew:
        _begin_anew(settings)
