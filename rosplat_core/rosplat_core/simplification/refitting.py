"""Splats moved, resized and recoloured until their pictures are those of another map.

Each step draws a part of a new view, and moves what is seen there against the gradient of the error
(Kerbl et al. 2023). The views must be new: of a fixed set, splats learn that set only.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from rosplat_core._core import Refit, RefitRates
from rosplat_core.cameras import Camera
from rosplat_core.rendering import CpuRenderer, SplatCamera, posed
from rosplat_core.splats import Splats

PART = 2  # views are this many times as wide and high as the part that a step draws
TIMED = 16  # first steps, which are timed to tell how many there is time for
MOST_STEPS = 20_000
CHECKS = 8  # maps that are yielded on the way
WARM = 20  # steps until rates are full: Adam's moments begin with one picture
# A step's rates for pictures that differ by RATED, for which they were found, or more; else lower.
RATES = {
    "position": 0.004,
    "scale": 0.003,
    "rotation": 0.001,
    "opacity": 0.01,
    "colour": 0.002,
    "bands": 0.001,
}
RATED = 0.0126  # root mean square of that difference: 38 dB
RECENT = 0.95  # share of the error before in the running mean square error

Views = Callable[[int, int], list[Camera]]
"""Called with a count and a seed; makes so many cameras."""


def refit(
    start: Splats,
    full: CpuRenderer,
    views: Views,
    seconds: float,
    progress: Callable[[float], None] = lambda part: None,
    seed: int = 0,
    most_steps: int = MOST_STEPS,
) -> Iterator[Splats]:
    """Fits splats to pictures of the map that `full` holds; yields CHECKS maps on the way.

    There are as many steps as take `seconds` [s], most_steps at most; the rates fall to zero with
    the last. progress: called with the share done, 0 to 1. Raises MemoryError where Adam's moments,
    two for each number of a splat, have no room.
    """
    fitting = Refit(start)
    random = np.random.default_rng(seed)
    began, steps, error = time.monotonic(), most_steps, RATED**2
    cameras: list[Camera] = []
    step = checked = 0
    while step < steps:
        if not cameras:
            seed += 1
            cameras = views(TIMED, seed)
        part = _part_of(cameras.pop(), random)
        rate = (1 + math.cos(math.pi * step / steps)) / 2 * min(1.0, (step + 1) / WARM)
        rate *= min(1.0, math.sqrt(error) / RATED)
        rates = RefitRates(**{name: rate * value for name, value in RATES.items()})
        error = RECENT * error + (1 - RECENT) * fitting.step(part, picture(full, part), rates)
        step += 1
        progress(step / steps)
        if step == TIMED:
            each = (time.monotonic() - began) / TIMED
            steps = int(min(max(seconds / max(each, 1e-9), 2 * TIMED), most_steps))
        if step >= TIMED and step * CHECKS // steps > checked:
            checked = step * CHECKS // steps
            yield _splats(fitting, start)


def picture(renderer: CpuRenderer, camera: SplatCamera) -> NDArray[np.float32]:
    """What a screen shows of a map over black, float32 (height, width, 3), 0 to 1."""
    colour = renderer.draw(camera)["colour"][..., :3]
    clipped: NDArray[np.float32] = np.clip(colour, 0, 1)
    return clipped


def _part_of(camera: Camera, random: np.random.Generator) -> SplatCamera:
    """A part of a view, anywhere in it, in that view's own pixels."""
    width, height = max(1, camera.width // PART), max(1, camera.height // PART)
    left = int(random.integers(camera.width - width + 1))
    top = int(random.integers(camera.height - height + 1))
    return posed(camera).crop(left, top, width, height)


def _splats(fitting: Refit, start: Splats) -> Splats:
    return replace(start, **cast(dict[str, Any], fitting.splats()))
