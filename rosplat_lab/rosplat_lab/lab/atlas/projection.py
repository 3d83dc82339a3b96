"""Where the projection fails: wide views, the near plane, needles, sizes, odd pictures."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np

from rosplat_core.cameras import Camera
from rosplat_core.lens_pictures import take_picture
from rosplat_core.lens_warps import Warp
from rosplat_core.lenses import Lens
from rosplat_core.models import Model
from rosplat_core.rendering import CpuRenderer
from rosplat_core.splats import Splats, concatenate
from rosplat_lab import reference
from rosplat_lab.lab.atlas.case import Cases, Errors
from rosplat_lab.lab.atlas.stage import (
    HEIGHT,
    PROCESSOR,
    WIDTH,
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
from rosplat_lab.reference.rays import along_rays

CASES = Cases()


def by_models(stage: Stage, splats: Splats, camera: Camera) -> Errors:
    """The processor's PSNR, as rays and as discs. [dB]"""
    for model in (Model.RAY, Model.DISC):
        of_model = replace(splats, model=model)
        picture = stage.shown(of_model, camera, PROCESSOR)
        yield f"{PROCESSOR}, {model}", decibels(picture, truth(of_model, camera))


def all_around() -> Splats:
    """Splats on all sides of the origin."""
    random = np.random.default_rng(0)
    directions = random.normal(size=(150, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    positions = directions * random.uniform(2, 4, (150, 1))
    return replace(cloud(150, size=0.5), positions=positions.astype("f4"))


@CASES.enter("Wide fields of view", "angle of view [deg]", [40, 60, 80, 100, 120, 140])
def wide_view(stage: Stage, angle: float) -> Errors:
    room, camera = all_around(), ahead(math.radians(angle))
    expected = truth(room, camera)
    yield from stage.both(room, camera, expected)
    by_rays = truth(replace(room, model=Model.RAY), camera)
    yield "EWA against exact rays", decibels(expected, by_rays)
    yield from by_models(stage, room, camera)


@CASES.enter("Fisheyes", "angle of view, corner to corner [deg]", [60, 120, 180, 240, 300])
def fisheye(stage: Stage, angle: float) -> Errors:
    room, focal, middle = all_around(), WIDTH * math.sqrt(2) / math.radians(angle), WIDTH / 2
    lens = Lens(WIDTH, WIDTH, focal, focal, middle - 0.5, middle - 0.5, "equidistant")
    camera = Camera(0, WIDTH, WIDTH, focal, focal, middle, middle, np.eye(4))
    rows, columns = np.mgrid[:WIDTH, :WIDTH]
    rays = lens.rays(np.stack([columns, rows], axis=-1))
    behind = angle > 180
    truths = {
        Model.EWA: reference.render(room, camera, lens=lens, by_distance=behind).rgba,
        Model.RAY: along_rays(replace(room, model=Model.RAY), np.eye(4), rays, behind=behind)[0],
    }
    for model, expected in truths.items():
        taken = take_picture(CpuRenderer(replace(room, model=model)), Warp(lens), np.eye(4))
        yield f"{PROCESSOR}, {model}", decibels(taken.colour, expected[..., :3])
    ellipses, exact = (expected[..., :3] for expected in truths.values())
    yield "EWA against exact rays", decibels(ellipses, exact)


@CASES.enter(
    "Through the near plane",
    "Near Fade [m]",
    [0, 0.02, 0.05, 0.1, 0.2, 0.5],
    unit="largest change of a pixel in 2 cm",
)
def near_plane(stage: Stage, fade: float) -> Errors:
    wall = replace(cloud(60, size=0.2), positions=cloud(60).positions * floats(1, 1, 0.3))
    cameras = [
        placed(ahead(near=0.1), (0.0, 0.0, float(z)))
        for z in np.arange(-0.6, 0.6, 0.04 if stage.quick else 0.02)
    ]
    path = [
        np.clip(stage.shown(wall, camera, PROCESSOR, near_fade=fade), 0, 1) for camera in cameras
    ]
    worst = max(np.abs(b - a).max() for a, b in pairwise(path))
    yield PROCESSOR, round(float(worst), 3)


@CASES.enter("Camera inside splats", "standard deviation of the splats [m]", [0.1, 0.3, 1, 3, 10])
def inside(stage: Stage, size: float) -> Errors:
    splats = replace(cloud(200, size=size), opacities=cloud(200).opacities * np.float32(0.5))
    camera = placed(ahead(near=0.01), (0.05, 0.0, -0.1))
    yield from stage.both(splats, camera, truth(splats, camera))
    yield from by_models(stage, splats, camera)


@CASES.enter("Needles and discs", "longest over shortest axis", [1, 1e2, 1e4, 1e6, 1e8])
def shapes(stage: Stage, condition: float) -> Errors:
    thin = np.where(np.arange(300)[:, None] % 2, [0, 1, 1], [0, 0, 1])  # needles, discs
    scales = np.where(thin, 0.2 / condition, 0.2)
    splats = replace(cloud(300), scales=scales.astype(np.float32))
    yield from stage.both(splats, outside(), truth(splats, outside()))


@CASES.enter("Zoomed out: splats smaller than pixels", "times farther away", [1, 2, 4, 8, 16])
def zoomed_out(stage: Stage, factor: float) -> Errors:
    splats = cloud(1500 if stage.quick else 4000, size=0.02)
    finer = 4 if stage.quick else 8
    camera = placed(outside(), outside().position * factor)
    fine = replace(
        camera, width=finer * WIDTH, height=finer * HEIGHT, fx=finer * camera.fx,
        fy=finer * camera.fy, cx=finer * camera.cx, cy=finer * camera.cy,
    )  # fmt: skip
    sharp = truth(replace(splats, model=Model.EWA_ANTIALIASED), fine)
    expected = sharp.reshape(HEIGHT, finer, WIDTH, finer, 3).mean(axis=(1, 3))
    # Only the part that the scene covers counts: from afar, most is background.
    rows, columns = (np.flatnonzero(expected.max(axis=(axis, 2)) > 0) for axis in (1, 0))
    part = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    for name, mode in (("EWA, +0.3 px²", Model.EWA), ("EWA Antialiased", Model.EWA_ANTIALIASED)):
        picture = stage.shown(splats, camera, PROCESSOR, model=mode)
        yield name, decibels(picture[part], expected[part])


@CASES.enter("Huge splats", "standard deviation [m]", [1, 1e2, 1e4, 1e6, 1e7])
def huge(stage: Stage, size: float) -> Errors:
    sky = balls([[-3 * size - 5, 0, 0]], size, 0.9, (0.3, 0.5, 0.9)).with_sh_degree(1)
    both = concatenate([cloud(100), sky])
    yield from stage.both(both, outside(), truth(both, outside()))


@CASES.enter("Orthographic views", "picture's height [m]", [0.1, 1, 10, 100, 1000])
def orthographic(stage: Stage, span: float) -> Errors:
    splats = cloud(400)
    camera = outside(orthographic=True, fx=HEIGHT / span, fy=HEIGHT / span)
    yield from stage.both(splats, camera, truth(splats, camera))


@CASES.enter(
    "Off-centre views, squashed pixels",
    "axis beside the picture's middle [widths]",
    [0, 0.5, 1, 2, 4],
)
def off_centre(stage: Stage, shift: float) -> Errors:
    """A sheared frustum, as of stereo and of walls of screens, in pixels of 1:4."""
    random = np.random.default_rng(0)
    across = np.column_stack([random.uniform(-6, 2, 3000), random.uniform(-1, 1, (3000, 2))])
    splats = replace(cloud(3000), positions=(across + floats(0, 0, 2)).astype(np.float32))
    splats = splats[np.flatnonzero(splats.positions[:, 2] > 0.9)]
    camera = ahead()
    camera = replace(camera, cx=camera.cx + shift * camera.width, fy=camera.fy / 4)
    yield from stage.both(splats, camera, truth(splats, camera))
