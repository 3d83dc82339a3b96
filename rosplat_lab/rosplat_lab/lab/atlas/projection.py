"""Where the projection fails: wide views, the near plane, needles, sizes, odd pictures."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from rosplat_core.splats import concatenate
from rosplat_lab.lab import rays
from rosplat_lab.lab.atlas.case import Cases, Curves
from rosplat_lab.lab.atlas.stage import (
    HEIGHT,
    PROCESSOR,
    WIDTH,
    Errors,
    Stage,
    ahead,
    balls,
    cloud,
    decibels,
    floats,
    outside,
    truth,
)
from rosplat_lab.lab.motion import placed

CASES = Cases()


@CASES.enter("Wide fields of view", "angle of view [deg]")
def wide_view(stage: Stage) -> tuple[Sequence[float], Curves]:
    random = np.random.default_rng(0)
    directions = random.normal(size=(150, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    room = replace(
        cloud(150, size=0.5), positions=(directions * random.uniform(2, 4, (150, 1))).astype("f4")
    )
    angles, curves = stage.some([40, 60, 80, 100, 120, 140]), Errors()
    for angle in angles:
        camera = ahead(math.radians(angle))
        expected = truth(room, camera)
        curves.add(stage.both(room, camera, expected))
        exact = rays.picture(room, camera)
        curves.add(iter([("EWA against exact rays", decibels(expected, exact))]))
    return angles, curves


@CASES.enter("Through the near plane", "Near Fade [m]", "largest change of a pixel in 2 cm")
def near_plane(stage: Stage) -> tuple[Sequence[float], Curves]:
    wall = replace(cloud(60, size=0.2), positions=cloud(60).positions * floats(1, 1, 0.3))
    fades, changes = stage.some([0, 0.02, 0.05, 0.1, 0.2, 0.5]), []
    for fade in fades:
        path = [
            np.clip(
                stage.shown(
                    wall, placed(ahead(near=0.1), (0.0, 0.0, float(z))), PROCESSOR, near_fade=fade
                ), 0, 1,
            )
            for z in np.arange(-0.6, 0.6, 0.04 if stage.quick else 0.02)
        ]  # fmt: skip
        worst = max(np.abs(b - a).max() for a, b in pairwise(path))
        changes.append(round(float(worst), 3))
    return fades, {PROCESSOR: changes}


@CASES.enter("Camera inside splats", "standard deviation of the splats [m]")
def inside(stage: Stage) -> tuple[Sequence[float], Curves]:
    sizes, curves = stage.some([0.1, 0.3, 1, 3, 10]), Errors()
    for size in sizes:
        splats = replace(cloud(200, size=size), opacities=cloud(200).opacities * np.float32(0.5))
        camera = placed(ahead(near=0.01), (0.05, 0.0, -0.1))
        curves.add(stage.both(splats, camera, truth(splats, camera)))
    return sizes, curves


@CASES.enter("Needles and discs", "longest over shortest axis")
def shapes(stage: Stage) -> tuple[Sequence[float], Curves]:
    conditions, curves = stage.some([1, 1e2, 1e4, 1e6, 1e8]), Errors()
    for condition in conditions:
        thin = np.where(np.arange(300)[:, None] % 2, [0, 1, 1], [0, 0, 1])  # needles, discs
        scales = np.where(thin, 0.2 / condition, 0.2)
        splats = replace(cloud(300), scales=scales.astype(np.float32))
        curves.add(stage.both(splats, outside(), truth(splats, outside())))
    return conditions, curves


@CASES.enter("Zoomed out: splats smaller than pixels", "times farther away")
def zoomed_out(stage: Stage) -> tuple[Sequence[float], Curves]:
    splats = cloud(1500 if stage.quick else 4000, size=0.02)
    factors, curves = stage.some([1, 2, 4, 8, 16]), Errors()
    finer = 4 if stage.quick else 8
    for factor in factors:
        camera = placed(outside(), outside().position * factor)
        fine = replace(
            camera, width=finer * WIDTH, height=finer * HEIGHT, fx=finer * camera.fx,
            fy=finer * camera.fy, cx=finer * camera.cx, cy=finer * camera.cy,
        )  # fmt: skip
        sharp = truth(replace(splats, antialiased=True), fine)
        expected = sharp.reshape(HEIGHT, finer, WIDTH, finer, 3).mean(axis=(1, 3))
        # Only the part that the scene covers counts: from afar, most is background.
        rows, columns = (np.flatnonzero(expected.max(axis=(axis, 2)) > 0) for axis in (1, 0))
        part = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
        for name, mode in (("As Trained, +0.3 px²", "OFF"), ("Antialiasing: On", "ON")):
            picture = stage.shown(splats, camera, PROCESSOR, antialiasing=mode)
            curves.add(iter([(name, decibels(picture[part], expected[part]))]))
    return factors, curves


@CASES.enter("Huge splats", "standard deviation [m]")
def huge(stage: Stage) -> tuple[Sequence[float], Curves]:
    sizes, curves = stage.some([1, 1e2, 1e4, 1e6, 1e7]), Errors()
    small = cloud(100)
    for size in sizes:
        sky = balls([[-3 * size - 5, 0, 0]], size, 0.9, (0.3, 0.5, 0.9)).with_sh_degree(1)
        both = concatenate([small, sky])
        curves.add(stage.both(both, outside(), truth(both, outside())))
    return sizes, curves


@CASES.enter("Orthographic views", "picture's height [m]")
def orthographic(stage: Stage) -> tuple[Sequence[float], Curves]:
    spans, curves = stage.some([0.1, 1, 10, 100, 1000]), Errors()
    splats = cloud(400)
    for span in spans:
        camera = outside(orthographic=True, fx=HEIGHT / span, fy=HEIGHT / span)
        curves.add(stage.both(splats, camera, truth(splats, camera)))
    return spans, curves


@CASES.enter("Off-centre views, squashed pixels", "axis beside the picture's middle [widths]")
def off_centre(stage: Stage) -> tuple[Sequence[float], Curves]:
    """A sheared frustum, as of stereo and of walls of screens, in pixels of 1:4."""
    shifts, curves = stage.some([0, 0.5, 1, 2, 4]), Errors()
    random = np.random.default_rng(0)
    across = np.column_stack([random.uniform(-6, 2, 3000), random.uniform(-1, 1, (3000, 2))])
    splats = replace(cloud(3000), positions=(across + floats(0, 0, 2)).astype(np.float32))
    splats = splats[np.flatnonzero(splats.positions[:, 2] > 0.9)]
    for shift in shifts:
        camera = ahead()
        camera = replace(camera, cx=camera.cx + shift * camera.width, fy=camera.fy / 4)
        curves.add(stage.both(splats, camera, truth(splats, camera)))
    return shifts, curves
