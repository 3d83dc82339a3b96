"""The atlas of failures: where methods are known to break, and by how much, as difficulty grows."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from rosplat_core import harmonics, rendering
from rosplat_core.cameras import Camera, look_at
from rosplat_core.generated import generate
from rosplat_core.lens_pictures import take_picture
from rosplat_core.lens_warps import Warp
from rosplat_core.lenses import Lens
from rosplat_core.models import Model
from rosplat_core.rendering import CpuRenderer
from rosplat_core.splats import Splats, concatenate
from rosplat_core.view import OVERSCAN
from rosplat_lab import reference
from rosplat_lab.bench import scenes
from rosplat_lab.bench.isolation import isolated
from rosplat_lab.bench.plan import Plan
from rosplat_lab.bench.records import Doing, Event, Measurement
from rosplat_lab.bench.scenes import placed, turned
from rosplat_lab.lab import orders
from rosplat_lab.lab.stage import (
    HEIGHT,
    PROCESSOR,
    SHADERS,
    WIDTH,
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
from rosplat_lab.lab.ways import quantised
from rosplat_lab.reference.rays import along_rays

SOMEWHERE = np.array([0.8, -0.5, 0.3])
COARSE = "linear keys of 16 bits"
SMALL = {"width": 64, "height": 48, "fx": 60.0, "fy": 60.0, "cx": 32.0, "cy": 24.0}

Errors = Iterator[tuple[str, float]]
"""Of each way of drawing, by its name."""
Measure = Callable[[Stage, float], Errors]
"""Returns the errors at a difficulty, on a stage."""


@dataclass(frozen=True)
class Case:
    """A place where methods fail."""

    title: str
    axis: str
    """What the difficulty is."""
    difficulties: Sequence[float]
    """They grow."""
    measure: Measure
    unit: str
    """What the error is in."""


CASES: dict[str, Case] = {}
"""By the names of their functions."""


def measure(plan: Plan) -> Iterator[Event]:
    """The error of every case, by curve and difficulty."""
    from rviz_gaussian_plugin.offscreen import ensure_display

    with ensure_display():
        yield from isolated(_explored, plan.quick)


def _explored(quick: bool) -> Iterator[Event]:
    stage = Stage(quick)
    for number, (name, case) in enumerate(CASES.items()):
        yield Doing(case.title, number / len(CASES))
        for difficulty in stage.some(case.difficulties):
            for curve, error in case.measure(stage, difficulty):
                yield Measurement(
                    name, case.unit, error, gpu=stage.graphics, curve=curve,
                    difficulty=float(difficulty),
                )  # fmt: skip


def case(
    title: str, axis: str, difficulties: Sequence[float], unit: str = "dB"
) -> Callable[[Measure], Measure]:
    """Enters the function that it decorates into CASES."""

    def enter(measure: Measure) -> Measure:
        CASES[measure.__name__] = Case(title, axis, difficulties, measure, unit)
        return measure

    return enter


# --- The projection: wide views, the near plane, needles, sizes, odd pictures ---------------------


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


@case("Wide fields of view", "angle of view [deg]", [40, 60, 80, 100, 120, 140])
def wide_view(stage: Stage, angle: float) -> Errors:
    room, camera = all_around(), ahead(math.radians(angle))
    expected = truth(room, camera)
    yield from stage.both(room, camera, expected)
    by_rays = truth(replace(room, model=Model.RAY), camera)
    yield "EWA against exact rays", decibels(expected, by_rays)
    yield from by_models(stage, room, camera)


@case("Fisheyes", "angle of view, corner to corner [deg]", [60, 120, 180, 240, 300])
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


@case(
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


@case("Camera inside splats", "standard deviation of the splats [m]", [0.1, 0.3, 1, 3, 10])
def inside(stage: Stage, size: float) -> Errors:
    splats = replace(cloud(200, size=size), opacities=cloud(200).opacities * np.float32(0.5))
    camera = placed(ahead(near=0.01), (0.05, 0.0, -0.1))
    yield from stage.both(splats, camera, truth(splats, camera))
    yield from by_models(stage, splats, camera)


@case("Needles and discs", "longest over shortest axis", [1, 1e2, 1e4, 1e6, 1e8])
def shapes(stage: Stage, condition: float) -> Errors:
    thin = np.where(np.arange(300)[:, None] % 2, [0, 1, 1], [0, 0, 1])  # needles, discs
    scales = np.where(thin, 0.2 / condition, 0.2)
    splats = replace(cloud(300), scales=scales.astype(np.float32))
    yield from stage.both(splats, outside(), truth(splats, outside()))


@case("Zoomed out: splats smaller than pixels", "times farther away", [1, 2, 4, 8, 16])
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


@case("Huge splats", "standard deviation [m]", [1, 1e2, 1e4, 1e6, 1e7])
def huge(stage: Stage, size: float) -> Errors:
    sky = balls([[-3 * size - 5, 0, 0]], size, 0.9, (0.3, 0.5, 0.9)).with_sh_degree(1)
    both = concatenate([cloud(100), sky])
    yield from stage.both(both, outside(), truth(both, outside()))


@case("Orthographic views", "picture's height [m]", [0.1, 1, 10, 100, 1000])
def orthographic(stage: Stage, span: float) -> Errors:
    splats = cloud(400)
    camera = outside(orthographic=True, fx=HEIGHT / span, fy=HEIGHT / span)
    yield from stage.both(splats, camera, truth(splats, camera))


@case(
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


# --- Numbers: far from the origin, in other units -------------------------------------------------


@case("Far from the origin", "offset [m]", [0, 1e3, 1e4, 1e5, 1e6, 1e7])
def far_away(stage: Stage, offset: float) -> Errors:
    splats = cloud(400)
    there = offset * SOMEWHERE
    camera = outside(world_to_camera=look_at(there + outside().position, there))
    rebased = replace(splats, origin=there)
    expected = truth(rebased, camera)
    yield from stage.both(rebased, camera, expected)
    naive = replace(splats, positions=(splats.positions + there).astype(np.float32))
    yield "without an origin", decibels(stage.shown(naive, camera, PROCESSOR), expected)


@case(
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


@case(
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


# --- Orders: coarse keys, an order of some time ago, popping --------------------------------------


@case("A far outlier", "its distance over the scene's", [1, 10, 1e2, 1e4, 1e6])
def outliers(stage: Stage, ratio: float) -> Errors:
    camera = outside()
    stray = balls([-ratio * camera.position], 0.01 * ratio, 0.5, 1)
    splats = concatenate([cloud(3000, size=0.1), stray.with_sh_degree(1)])
    yield from _also_coarse(stage, splats, camera)


@case("Millimetres to kilometres in one view", "farthest over nearest", [10, 1e3, 1e5, 1e7])
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


@case("An order from before a turn", "degrees since it was sorted", [0, 0.3, 1, 3, 10, 30])
def old_order(stage: Stage, angle: float) -> Errors:
    """Old orders that were culled for their own view, and for a wider one as by sorters."""
    splats, camera, expected = _garden(stage.quick, "inside", 1)
    past = turned(camera, -math.radians(angle))
    for name, factor in (("culled for its view", 1 / OVERSCAN), ("as sorters cull", 1.0)):
        order = orders.Sorter(splats).order(_widened(past, factor))
        yield name, decibels(stage.shown(splats, camera, SHADERS, order), expected)


def _widened(camera: Camera, factor: float) -> Camera:
    """The camera with a picture so many times as wide and high, around the same middle."""
    width, height = round(factor * camera.width), round(factor * camera.height)
    return replace(
        camera, width=width, height=height, cx=camera.cx + (width - camera.width) / 2,
        cy=camera.cy + (height - camera.height) / 2,
    )  # fmt: skip


@case(
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


# --- Blending: many layers, faint ones, bright ones, translucent objects between them -------------


@case("Layers of fog", "layers", [10, 100, 1000, 10_000])
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


@case("Faint splats and the cut at 1/255", "peak opacity", [0.003, 0.006, 0.01, 0.03, 0.1, 0.3])
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


@case("Harmonics that overshoot", "amplitude of the bands above 0", [0, 0.1, 0.3, 1, 3, 10])
def overshoot(stage: Stage, amplitude: float) -> Errors:
    splats = cloud(400, degree=3)
    splats.sh[:, 1:] *= np.float32(amplitude / 0.3)
    yield from stage.both(splats, outside(), truth(splats, outside()))


@case(
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


# --- Less of a map: levels of detail, quantised maps ----------------------------------------------


@case("Levels of detail", "Detail [px]", [1, 2, 4, 8, 16])
def levels(stage: Stage, error: float) -> Errors:
    for view in ("overview", "inside"):
        for by, found in stage.both(*_garden(stage.quick, view, 2), detail=f"{error:g}px"):
            yield f"{by}, {view}", found


@case(
    "A quantised map with a stray splat", "its distance over the scene's", [1, 1e2, 1e4, 1e5, 1e6]
)
def stray(stage: Stage, ratio: float) -> Errors:
    """Steps of positions divide a batch's box. If too coarse, the batch is sent unquantised."""
    camera = outside()
    far = balls([-ratio * camera.position], 0.01, 0.5, 1).with_sh_degree(1)
    splats = concatenate([cloud(3000, size=0.1), far])
    expected = truth(splats, camera)
    for name, always in (("compression: quantised", False), ("always quantised", True)):
        sent = quantised(splats, always)
        yield name, decibels(stage.shown(sent, camera, PROCESSOR), expected)


@cache
def _garden(quick: bool, view: str, larger: int) -> tuple[Splats, Camera, Image]:
    """A garden, a view of it, so many times as wide and high, and its true picture."""
    splats = generate(5_000 if quick else 40_000)
    camera = scenes.VIEWS[view](splats, larger * WIDTH, larger * HEIGHT, 1)[0]
    return splats, camera, truth(splats, camera)
