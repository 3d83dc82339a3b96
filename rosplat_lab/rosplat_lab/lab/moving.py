"""What a view shows under motion where the processor paints: an older picture, carried over."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rosplat_core import rendering
from rosplat_core.cameras import Camera
from rosplat_core.rendering import psnr_of
from rosplat_lab.bench import embedded, scenes
from rosplat_lab.bench.records import Event, Measurement

if TYPE_CHECKING:
    from rviz_gaussian_plugin.offscreen import Renderer

PICTURE, QUICK_PICTURE = (1280, 720), (320, 180)
VIEWS = {"overview": scenes.overview, "inside": scenes.inside}

SPEED = 20  # of a camera in motion [degrees/s]
SWEEP = 40  # there, and back again [degrees]
STEP = 0.05  # [degrees]
INTERVAL = 1 / 30  # of frames [s]
SECONDS, QUICK_SECONDS = 4.0, 0.5
LEAST_FRAMES = 4
SAMPLES = 12  # frames that are looked at
AT_REST = 0.5  # levels of detail that haven't changed for so long are complete [s]


def _shown(renderer: Renderer, view: embedded.NumberedView, camera: Camera) -> NDArray[np.float64]:
    renderer.settings.interactive = False
    view.set_camera(camera)
    view.draw()
    picture: NDArray[np.float64] = renderer.read_color8() / 255
    return picture


def in_motion(name: str, quick: bool, motion: str, detail: str) -> Iterator[Event]:
    """The pictures shown to a camera that turns, against the exact pictures of its poses."""
    from rosplat_core.rendering import Rasterizer
    from rviz_gaussian_plugin.offscreen import ensure_display

    splats = scenes.load(name)
    size, seconds = (QUICK_PICTURE, QUICK_SECONDS) if quick else (PICTURE, SECONDS)
    cameras = VIEWS[motion](splats, *size, round(SWEEP / STEP) + 1, math.radians(STEP))
    with ensure_display():
        renderer = embedded.open_renderer()
        renderer.settings.rasterizer = Rasterizer.PROCESSOR
        renderer.settings.detail = detail
        renderer.settings.interactive = True
        rendering.insert_all(renderer, splats)
        view = embedded.NumberedView(renderer)
        _rest(view, cameras[0])

        frames: list[tuple[Camera, NDArray[np.float32], dict[str, Any]]] = []
        began = time.monotonic()
        while (now := time.monotonic() - began) < seconds or len(frames) < LEAST_FRAMES:
            turned = SPEED * now % (2 * SWEEP)
            camera = cameras[int(min(turned, 2 * SWEEP - turned) / STEP)]
            view.set_camera(camera)
            report = view.draw()
            frames.append((camera, renderer.read_color8() / 255, report))
            time.sleep(max(0.0, INTERVAL - (time.monotonic() - began - now)))

        renderer.settings.detail = "full"
        picked = np.unique(np.linspace(0, len(frames) - 1, SAMPLES).astype(int))
        errors = [
            np.mean(np.square(shown - _shown(renderer, view, camera)))
            for camera, shown, _ in (frames[i] for i in picked)
        ]
        labels: dict[str, Any] = {"view": motion, "detail": detail, "speed": SPEED}
        of = (name, len(splats), renderer.renderer_info)
        yield Measurement.of("PSNR in motion", "dB", psnr_of(float(np.mean(errors))), *of, **labels)
        painting = [1e3 * report["paint_time"] for *_, report in frames]
        yield Measurement.of("painting in motion", "ms", painting, *of, **labels)
        del renderer, view  # while its display is there


def _rest(view: embedded.NumberedView, camera: Camera) -> None:
    """Draws until nothing changes any more: the exact picture, and levels if there are any."""
    view.set_camera(camera)
    since, levels = time.monotonic(), -1
    while time.monotonic() - since < AT_REST:
        report = view.draw()
        if not report["order_fresh"] or report["levels_bytes"] != levels:
            since, levels = time.monotonic(), report["levels_bytes"]
        time.sleep(INTERVAL)
