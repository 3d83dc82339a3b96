"""Where less of a map fails: levels of detail, quantised maps."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rosplat_core.generated import generate
from rosplat_core.payload import decode, encode
from rosplat_core.splats import Splats, concatenate
from rosplat_lab.bench import scenes
from rosplat_lab.lab.atlas.case import Cases, Curves
from rosplat_lab.lab.atlas.stage import (
    HEIGHT,
    PROCESSOR,
    WIDTH,
    Errors,
    Stage,
    balls,
    cloud,
    decibels,
    outside,
    truth,
)
from rosplat_lab.lab.ways import arrays_of, joined, quantised

CASES = Cases()


@CASES.enter("Levels of detail", "Detail [px]")
def levels(stage: Stage) -> tuple[Sequence[float], Curves]:
    errors, curves = stage.some([1, 2, 4, 8, 16]), Errors()
    splats = generate(5_000 if stage.quick else 40_000)
    for view in (scenes.overview, scenes.inside):
        camera = view(splats, 2 * WIDTH, 2 * HEIGHT, 1)[0]
        expected = truth(splats, camera)
        for error in errors:
            both = stage.both(splats, camera, expected, detail=f"{error:g}px")
            curves.add(both, f", {view.__name__}")
    return errors, curves


@CASES.enter("A quantised map with a stray splat", "its distance over the scene's")
def stray(stage: Stage) -> tuple[Sequence[float], Curves]:
    """Steps of positions divide a batch's box. If too coarse, the batch is sent unquantised."""
    ratios, curves = stage.some([1, 1e2, 1e4, 1e5, 1e6]), Errors()
    camera = outside()
    for ratio in ratios:
        far = balls([-ratio * camera.position], 0.01, 0.5, 1).with_sh_degree(1)
        splats = concatenate([cloud(3000, size=0.1), far])
        expected = truth(splats, camera)
        for name, way in (("compression: quantised", quantised), ("always quantised", _always)):
            drawn = stage.shown(way(splats), camera, PROCESSOR)
            curves.add(iter([(name, decibels(drawn, expected))]))
    return ratios, curves


def _always(splats: Splats) -> Splats:
    count = len(splats)
    sent = encode(arrays_of(splats, slice(0, count)), np.ones(count, bool))
    return joined(splats, [decode(sent, count, splats.sh_degree)])
