"""Where less of a map fails: levels of detail, quantised maps."""

from __future__ import annotations

from functools import cache

import numpy as np

from rosplat_core.cameras import Camera
from rosplat_core.generated import generate
from rosplat_core.payload import decode, encode
from rosplat_core.splats import Splats, concatenate
from rosplat_lab.bench import scenes
from rosplat_lab.lab.atlas.case import Cases, Errors
from rosplat_lab.lab.atlas.stage import (
    HEIGHT,
    PROCESSOR,
    WIDTH,
    Image,
    Stage,
    balls,
    cloud,
    decibels,
    outside,
    truth,
)
from rosplat_lab.lab.ways import arrays_of, joined, quantised

CASES = Cases()


@CASES.enter("Levels of detail", "Detail [px]", [1, 2, 4, 8, 16])
def levels(stage: Stage, error: float) -> Errors:
    for view in ("overview", "inside"):
        for by, found in stage.both(*_garden(stage.quick, view), detail=f"{error:g}px"):
            yield f"{by}, {view}", found


@cache
def _garden(quick: bool, view: str) -> tuple[Splats, Camera, Image]:
    """A garden, a view of it, and its true picture."""
    splats = generate(5_000 if quick else 40_000)
    camera = scenes.VIEWS[view](splats, 2 * WIDTH, 2 * HEIGHT, 1)[0]
    return splats, camera, truth(splats, camera)


@CASES.enter(
    "A quantised map with a stray splat", "its distance over the scene's", [1, 1e2, 1e4, 1e5, 1e6]
)
def stray(stage: Stage, ratio: float) -> Errors:
    """Steps of positions divide a batch's box. If too coarse, the batch is sent unquantised."""
    camera = outside()
    far = balls([-ratio * camera.position], 0.01, 0.5, 1).with_sh_degree(1)
    splats = concatenate([cloud(3000, size=0.1), far])
    expected = truth(splats, camera)
    for name, way in (("compression: quantised", quantised), ("always quantised", _always)):
        yield name, decibels(stage.shown(way(splats), camera, PROCESSOR), expected)


def _always(splats: Splats) -> Splats:
    count = len(splats)
    sent = encode(arrays_of(splats, slice(0, count)), np.ones(count, bool))
    return joined(splats, [decode(sent, count, splats.sh_degree)])
