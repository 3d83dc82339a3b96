"""Where orders fail: coarse keys, an order of some time ago, popping."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rosplat_core.cameras import Camera
from rosplat_core.generated import generate
from rosplat_core.splats import Splats, concatenate
from rosplat_core.view import OVERSCAN
from rosplat_lab.bench import scenes
from rosplat_lab.lab import orders
from rosplat_lab.lab.atlas.case import Cases, Curves
from rosplat_lab.lab.atlas.stage import (
    HEIGHT,
    SHADERS,
    WIDTH,
    Errors,
    Image,
    Stage,
    ahead,
    balls,
    cloud,
    decibels,
    outside,
    truth,
)
from rosplat_lab.lab.motion import turned

CASES = Cases()
COARSE = "linear keys of 16 bits"


@CASES.enter("A far outlier", "its distance over the scene's")
def outliers(stage: Stage) -> tuple[Sequence[float], Curves]:
    ratios, curves = stage.some([1, 10, 1e2, 1e4, 1e6]), Errors()
    scene, camera = cloud(3000, size=0.1), outside()
    for ratio in ratios:
        stray = balls([-ratio * camera.position], 0.01 * ratio, 0.5, 1)
        splats = concatenate([scene, stray.with_sh_degree(1)])
        expected = truth(splats, camera)
        curves.add(stage.both(splats, camera, expected))
        curves.add(iter([(COARSE, _coarse(stage, splats, camera, expected))]))
    return ratios, curves


@CASES.enter("Millimetres to kilometres in one view", "farthest over nearest")
def depth_range(stage: Stage) -> tuple[Sequence[float], Curves]:
    ratios, curves = stage.some([10, 1e3, 1e5, 1e7]), Errors()
    for ratio in ratios:
        random = np.random.default_rng(0)
        z = 0.02 * np.exp(random.uniform(0, math.log(ratio), 3000))
        base = cloud(3000)
        spread = np.column_stack([random.uniform(-0.5, 0.5, (3000, 2)), np.ones(3000)])
        splats = replace(
            base,
            positions=(spread * z[:, None]).astype(np.float32),
            scales=(base.scales * 0.5 * z[:, None]).astype(np.float32),
        )
        camera = ahead(near=0.01)
        expected = truth(splats, camera)
        curves.add(stage.both(splats, camera, expected))
        curves.add(iter([(COARSE, _coarse(stage, splats, camera, expected))]))
    return ratios, curves


def _coarse(stage: Stage, splats: Splats, camera: Camera, expected: Image) -> float:
    order = orders.Sorter(splats).keyed(camera, orders.linear(16))
    return decibels(stage.shown(splats, camera, SHADERS, order), expected)


@CASES.enter("An order from before a turn", "degrees since it was sorted")
def old_order(stage: Stage) -> tuple[Sequence[float], Curves]:
    """Old orders that were culled for their own view, and for a wider one as by sorters."""
    angles, curves = stage.some([0, 0.3, 1, 3, 10, 30]), Errors()
    splats = generate(5_000 if stage.quick else 40_000)
    camera = scenes.inside(splats, WIDTH, HEIGHT, 1)[0]
    expected = truth(splats, camera)
    sorter = orders.Sorter(splats)
    for angle in angles:
        past = turned(camera, -math.radians(angle))
        for name, factor in (("culled for its view", 1 / OVERSCAN), ("as sorters cull", 1.0)):
            order = sorter.order(_widened(past, factor))
            drawn = stage.shown(splats, camera, SHADERS, order)
            curves.add(iter([(name, decibels(drawn, expected))]))
    return angles, curves


def _widened(camera: Camera, factor: float) -> Camera:
    """The camera with a picture so many times as wide and high, around the same middle."""
    width, height = round(factor * camera.width), round(factor * camera.height)
    return replace(
        camera, width=width, height=height, cx=camera.cx + (width - camera.width) / 2,
        cy=camera.cy + (height - camera.height) / 2,
    )  # fmt: skip


@CASES.enter("Popping under slow rotation", "degrees a frame", "largest change of a pixel")
def popping(stage: Stage) -> tuple[Sequence[float], Curves]:
    """How much the order alone changes a frame: drawn in its own, and in the last frame's."""
    steps, curves = stage.some([0.1, 0.3, 1, 3]), Errors()
    splats = cloud(800, size=0.3)
    sorter = orders.Sorter(splats)
    for step in steps:
        cameras = [
            turned(outside(), math.radians(step * n)) for n in range(3 if stage.quick else 6)
        ]
        kept = [sorter.order(camera) for camera in cameras]
        worst = 0.0
        for before, now, camera in zip(kept, kept[1:], cameras[1:], strict=False):
            late, same = (
                stage.shown(splats, camera, SHADERS, order[np.isin(order, other)])
                for order, other in ((before, now), (now, before))
            )
            worst = max(worst, float(np.abs(late - same).max()))
        curves.add(iter([("sorted by z, as trained", round(worst, 4))]))
    return steps, curves
