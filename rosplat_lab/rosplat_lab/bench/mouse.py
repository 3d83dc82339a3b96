"""rviz2 at its own frame rate while a mouse drags its view: how it feels where no GPU draws."""

from __future__ import annotations

import contextlib
import re
import subprocess
import time
from collections.abc import Iterator
from itertools import product
from pathlib import Path
from typing import Any

from rosplat_lab.bench.records import Budget, Measurement
from rosplat_lab.driven_rviz import DrivenRviz

BUDGET, QUICK_BUDGET = Budget(200, 200, 8.0), Budget(3, 3, 1.0)
FRAME_RATE = 30  # rviz2's own default [Hz]
PERIOD = 0.016  # between moves of the mouse [s]
SPEED = 105  # at which an Orbit view turns by 30 degrees a second [px/s]
SWEEP = 200  # way of the mouse, there and back again [px]
ROUNDS = 30  # of these, two minutes
OF_LATE = 2.0  # time that the display's Status looks back on [s]
GRID = {"Class": "rviz_default_plugins/Grid", "Name": "Grid", "Enabled": False, "Value": False}


def measure(rviz: DrivenRviz, quick: bool, labels: dict[str, Any]) -> Iterator[Measurement]:
    """A view's frames, the age of the map's picture, how far its camera is off, processor time.

    With and without the display that the labels name, with and without the GRID beside it.
    """
    display, budget = labels["display"], QUICK_BUDGET if quick else BUDGET
    for grid, shown in product((False, True), repeat=2):
        _switch(rviz, "Grid", grid)
        _switch(rviz, display, shown)
        with drag(rviz):
            time.sleep(OF_LATE)
            before = processor_times(rviz.process.pid)
            ages: list[float] = []
            offs: list[float] = []
            rviz.ask("start watch", turn=0.0)
            began = time.monotonic()
            while time.monotonic() < began + budget.seconds or rviz.ask("frames") <= budget.least:
                time.sleep(0.5)
                if shown:
                    text = rviz.status(display).get("Picture", ("", ""))[1]
                    ages += map(float, re.findall(r"([\d.]+) ms old", text))
                    offs += map(float, re.findall(r"([\d.]+) ms off", text))
            seen = rviz.ask("stop watch")
            after = processor_times(rviz.process.pid)
        case = labels | {"map": shown, "grid": grid}
        yield Measurement("frame by mouse", "ms", seen["frame"], **case)
        if ages:
            yield Measurement("age by mouse", "ms", ages, **case)
        if offs:
            yield Measurement("camera off by mouse", "ms", offs, **case)
        for threads in sorted(after):
            spent = after[threads] - before.get(threads, 0)
            per_frame = 1e3 * spent / (len(seen["frame"]) + 1)
            yield Measurement("processor time by mouse", "ms", per_frame, **case, threads=threads)
    _switch(rviz, "Grid", False)


@contextlib.contextmanager
def drag(rviz: DrivenRviz) -> Iterator[None]:
    """The left button is held and the mouse moves to and fro, at a steady speed."""
    x, y, width, height = rviz.ask("places")["view"]
    there = [round(step * SPEED * PERIOD) for step in range(round(SWEEP / SPEED / PERIOD))]
    moves = [
        word for at in there + there[::-1]
        for word in ("mousemove", str(x + (width - SWEEP) // 2 + at), str(y + height // 2),
                     "sleep", str(PERIOD))
    ]  # fmt: skip
    hand = subprocess.Popen(["xdotool", *moves[:3], "mousedown", "1", *(ROUNDS * moves)])
    try:
        yield
    finally:
        hand.terminate()
        hand.wait()
        subprocess.run(["xdotool", "mouseup", "1"], check=True)


def processor_times(pid: int) -> dict[str, float]:
    """Processor time so far of an rviz2's threads that draw, by their purpose. [s]"""
    found: dict[str, float] = {}
    for task in Path(f"/proc/{pid}/task").iterdir():
        with contextlib.suppress(OSError):  # the thread has ended
            name, _, values = (task / "stat").read_text().partition("(")[2].rpartition(")")
            nice = int(values.split()[16])
            kind = (
                "render thread" if task.name == str(pid)
                else "llvmpipe" if name.startswith("llvmpipe")
                else "painter" if nice > 0  # it gives way to the others
                else ""
            )  # fmt: skip
            if kind:
                nanoseconds = int((task / "schedstat").read_text().split()[0])
                found[kind] = found.get(kind, 0) + 1e-9 * nanoseconds
    return found


def _switch(rviz: DrivenRviz, display: str, on: bool) -> None:
    if rviz.properties()[display] != on:
        rviz.set(display, value=on)
