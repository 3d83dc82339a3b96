"""Where orders fail: coarse keys, an order of some time ago, popping."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np

from rosplat_core.cameras import Camera
from rosplat_core.generated import generate
from rosplat_core.splats import Splats, concatenate
from rosplat_core.view import OVERSCAN
from rosplat_lab.bench import scenes
from rosplat_lab.lab import orders
from rosplat_lab.lab.atlas.case import Cases, Errors
from rosplat_lab.lab.atlas.stage import (
    HEIGHT,
    SHADERS,
    WIDTH,
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


@CASES.enter("A far outlier", "its distance over the scene's", [1, 10, 1e2, 1e4, 1e6])
def outliers(stage: Stage, ratio: float) -> Errors:
    camera = outside()
    stray = balls([-ratio * camera.position], 0.01 * ratio, 0.5, 1)
    splats = concatenate([cloud(3000, size=0.1), stray.with_sh_degree(1)])
    yield from _also_coarse(stage, splats, camera)


@CASES.enter("Millimetres to kilometres in one view", "farthest over nearest", [10, 1e3, 1e5, 1e7])
def depth_range(stage: Stage, ratio: float) -> Errors:
    random = np.random.default_rng(0)
    z = 0.02 * np.exp(random.uniform(0, math.log(ratio), 3000))
    base = cloud(3000)
    spread = np.column_stack([random.uniform(-0.5, 0.5, (3000, 2)), np.ones(3000)])
    splats = replace(
        base,
        positions=(spread * z[:, None]).astype(np.float32),
        scales=(base.scales * 0.5 * z[:, None]).astype(np.float32),
    )
    yield from _also_coarse(stage, splats, ahead(near=0.01))


def _also_coarse(stage: Stage, splats: Splats, camera: Camera) -> Errors:
    """The errors of both ways of drawing, and of an order by coarse keys."""
    expected = truth(splats, camera)
    yield from stage.both(splats, camera, expected)
    order = orders.Sorter(splats).keyed(camera, orders.linear(16))
    yield COARSE, decibels(stage.shown(splats, camera, SHADERS, order), expected)


@CASES.enter("An order from before a turn", "degrees since it was sorted", [0, 0.3, 1, 3, 10, 30])
def old_order(stage: Stage, angle: float) -> Errors:
    """Old orders that were culled for their own view, and for a wider one as by sorters."""
    splats, camera, expected = _garden(stage.quick)
    past = turned(camera, -math.radians(angle))
    for name, factor in (("culled for its view", 1 / OVERSCAN), ("as sorters cull", 1.0)):
        order = orders.Sorter(splats).order(_widened(past, factor))
        yield name, decibels(stage.shown(splats, camera, SHADERS, order), expected)


@cache
def _garden(quick: bool) -> tuple[Splats, Camera, Image]:
    """A garden, a view within it, and its true picture."""
    splats = generate(5_000 if quick else 40_000)
    camera = scenes.inside(splats, WIDTH, HEIGHT, 1)[0]
    return splats, camera, truth(splats, camera)


def _widened(camera: Camera, factor: float) -> Camera:
    """The camera with a picture so many times as wide and high, around the same middle."""
    width, height = round(factor * camera.width), round(factor * camera.height)
    return replace(
        camera, width=width, height=height, cx=camera.cx + (width - camera.width) / 2,
        cy=camera.cy + (height - camera.height) / 2,
    )  # fmt: skip


@CASES.enter(
    "Popping under slow rotation",
    "degrees a frame",
    [0.1, 0.3, 1, 3],
    unit="largest change of a pixel",
)
def popping(stage: Stage, step: float) -> Errors:
    """How much the order alone changes a frame: drawn in its own, and in the last frame's."""
    splats = cloud(800, size=0.3)
    sorter = orders.Sorter(splats)
    cameras = [turned(outside(), math.radians(step * n)) for n in range(3 if stage.quick else 6)]
    kept = [sorter.order(camera) for camera in cameras]
    worst = 0.0
    for before, now, camera in zip(kept, kept[1:], cameras[1:], strict=False):
        late, same = (
            stage.shown(splats, camera, SHADERS, order[np.isin(order, other)])
            for order, other in ((before, now), (now, before))
        )
        worst = max(worst, float(np.abs(late - same).max()))
    yield "sorted by z, as trained", round(worst, 4)
