"""What a view shows under motion where the processor paints: an older picture, carried over."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rosplat_core import rendering
from rosplat_core.cameras import Camera
from rosplat_core.rendering import psnr_of
from rosplat_lab.bench import scenes
from rosplat_lab.bench.records import Event, Measurement
from rosplat_lab.bench.renderers import DisplayRenderer, NumberedView
from rosplat_lab.lab.ways import ERROR, TIME

PICTURE, QUICK_PICTURE = (1280, 720), (320, 180)
VIEWS = (scenes.overview, scenes.inside)

SPEED = 20  # of a camera in motion [degrees/s]
MOVING = f"the camera turns by {SPEED} deg/s"
SWEEP = 40  # there, and back again [degrees]
STEP = 0.05  # [degrees]
INTERVAL = 1 / 30  # of frames [s]
SECONDS, QUICK_SECONDS = 4.0, 0.5
LEAST_FRAMES = 4
SAMPLES = 12  # frames that are looked at
AT_REST = 0.5  # levels of detail that haven't changed for so long are complete [s]


def in_motion(name: str, quick: bool, setting: str, detail: str) -> Iterator[Event]:
    """A time and an error of the pictures shown to a camera that turns, against the exact pictures
    of its poses."""
    from rviz_gaussian_plugin.offscreen import ensure_display

    splats = scenes.load(name)
    size, seconds = (QUICK_PICTURE, QUICK_SECONDS) if quick else (PICTURE, SECONDS)
    times, errors = [], []
    with ensure_display():
        display = DisplayRenderer()
        rendering.insert_all(display.renderer, splats)
        for view in VIEWS:
            cameras = view(splats, *size, round(SWEEP / STEP) + 1, math.radians(STEP))
            display.use({"rasterizer": "PROCESSOR", "detail": detail, "interactive": True})
            _rest(display.view, cameras[0])
            frames: list[tuple[Camera, NDArray[np.float32]]] = []
            painting: list[float] = []
            began = time.monotonic()
            while (now := time.monotonic() - began) < seconds or len(frames) < LEAST_FRAMES:
                turned = SPEED * now % (2 * SWEEP)
                camera = cameras[int(min(turned, 2 * SWEEP - turned) / STEP)]
                picture, report = _shown(display, camera)
                frames.append((camera, picture))
                painting.append(1e3 * report["paint_time"])
                time.sleep(max(0.0, INTERVAL - (time.monotonic() - began - now)))
            times.append(np.median(painting))
            display.use({"rasterizer": "PROCESSOR"})
            picked = np.unique(np.linspace(0, len(frames) - 1, SAMPLES).astype(int))
            errors += [
                np.mean(np.square(shown - _shown(display, camera)[0]))
                for camera, shown in (frames[i] for i in picked)
            ]
        labels: dict[str, Any] = {
            "scene": Path(name).name, "splats": len(splats), "gpu": display.device,
            "setting": setting, "family": "in motion", "aside": MOVING,
        }  # fmt: skip
        yield Measurement(TIME, "ms", np.mean(times), **labels)
        yield Measurement(ERROR, "dB", psnr_of(float(np.mean(errors))), **labels)
        del display  # while its display is there


def _shown(display: DisplayRenderer, camera: Camera) -> tuple[NDArray[np.float32], dict[str, Any]]:
    """What a window shows to a camera, and what the renderer reports."""
    display.view.set_camera(camera)
    report = display.view.draw()
    return display.renderer.read_color8() / 255, report


def _rest(view: NumberedView, camera: Camera) -> None:
    """Draws until nothing changes any more: the exact picture, and levels if there are any."""
    view.set_camera(camera)
    since, levels = time.monotonic(), -1
    while time.monotonic() - since < AT_REST:
        report = view.draw()
        if not report["order_fresh"] or report["levels_bytes"] != levels:
            since, levels = time.monotonic(), report["levels_bytes"]
        time.sleep(INTERVAL)
