"""A viewer whose camera never rests, for benchmarks: writes a line of JSON for each frame it drew.

A program of its own: `python -m rosplat_lab.bench.moving_viewer --ros-args -p trace:=FILE ...`.
"""

from __future__ import annotations

import json
import math
import threading
import time
from typing import TextIO

import numpy as np

from rosplat_lab.bench.renderers import gl_finish
from rosplat_lab.bench.scenes import STEP
from rosplat_msgs.msg import SplatOrder, ViewCamera
from rosplat_ros.program.parameters import declare
from rosplat_ros.program.running import run, spinning
from rosplat_ros.view_cameras import view_camera
from rviz_gaussian_plugin.offscreen import ensure_display
from rviz_gaussian_plugin.viewer.node import Viewer
from rviz_gaussian_plugin.viewer.orbit import OrbitCamera

REMEMBERED = 1000  # cameras whose orders may still come
WAITING = 0.02  # between looks at whether the map is there [s]
IDLE = 0.0005  # between looks at whether there is something to draw [s]


class MovingViewer(Viewer):
    """A viewer that remembers when orders arrived."""

    def __init__(self) -> None:
        super().__init__()
        self.rate: float = declare(
            self, "rate", 30.0, "How often the camera turns. [Hz]", 0.01, 1e4
        )
        self.trace: str = declare(self, "trace", "", "File to write a line of JSON a frame to.")
        self._arrivals: list[dict[str, float]] = []
        self._lock = threading.Lock()

    def _on_order(self, message: SplatOrder) -> bool:
        if not super()._on_order(message):
            return False
        arrival = {
            "time": time.time(),
            "sequence": message.sequence,
            "sort_time": message.sort_time,
            "encoding": message.encoding,
        }
        with self._lock:
            self._arrivals.append(arrival)
        return True

    def arrivals(self) -> list[dict[str, float]]:
        """The orders that came since the last call."""
        with self._lock:
            taken, self._arrivals = self._arrivals, []
        return taken


def watch(viewer: MovingViewer, trace: TextIO) -> None:
    """Draws until it is told to end."""
    finish = gl_finish()
    looked: dict[int, float] = {}  # when each camera was posed
    unseen: list[int] = []  # cameras that no order has answered yet
    orbit: OrbitCamera | None = None
    camera, view_id, due, turned = ViewCamera(), "", 0.0, False
    stale, revision = True, 0
    while viewer.context.ok():
        if orbit is None and viewer.renderer.splats and viewer.complete():
            centre, radius = viewer.bounds()
            orbit = OrbitCamera(centre, 2.5 * radius, np.array(viewer.up, np.float64))
        if orbit is None:
            viewer.renderer.upload()
            time.sleep(WAITING)
            continue
        now = time.time()
        if now >= due:
            due = max(due + 1 / viewer.rate, now)
            orbit.turn(STEP, 0)
            camera = view_camera(orbit.camera(*viewer.window_size))
            view_id = viewer.set_camera(camera, "bench")
            looked[camera.sequence] = now
            unseen.append(camera.sequence)
            looked.pop(camera.sequence - REMEMBERED, None)
            turned = True
        arrivals = viewer.arrivals()
        if not (turned or arrivals or stale or viewer.renderer.revision != revision):
            time.sleep(IDLE)
            continue
        turned, revision = False, viewer.renderer.revision
        splats = viewer.renderer.splats
        complete = viewer.complete()
        began = time.time()
        report = viewer.renderer.draw(view_id)
        finish()
        stale = not report["order_fresh"]
        ended = time.time()
        # An order also counts for earlier cameras, which nothing answers any more.
        answered = max((int(arrival["sequence"]) for arrival in arrivals), default=0)
        if report["order_fresh"]:
            answered = camera.sequence
        is_new = answered in unseen
        unseen = [sequence for sequence in unseen if sequence > answered]
        for arrival in arrivals:
            arrival["looked"] = looked.get(int(arrival["sequence"]), math.nan)
        line = {
            "time": ended,
            "frame": ended - began,
            "splats": splats,
            "complete": complete,
            "fresh": report["order_fresh"],
            "renderer": viewer.renderer.renderer_info,
            "arrivals": arrivals,
            "latency": ended - looked[answered] if is_new else math.nan,
        }
        trace.write(json.dumps(line) + "\n")
        trace.flush()


def main() -> None:
    run("moving_viewer", _watch)


def _watch() -> None:
    with ensure_display():
        viewer = MovingViewer()
        try:
            with spinning(viewer, threads=4), open(viewer.trace, "w", encoding="utf-8") as trace:
                watch(viewer, trace)
        finally:
            del viewer.renderer  # while its display is there


if __name__ == "__main__":
    main()
