"""The float64 reference's pictures, which other pictures are held against: the middle of each."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import lru_cache, partial

import numpy as np
from numpy.typing import NDArray

from rosplat_core import depth
from rosplat_core.cameras import Camera
from rosplat_core.ordering import view_of
from rosplat_core.splats import Splats
from rosplat_lab import metrics, reference
from rosplat_lab.bench import scenes

COMPARED = (640, 360)  # size of the compared middle of a picture, at most [px]

Look = Callable[[Splats], Camera]
"""Chooses a camera of a scene."""
Truth = NDArray[np.float32]
"""(height, width, 3) RGB over black of the compared part of a picture."""
Crop = tuple[int, int, int, int]
"""Left, top, right, bottom of a part of a picture. [px]"""
Draw = Callable[[Splats, Camera, Crop], NDArray[np.float64]]
"""(height, width, 3) RGB over black of a crop."""


def exact(splats: Splats, camera: Camera, crop: Crop) -> NDArray[np.float64]:
    """The reference's picture of a crop, RGB over black."""
    return reference.render(splats, camera, crop=crop).rgba[..., :3]


def draw(name: str, looks: Sequence[Look], by: Draw = exact) -> list[Truth]:
    """Draws the compared parts of pictures of a scene, by the reference or by a model.

    name: of the scene. looks: choose the cameras, of which a process draws one at a time.
    """
    workers = min(len(looks), len(os.sched_getaffinity(0)))
    with ProcessPoolExecutor(workers, multiprocessing.get_context("spawn")) as pool:
        # Processes that start now inherit the mask: Ctrl-C reaches the parent alone.
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        drawn = pool.map(partial(_draw, name, by), looks)
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        try:
            return list(drawn)
        except BaseException:
            for process in multiprocessing.active_children():
                process.terminate()
            raise


def _draw(name: str, by: Draw, look: Look) -> Truth:
    splats = _scene(name)
    camera = look(splats)
    rows, columns = compared(camera.width, camera.height)
    crop = (columns.start, rows.start, columns.stop, rows.stop)
    return by(splats[in_view(splats, camera, crop)], camera, crop).astype(np.float32)


@lru_cache(maxsize=1)
def _scene(name: str) -> Splats:
    return scenes.load(name)


def compared(width: int, height: int) -> tuple[slice, slice]:
    """Rows and columns of the compared part of a picture."""
    parts = [min(size, part) for size, part in zip((width, height), COMPARED, strict=True)]
    left, top = (width - parts[0]) // 2, (height - parts[1]) // 2
    return slice(top, top + parts[1]), slice(left, left + parts[0])


def middle(drawn: NDArray[np.floating]) -> NDArray[np.float32]:
    """The compared part of a picture, clipped as on a screen."""
    height, width = drawn.shape[:2]
    part: NDArray[np.float32] = np.clip(drawn[compared(width, height)], 0, 1).astype(np.float32)
    return part


def psnr(drawn: NDArray[np.floating], truth: Truth) -> float:
    """PSNR of a picture, (height, width, 3) RGB, as a screen shows it. [dB]"""
    return metrics.psnr(middle(drawn), np.clip(truth, 0, 1))


def in_view(splats: Splats, camera: Camera, crop: Crop) -> NDArray[np.intp]:
    """Rows of the splats that a part of a camera's picture may show."""
    left, top, right, bottom = crop
    window = replace(
        camera, width=right - left, height=bottom - top, cx=camera.cx - left, cy=camera.cy - top
    )
    part, whole = view_of(window, splats), view_of(camera, splats)
    # A part's footprints grow as in the whole picture.
    part = replace(part, slope_x=whole.slope_x, slope_y=whole.slope_y)
    extents = depth.splat_extents(splats.scales, splats.opacities)
    return np.flatnonzero(depth.visible(part, splats.positions, extents))
