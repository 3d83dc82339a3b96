"""A viewer that draws nothing, for benchmarks: poses a camera, and writes a line of JSON an order.

A program of its own: `python -m rosplat_lab.bench.far_viewer --ros-args -p trace:=FILE ...`.
"""

from __future__ import annotations

import json
import time
import uuid

import numpy as np
from rclpy.node import Node

from rosplat_lab.bench.scenes import GARDEN, STEP
from rosplat_msgs.msg import SplatOrder, ViewCamera
from rosplat_sorter.order_slots import OrderReader
from rosplat_sorter.qos import ORDER, VIEW
from rosplat_tools.program.parameters import declare
from rosplat_tools.program.running import run, spinning
from rosplat_tools.view_messages import view_camera
from rviz_gaussian_plugin.viewer.orbit import OrbitCamera

PICTURE = (1280, 720)


class FarViewer(Node):
    """Turns a camera from which all of the procedural scene is seen."""

    def __init__(self) -> None:
        super().__init__("far_viewer")
        self.rate: float = declare(self, "rate", 30.0, "How often it turns. [Hz]", 0.1, 1e4)
        self._trace = open(  # noqa: SIM115
            declare(self, "trace", "", "File to write a line of JSON an order to."), "w"
        )
        self._view = uuid.uuid4().hex
        self._looked: dict[int, float] = {}
        self._orders = OrderReader()
        self._orbit = OrbitCamera(np.zeros(3), 4 * GARDEN, np.array([0.0, 0.0, 1.0]))
        self._views = self.create_publisher(ViewCamera, "gaussians/view", VIEW)
        self.create_subscription(SplatOrder, "gaussians/order", self._on_order, ORDER)

    def turn(self) -> None:
        """Shows the next camera."""
        self._orbit.turn(STEP, 0)
        camera = view_camera(self._orbit.camera(*PICTURE))
        camera.view_id, camera.sequence = self._view, len(self._looked) + 1
        camera.header.frame_id = "map"
        camera.segment_key = self._orders.key
        self._looked[camera.sequence] = time.time()
        self._views.publish(camera)

    def _on_order(self, message: SplatOrder) -> None:
        slots = self._orders.read(message)
        line = {
            "time": time.time(),
            "looked": self._looked[message.sequence],
            "sequence": message.sequence,
            "encoding": message.encoding,
            "slots": len(slots),
            "bytes": len(message.packed),
            "sort_time": message.sort_time,
        }
        self._trace.write(json.dumps(line) + "\n")
        self._trace.flush()


def main() -> None:
    """Runs the viewer until it is told to end."""
    run("far_viewer", _watch)


def _watch() -> None:
    viewer = FarViewer()
    with spinning(viewer):
        due = time.monotonic()
        while viewer.context.ok():
            viewer.turn()
            due = max(due + 1 / viewer.rate, time.monotonic())
            time.sleep(max(0.0, due - time.monotonic()))


if __name__ == "__main__":
    main()
