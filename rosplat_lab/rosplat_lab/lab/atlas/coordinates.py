"""Where numbers fail: far from the origin, in other units."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from rosplat_core import harmonics, rendering
from rosplat_core.cameras import look_at
from rosplat_lab.lab.atlas.case import Cases, Errors
from rosplat_lab.lab.atlas.stage import (
    PROCESSOR,
    Stage,
    cloud,
    decibels,
    floats,
    outside,
    truth,
)
from rosplat_lab.lab.motion import placed

CASES = Cases()
SOMEWHERE = np.array([0.8, -0.5, 0.3])


@CASES.enter("Far from the origin", "offset [m]", [0, 1e3, 1e4, 1e5, 1e6, 1e7])
def far_away(stage: Stage, offset: float) -> Errors:
    splats = cloud(400)
    there = offset * SOMEWHERE
    camera = outside(world_to_camera=look_at(there + outside().position, there))
    rebased = replace(splats, origin=there)
    expected = truth(rebased, camera)
    yield from stage.both(rebased, camera, expected)
    naive = replace(splats, positions=(splats.positions + there).astype(np.float32))
    yield "without an origin", decibels(stage.shown(naive, camera, PROCESSOR), expected)


@CASES.enter(
    "Submaps far from the origin", "offset of the submap's pose [m]", [0, 1e3, 1e4, 1e5, 1e6, 1e7]
)
def submaps(stage: Stage, offset: float) -> Errors:
    """Splats near their own origin, moved by a pose, as a loop closure moves a submap."""
    splats = cloud(400)
    there = offset * SOMEWHERE
    camera = outside(world_to_camera=look_at(there + outside().position, there))
    expected = truth(replace(splats, origin=there), camera)
    renderer = rendering.CpuRenderer(splats)
    rendering.move(renderer, {0: (*there, 0, 0, 0, 1)}, 2)
    yield PROCESSOR, decibels(renderer.render(camera)[..., :3], expected)


@CASES.enter(
    "The same scene in other units, mirrored",
    "scale of scene and camera",
    [1e-6, 1e-3, 1, 1e3, 1e6],
)
def scaled(stage: Stage, factor: float) -> Errors:
    splats, mirror = cloud(400), floats(-1, 1, 1)
    signs = np.sign(_mirrored_harmonics())
    # Mirrored in x: a quaternion's y and z turn round, harmonics odd in x change sign.
    flipped = replace(
        splats,
        positions=splats.positions * np.float32(factor) * mirror,
        scales=splats.scales * np.float32(factor),
        orientations=splats.orientations * floats(1, -1, -1, 1),
        sh=splats.sh * signs[None, : splats.sh.shape[1], None].astype(np.float32),
    )
    camera = replace(placed(outside(), outside().position * factor), near=0.01 * factor)
    facing = replace(camera, world_to_camera=look_at(camera.position * mirror, (0, 0, 0)))
    yield from stage.both(flipped, facing, truth(splats, outside())[:, ::-1])


def _mirrored_harmonics() -> NDArray[np.float64]:
    """(16,) 1 for harmonics even in x, -1 for odd ones."""
    direction = np.array([[0.3, 0.5, 0.81]])
    mirrored = direction * (-1, 1, 1)
    signs: NDArray[np.float64] = harmonics.basis(mirrored, 3)[0] / harmonics.basis(direction, 3)[0]
    return signs
