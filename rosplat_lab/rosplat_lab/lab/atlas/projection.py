"""Where the projection fails: wide views, the near plane, needles, sizes, odd pictures."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rosplat_core.splats import concatenate
from rosplat_lab.lab import fragments, motion, rays
from rosplat_lab.lab.atlas.case import Cases, Curves
from rosplat_lab.lab.atlas.stage import (
    HEIGHT,
    WIDTH,
    ahead,
    balls,
    cloud,
    decibels,
    floats,
    ordered,
    outside,
    shown,
    some,
    truth,
)
from rosplat_lab.lab.bench import Bench

CASES = Cases()


@CASES.enter("Wide fields of view", "angle of view [deg]")
def wide_view(bench: Bench, quick: bool) -> tuple[Sequence[float], Curves]:
    random = np.random.default_rng(0)
    directions = random.normal(size=(150, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    room = replace(
        cloud(150, size=0.5), positions=(directions * random.uniform(2, 4, (150, 1))).astype("f4")
    )
    angles = some([40, 60, 80, 100, 120, 140], quick)
    curves: Curves = {"ours against EWA in float64": [], "EWA against exact rays": []}
    for angle in angles:
        camera = ahead(math.radians(angle))
        expected = truth(room, camera)
        curves["ours against EWA in float64"].append(decibels(shown(bench, room, camera), expected))
        curves["EWA against exact rays"].append(decibels(expected, rays.picture(room, camera)))
    return angles, curves


@CASES.enter(
    "Through the near plane", "Near Fade [m]", "largest change of a pixel in a step of 2 cm"
)
def near_plane(bench: Bench, quick: bool) -> tuple[Sequence[float], Curves]:
    wall = replace(cloud(60, size=0.2), positions=cloud(60).positions * floats(1, 1, 0.3))
    fades = some([0, 0.02, 0.05, 0.1, 0.2, 0.5], quick)
    curves: Curves = {"flying through splats": []}
    steps = np.arange(-0.3 if quick else -0.6, 0.3 if quick else 0.6, 0.02)
    for fade in fades:
        worst, last = 0.0, None
        for z in steps:
            camera = motion.placed(ahead(near=0.1), (0.0, 0.0, float(z)))
            picture = shown(bench, wall, camera, near_fade=fade)
            if last is not None:
                worst = max(worst, float(np.abs(np.clip(picture, 0, 1) - last).max()))
            last = np.clip(picture, 0, 1)
        curves["flying through splats"].append(round(worst, 3))
    return fades, curves


@CASES.enter("Camera inside splats", "standard deviation of the splats [m]")
def inside(bench: Bench, quick: bool) -> tuple[Sequence[float], Curves]:
    sizes = some([0.1, 0.3, 1, 3, 10], quick)
    curves: Curves = {"ours, 32F": [], "ours, 16F": []}
    for size in sizes:
        splats = replace(cloud(200, size=size), opacities=cloud(200).opacities * np.float32(0.5))
        camera = motion.placed(ahead(near=0.01), (0.05, 0.0, -0.1))
        expected = truth(splats, camera)
        curves["ours, 32F"].append(decibels(shown(bench, splats, camera), expected))
        blended = shown(bench, splats, camera, float_blending=False)
        curves["ours, 16F"].append(decibels(blended, expected))
    return sizes, curves


@CASES.enter("Needles and discs", "longest over shortest axis")
def shapes(bench: Bench, quick: bool) -> tuple[Sequence[float], Curves]:
    conditions = some([10.0**k for k in range(9)], quick)
    curves: Curves = {"needles": [], "discs": []}
    for condition in conditions:
        for name, thin in (("needles", [False, True, True]), ("discs", [False, False, True])):
            scales = np.where(thin, 0.2 / condition, 0.2) * np.ones((300, 3))
            splats = replace(cloud(300), scales=scales.astype(np.float32))
            curves[name].append(decibels(shown(bench, splats, outside()), truth(splats, outside())))
    return conditions, curves


@CASES.enter("Zoomed out: splats smaller than pixels", "times farther away")
def zoomed_out(bench: Bench, quick: bool) -> tuple[Sequence[float], Curves]:
    from rosplat_core.rendering import Antialiasing

    splats = cloud(4000 if not quick else 1500, size=0.02)
    factors = some([1, 2, 4, 8, 16], quick)
    curves: Curves = {"as trained, +0.3 px²": [], "Antialiasing on": []}
    finer = 4 if quick else 8
    for factor in factors:
        camera = motion.placed(outside(), outside().position * factor)
        fine = replace(
            camera, width=finer * WIDTH, height=finer * HEIGHT, fx=finer * camera.fx,
            fy=finer * camera.fy, cx=finer * camera.cx, cy=finer * camera.cy,
        )  # fmt: skip
        sharp = fragments.picture(replace(splats, antialiased=True), fine, fragments.over)
        expected = sharp.reshape(HEIGHT, finer, WIDTH, finer, 3).mean(axis=(1, 3))
        # Only what the scene covers counts, or far away the background would.
        rows, columns = (np.flatnonzero(expected.max(axis=(axis, 2)) > 0) for axis in (1, 0))
        part = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
        for name, mode in (("as trained, +0.3 px²", "OFF"), ("Antialiasing on", "ON")):
            picture = shown(bench, splats, camera, antialiasing=getattr(Antialiasing, mode))
            curves[name].append(decibels(picture[part], expected[part]))
    return factors, curves


@CASES.enter("Huge splats", "standard deviation [m]")
def huge(bench: Bench, quick: bool) -> tuple[Sequence[float], Curves]:
    sizes = some([10.0**k for k in range(8)], quick)
    curves: Curves = {"one behind a cloud": []}
    small = cloud(100)
    for size in sizes:
        sky = balls([[-3 * size - 5, 0, 0]], size, 0.9, (0.3, 0.5, 0.9)).with_sh_degree(1)
        both = concatenate([small, sky])
        curves["one behind a cloud"].append(
            decibels(shown(bench, both, outside()), truth(both, outside()))
        )
    return sizes, curves


@CASES.enter("Orthographic views", "picture's height [m]")
def orthographic(bench: Bench, quick: bool) -> tuple[Sequence[float], Curves]:
    spans = some([0.1, 1, 10, 100, 1000], quick)
    splats = cloud(400)
    curves: Curves = {"ours": []}
    for span in spans:
        camera = outside(orthographic=True, fx=HEIGHT / span, fy=HEIGHT / span)
        curves["ours"].append(decibels(shown(bench, splats, camera), truth(splats, camera)))
    return spans, curves


@CASES.enter("Viewports, resized between order and picture", "width and height [px]")
def viewports(bench: Bench, quick: bool) -> tuple[Sequence[float], Curves]:
    sizes = [1, 17, 333] if quick else [1, 2, 3, 17, 64, 333, 1024]
    splats = cloud(400)
    curves: Curves = {"ours, resized each time": [], "the order of another size": []}
    for side in map(int, sizes):
        camera = replace(
            outside(), width=side, height=side, fx=side * 0.8, fy=side * 0.8,
            cx=side / 2, cy=side / 2,
        )  # fmt: skip
        curves["ours, resized each time"].append(
            decibels(shown(bench, splats, camera), truth(splats, camera))
        )
        before = replace(camera, width=max(1, side // 2), cx=max(1, side // 2) / 2)
        late = ordered(bench, splats, camera, bench.order(before))
        curves["the order of another size"].append(decibels(late, truth(splats, camera)))
    return sizes, curves


@CASES.enter(
    "Off-centre pictures: stereo, tiles of a wall", "axis beside the picture's middle [widths]"
)
def off_centre(bench: Bench, quick: bool) -> tuple[Sequence[float], Curves]:
    """A sheared frustum: the same view direction, another part of the picture plane."""
    shifts = some([0, 0.5, 1, 2, 4], quick)
    random = np.random.default_rng(0)
    across = np.column_stack([random.uniform(-6, 2, 3000), random.uniform(-1, 1, (3000, 2))])
    splats = replace(cloud(3000), positions=(across + floats(0, 0, 2)).astype(np.float32))
    splats = splats[np.flatnonzero(splats.positions[:, 2] > 0.9)]
    curves: Curves = {"ours": [], "ours in squashed pixels, 1:4": []}
    for shift in shifts:
        camera = ahead()
        camera = replace(camera, cx=camera.cx + shift * camera.width)
        curves["ours"].append(decibels(shown(bench, splats, camera), truth(splats, camera)))
        squashed = replace(camera, fy=camera.fy / 4)
        curves["ours in squashed pixels, 1:4"].append(
            decibels(shown(bench, splats, squashed), truth(splats, squashed))
        )
    return shifts, curves
