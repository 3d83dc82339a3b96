"""Where blending fails: many layers, faint ones, bright ones, translucent objects between them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rosplat_core.rendering import CpuRenderer
from rosplat_lab import reference
from rosplat_lab.lab.atlas.case import Cases, Errors
from rosplat_lab.lab.atlas.stage import (
    PROCESSOR,
    Image,
    Stage,
    ahead,
    balls,
    cloud,
    decibels,
    floats,
    outside,
    truth,
)

CASES = Cases()
SMALL = {"width": 64, "height": 48, "fx": 60.0, "fy": 60.0, "cx": 32.0, "cy": 24.0}


@CASES.enter("Layers of fog", "layers", [10, 100, 1000, 10_000])
def layers(stage: Stage, layers: float) -> Errors:
    count = int(layers)
    random = np.random.default_rng(0)
    positions = np.column_stack(
        [random.normal(scale=0.05, size=(count, 2)), np.linspace(2, 3, count)]
    )
    # Alpha below 1/255 isn't drawn, so no layer is fainter than 0.01.
    opacity = max(min(0.5, 3 / count), 0.01)
    fog = balls(positions, 0.5, opacity, random.uniform(0.2, 1, (count, 3)))
    camera = ahead(**SMALL)
    yield from stage.both(fog, camera, truth(fog, camera))


@CASES.enter(
    "Faint splats and the cut at 1/255", "peak opacity", [0.003, 0.006, 0.01, 0.03, 0.1, 0.3]
)
def faint(stage: Stage, opacity: float) -> Errors:
    camera = ahead(**SMALL)
    count = round(1.5 / opacity)
    fog = balls(np.tile([0, 0, 2.0], (count, 1)), 0.3, opacity, 0.8)
    yield from stage.both(fog, camera, truth(fog, camera))
    y, x = np.mgrid[:48, :64] + 0.5
    variance = (60 * 0.3 / 2) ** 2 + 0.3
    gauss = np.exp(-((x - 32) ** 2 + (y - 24) ** 2) / (2 * variance))
    uncut = 0.8 * (1 - (1 - np.float32(opacity) * gauss) ** count)
    drawn = stage.shown(fog, camera, PROCESSOR)
    yield "against fog without a cut", decibels(drawn, np.repeat(uncut[..., None], 3, axis=2))


@CASES.enter("Harmonics that overshoot", "amplitude of the bands above 0", [0, 0.1, 0.3, 1, 3, 10])
def overshoot(stage: Stage, amplitude: float) -> Errors:
    splats = cloud(400, degree=3)
    splats.sh[:, 1:] *= np.float32(amplitude / 0.3)
    yield from stage.both(splats, outside(), truth(splats, outside()))


@CASES.enter(
    "Translucent objects among splats", "half opaque surfaces, one behind the other", [1, 2, 3, 4]
)
def translucent(stage: Stage, count: float) -> Errors:
    """White veils across the view. The nearest divides the splats: rviz draws all veils over the
    splats behind it."""
    splats = replace(cloud(600), positions=cloud(600).positions + floats(0, 0, 2))
    camera = ahead()
    depths = splats.positions[:, 2]

    def drawn(part: np.ndarray) -> Image:
        return CpuRenderer(splats[np.flatnonzero(part)]).render(camera)

    def exact(part: np.ndarray) -> Image:
        return reference.render(splats[np.flatnonzero(part)], camera).rgba

    veils = np.linspace(1.7, 2.3, int(count) + 2)[1:-1]
    edges = [-np.inf, *veils, np.inf]
    expected: Image = np.zeros((camera.height, camera.width, 3))
    for near, far in zip(edges[-2::-1], edges[:0:-1], strict=True):  # back to front
        expected = _over(exact((depths >= near) & (depths < far)), expected)
        if np.isfinite(near):
            expected = 0.5 + 0.5 * expected
    shown = _over(drawn(depths >= veils[0]), np.zeros((camera.height, camera.width, 3)))
    for _ in veils:
        shown = 0.5 + 0.5 * np.clip(shown, 0, 1)
    shown = _over(drawn(depths < veils[0]), shown)
    yield PROCESSOR, decibels(shown, expected)


def _over(front: Image, back: Image) -> Image:
    """Premultiplied RGBA over RGB."""
    return front[..., :3] + (1 - front[..., 3:]) * back
