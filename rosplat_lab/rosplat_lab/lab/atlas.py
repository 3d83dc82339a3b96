"""The atlas of failures: where methods are known to break, and by how much, as difficulty grows."""

from __future__ import annotations

import json
import math
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from rosplat_lab import reference
from rosplat_lab.lab import fragments, motion, orders, rays
from rosplat_lab.lab.bench import SOURCE, VIEW_ID, Bench, Image
from rosplat_lab.lab.methods import widened
from rosplat_lab.lab.orders import Order
from rosplat_lab.lab.progress import progress
from rosplat_lab.metrics import MOST_PSNR, psnr
from rosplat_lab.reference.projection import rotation_matrices
from rosplat_sorter.view import OVERSCAN
from rosplat_tools import harmonics
from rosplat_tools.cameras import Camera, look_at
from rosplat_tools.files import write_text
from rosplat_tools.generate import generate
from rosplat_tools.splats import Splats, concatenate
from rviz_gaussian_plugin.offscreen import OrderSource

Curves = dict[str, list[float]]
WIDTH, HEIGHT = 192, 128
UPSERT = 1


@dataclass(frozen=True)
class Finding:
    """Error as a difficulty grows, for each method."""

    name: str
    title: str
    axis: str
    """What the difficulty is."""
    unit: str
    """What the error is in."""
    xs: list[float]
    curves: Curves


@dataclass(frozen=True)
class Case:
    """A place where methods fail."""

    title: str
    axis: str
    measure: Callable[[Bench, bool], tuple[Sequence[float], Curves]]
    unit: str = "PSNR [dB]"


CASES: dict[str, Case] = {}


def case(title: str, axis: str, unit: str = "PSNR [dB]") -> Callable[[Any], Any]:
    """Enters a function of a bench and of whether to be quick into the atlas."""

    def enter(measure: Any) -> Any:
        CASES[measure.__name__] = Case(title, axis, measure, unit)
        return measure

    return enter


def explore(bench: Bench, quick: bool, names: Sequence[str] = ()) -> list[Finding]:
    """What all cases find, or those of some names."""
    findings = []
    with progress("atlas", len(names or CASES), "case") as done:
        for name in names or CASES:
            entry = CASES[name]
            if done.disable:  # no terminal
                print(f"atlas: {entry.title}", file=sys.stderr, flush=True)
            xs, curves = entry.measure(bench, quick)
            findings.append(
                Finding(name, entry.title, entry.axis, entry.unit, [float(x) for x in xs], curves)
            )
            done.update()
    return findings


# --- Scenes, cameras, errors ----------------------------------------------------------------------


def cloud(count: int, seed: int = 0, size: float = 0.15, degree: int = 1) -> Splats:
    """Splats of all shapes and opacities in a ball of about a metre."""
    random = np.random.default_rng(seed)
    turns = random.normal(size=(count, 4))
    return Splats(
        positions=random.normal(scale=0.4, size=(count, 3)).astype(np.float32),
        orientations=(turns / np.linalg.norm(turns, axis=1, keepdims=True)).astype(np.float32),
        scales=(size * random.uniform(0.05, 1, (count, 3))).astype(np.float32),
        opacities=random.uniform(0.1, 1, count).astype(np.float32),
        sh=random.normal(scale=0.3, size=(count, (degree + 1) ** 2, 3)).astype(np.float32),
    )


def _floats(*values: float) -> NDArray[np.float32]:
    return np.array(values, np.float32)


def balls(positions: ArrayLike, scale: ArrayLike, opacity: ArrayLike, colors: ArrayLike) -> Splats:
    """Unturned splats at (n, 3) with standard deviations and RGB that broadcast to (n, 3)."""
    positions = np.atleast_2d(np.asarray(positions, np.float64))
    n = len(positions)
    rgb = np.broadcast_to(np.asarray(colors, np.float64), (n, 3))
    return Splats(
        positions=positions.astype(np.float32),
        orientations=np.tile(_floats(0, 0, 0, 1), (n, 1)),
        scales=np.broadcast_to(np.asarray(scale, np.float32), (n, 3)).copy(),
        opacities=np.broadcast_to(np.asarray(opacity, np.float32), n).copy(),
        sh=((rgb - 0.5) / harmonics.C0)[:, None].astype(np.float32),
    )


def ahead(fov: float = 0.9, **changes: Any) -> Camera:
    """At the origin, looking along z. fov: of the width. [rad]"""
    focal = WIDTH / 2 / math.tan(fov / 2)
    camera = Camera(0, WIDTH, HEIGHT, focal, focal, WIDTH / 2, HEIGHT / 2, np.eye(4))
    return replace(camera, **changes)


def outside(**changes: Any) -> Camera:
    """Looks at a cloud from two metres away."""
    return ahead(**({"world_to_camera": look_at((2.0, 1.0, 0.7), (0, 0, 0))} | changes))


def truth(splats: Splats, camera: Camera) -> Image:
    """(height, width, 3) by the reference renderer."""
    return reference.render(splats, camera).rgba[..., :3]


def decibels(picture: Image, expected: Image) -> float:
    """PSNR of what a screen shows; equal pictures count as MOST_PSNR."""
    value = psnr(np.clip(picture, 0, 1), np.clip(expected, 0, 1))
    return round(min(value, MOST_PSNR), 2)


def shown(bench: Bench, splats: Splats, camera: Camera, **settings: Any) -> Image:
    """By the real renderer in exact order, in 32-bit floats unless told otherwise."""
    bench.show(splats)
    order = bench.order(camera)
    return bench.draw(camera, order, **({"float_blending": True} | settings))


def ordered(bench: Bench, splats: Splats, camera: Camera, order: Order) -> Image:
    """By the real renderer in another order."""
    bench.show(splats)
    return bench.draw(camera, order, float_blending=True)


def some(values: Sequence[float], quick: bool, count: int = 3) -> list[float]:
    """All values, or when it should be quick a few, ends included."""
    if not quick or len(values) <= count:
        return list(values)
    return [values[round(i * (len(values) - 1) / (count - 1))] for i in range(count)]


# --- Projection -----------------------------------------------------------------------------------


@case("Wide fields of view", "angle of view [deg]")
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


@case("Through the near plane", "Near Fade [m]", "largest change of a pixel in a step of 2 cm")
def near_plane(bench: Bench, quick: bool) -> tuple[Sequence[float], Curves]:
    wall = replace(cloud(60, size=0.2), positions=cloud(60).positions * _floats(1, 1, 0.3))
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


@case("Camera inside splats", "standard deviation of the splats [m]")
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


@case("Needles and discs", "longest over shortest axis")
def shapes(bench: Bench, quick: bool) -> tuple[Sequence[float], Curves]:
    conditions = some([10.0**k for k in range(9)], quick)
    curves: Curves = {"needles": [], "discs": []}
    for condition in conditions:
        for name, thin in (("needles", [False, True, True]), ("discs", [False, False, True])):
            scales = np.where(thin, 0.2 / condition, 0.2) * np.ones((300, 3))
            splats = replace(cloud(300), scales=scales.astype(np.float32))
            curves[name].append(decibels(shown(bench, splats, outside()), truth(splats, outside())))
    return conditions, curves


@case("Zoomed out: splats smaller than pixels", "times farther away")
def zoomed_out(bench: Bench, quick: bool) -> tuple[Sequence[float], Curves]:
    from rviz_gaussian_plugin.offscreen import Antialiasing

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


@case("Huge splats", "standard deviation [m]")
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


@case("Orthographic views", "picture's height [m]")
def orthographic(bench: Bench, quick: bool) -> tuple[Sequence[float], Curves]:
    spans = some([0.1, 1, 10, 100, 1000], quick)
    splats = cloud(400)
    curves: Curves = {"ours": []}
    for span in spans:
        camera = outside(orthographic=True, fx=HEIGHT / span, fy=HEIGHT / span)
        curves["ours"].append(decibels(shown(bench, splats, camera), truth(splats, camera)))
    return spans, curves


@case("Viewports, resized between order and picture", "width and height [px]")
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


@case("Off-centre pictures: stereo, tiles of a wall", "axis beside the picture's middle [widths]")
def off_centre(bench: Bench, quick: bool) -> tuple[Sequence[float], Curves]:
    """A sheared frustum: the same view direction, another part of the picture plane."""
    shifts = some([0, 0.5, 1, 2, 4], quick)
    random = np.random.default_rng(0)
    across = np.column_stack([random.uniform(-6, 2, 3000), random.uniform(-1, 1, (3000, 2))])
    splats = replace(cloud(3000), positions=(across + _floats(0, 0, 2)).astype(np.float32))
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


# --- Coordinates ----------------------------------------------------------------------------------


@case("Far from the origin", "offset [m]")
def far_away(bench: Bench, quick: bool) -> tuple[Sequence[float], Curves]:
    offsets = some([0, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7], quick)
    splats = cloud(400)
    curves: Curves = {"rebased in float64 (ours)": [], "float32 without an origin": []}
    for offset in offsets:
        there = offset * np.array([0.8, -0.5, 0.3])
        camera = outside(world_to_camera=look_at(there + outside().position, there))
        rebased = replace(splats, origin=there)
        expected = truth(rebased, camera)
        naive = replace(splats, positions=(splats.positions + there).astype(np.float32))
        for name, form in (
            ("rebased in float64 (ours)", rebased), ("float32 without an origin", naive),
        ):  # fmt: skip
            curves[name].append(decibels(shown(bench, form, camera), expected))
    return offsets, curves


@case("The same scene in other units", "scale of scene and camera")
def scaled(bench: Bench, quick: bool) -> tuple[Sequence[float], Curves]:
    factors = some([1e-6, 1e-4, 1e-2, 1, 1e2, 1e4, 1e6], quick)
    splats = cloud(400)
    curves: Curves = {"scaled": [], "scaled and mirrored": []}
    mirror = _floats(-1, 1, 1)
    signs = np.sign(_mirrored_harmonics())
    for factor in factors:
        larger = replace(
            splats,
            positions=splats.positions * np.float32(factor),
            scales=splats.scales * np.float32(factor),
        )
        camera = motion.placed(outside(), outside().position * factor)
        camera = replace(camera, near=0.01 * factor)
        curves["scaled"].append(decibels(shown(bench, larger, camera), truth(splats, outside())))
        # Mirrored in x: a quaternion's y and z turn round, harmonics odd in x change sign.
        flipped = replace(
            larger,
            positions=larger.positions * mirror,
            orientations=larger.orientations * _floats(1, -1, -1, 1),
            sh=larger.sh * signs[None, : larger.sh.shape[1], None].astype(np.float32),
        )
        facing = look_at(camera.position * mirror, (0, 0, 0))
        seen = shown(bench, flipped, replace(camera, world_to_camera=facing))
        curves["scaled and mirrored"].append(decibels(seen[:, ::-1], truth(splats, outside())))
    return factors, curves


@case("Sheared maps", "shear, metres a metre")
def sheared(bench: Bench, quick: bool) -> tuple[Sequence[float], Curves]:
    """Against the map as it was, seen by a camera that is sheared in its place."""
    shears = some([0, 0.1, 0.3, 1, 3, 10], quick)
    splats = cloud(400, degree=0)
    curves: Curves = {"axes found anew": [], "means alone sheared": []}
    for shear in shears:
        change = np.eye(4)
        change[0, 1] = shear
        slanted = outside(
            near=1e-3
        )  # no camera has such a pose, but the projection is linear in it
        object.__setattr__(slanted, "world_to_camera", slanted.world_to_camera @ change)
        expected = truth(splats, slanted)
        moved = replace(splats, positions=(splats.positions @ change[:3, :3].T).astype("f4"))
        curves["axes found anew"].append(
            decibels(shown(bench, _reshaped(moved, change[:3, :3]), outside(near=1e-3)), expected)
        )
        curves["means alone sheared"].append(
            decibels(shown(bench, moved, outside(near=1e-3)), expected)
        )
    return shears, curves


def _reshaped(splats: Splats, change: NDArray[np.float64]) -> Splats:
    """With the covariances M C M^T of a linear change (3, 3), as orientations and scales again."""
    axes = rotation_matrices(splats.orientations.astype(np.float64))
    roots = change @ axes * splats.scales.astype(np.float64)[:, None, :]
    axes, scales, _ = np.linalg.svd(roots)
    axes *= np.linalg.det(axes)[:, None, None]
    quaternions = np.array([_looking(turn).orientation for turn in axes])
    return replace(
        splats, orientations=quaternions.astype(np.float32), scales=scales.astype(np.float32)
    )


def _looking(turn: NDArray[np.float64]) -> Camera:
    """The camera that a rotation (3, 3) turns from looking along z."""
    pose = np.eye(4)
    pose[:3, :3] = turn.T
    return ahead(world_to_camera=pose)


def _mirrored_harmonics() -> NDArray[np.float64]:
    """(16,) 1 for harmonics even in x, -1 for odd ones."""
    direction = np.array([[0.3, 0.5, 0.81]])
    mirrored = direction * (-1, 1, 1)
    signs: NDArray[np.float64] = harmonics.basis(mirrored, 3)[0] / harmonics.basis(direction, 3)[0]
    return signs


# --- Order ----------------------------------------------------------------------------------------

KEYS = {
    "float32 (ours)": orders.full,
    "linear 16 bit": orders.linear(16),
    "float 16 bit": orders.truncated(16),
    "adaptive 16 bit": orders.equalised(16),
}


@case("A far outlier starves the keys", "outlier's distance over the scene's")
def outliers(bench: Bench, quick: bool) -> tuple[Sequence[float], Curves]:
    ratios = some([10.0**k for k in range(7)], quick)
    curves: Curves = {name: [] for name in KEYS}
    scene = cloud(3000, size=0.1)
    camera = outside()
    for ratio in ratios:
        stray = balls([-2.3 * ratio * camera.position / 2.3], 0.01 * ratio, 0.5, 1)
        splats = concatenate([scene, stray.with_sh_degree(1)])
        expected = truth(splats, camera)
        bench.show(splats)
        for name, quantise in KEYS.items():
            order = orders.keyed(bench.view(camera), bench.map, quantise)
            curves[name].append(decibels(ordered(bench, splats, camera, order), expected))
    return ratios, curves


@case("Millimetres to kilometres in one view", "farthest over nearest")
def depth_range(bench: Bench, quick: bool) -> tuple[Sequence[float], Curves]:
    ratios = some([10.0**k for k in range(1, 8)], quick)
    curves: Curves = {name: [] for name in KEYS}
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
        bench.show(splats)
        for name, quantise in KEYS.items():
            order = orders.keyed(bench.view(camera), bench.map, quantise)
            curves[name].append(decibels(ordered(bench, splats, camera, order), expected))
    return ratios, curves


BY_RENDERER = "sorted by the renderer"


@case("Ties: coplanar splats, 60 static frames", "frame", "frames that differ from the first")
def ties(bench: Bench, quick: bool) -> tuple[Sequence[float], Curves]:
    flat = cloud(2000)
    flat = replace(flat, positions=flat.positions * _floats(1, 1, 0) + _floats(0, 0, 2))
    camera = ahead()
    frames = 6 if quick else 60
    curves: Curves = {}
    first: bytes | None = None
    for name in [*bench.backends, BY_RENDERER]:
        bench.show(flat)
        differ = 0
        for _ in range(frames):
            order = None if name == BY_RENDERER else bench.order(camera, name)
            pixels = bench.draw(camera, order).tobytes()
            first = first or pixels
            differ += pixels != first
        curves[name] = [float(differ)]
    return [frames], curves


@case("Yesterday's order: turning", "degrees since it was sorted")
def stale_turning(bench: Bench, quick: bool) -> tuple[Sequence[float], Curves]:
    amounts = some([0, 0.1, 0.3, 1, 3, 10, 30], quick)
    return amounts, _stale(bench, quick, "rotation", [math.radians(a) for a in amounts])


@case("Yesterday's order: orbiting", "degrees since it was sorted")
def stale_orbit(bench: Bench, quick: bool) -> tuple[Sequence[float], Curves]:
    amounts = some([0, 0.1, 0.3, 1, 3, 10, 30], quick)
    return amounts, _stale(bench, quick, "orbit", [math.radians(a) for a in amounts])


@case("Yesterday's order: coming (+) and going (-)", "% of the distance since it was sorted")
def stale_dolly(bench: Bench, quick: bool) -> tuple[Sequence[float], Curves]:
    amounts = some([-30, -10, -3, -1, 0, 10, 30], quick)
    return amounts, _stale(bench, quick, "dolly", [a / 100 for a in amounts])


def _stale(bench: Bench, quick: bool, kind: str, amounts: Sequence[float]) -> Curves:
    """Orders of a camera that moved by amounts since, culled for its view and for wider ones."""
    splats = generate(5_000 if quick else 40_000)
    target = motion.typical_bounds(splats).mean(axis=0)
    camera = motion.around(splats, 4, (0, 0, 1), WIDTH, HEIGHT)[1]
    expected = truth(splats, camera)
    bench.show(splats)
    curves: Curves = {}
    for factor in (1, OVERSCAN, 1.5, 2):
        name = "culled for its view" if factor == 1 else f"for a view {factor:g} times as wide"
        name += " (ours)" * (factor == OVERSCAN)
        curves[name] = []
        for amount in amounts:
            past = motion.before(camera, kind, amount, 1.0, target)
            order = bench.order(widened(past, factor / OVERSCAN))
            curves[name].append(decibels(ordered(bench, splats, camera, order), expected))
    return curves


@case("Popping under slow rotation", "degrees a frame", "worst pixel")
def popping(bench: Bench, quick: bool) -> tuple[Sequence[float], Curves]:
    """What a frame changes by its order alone, drawn once in its own and once in the last frame's;
    and what is left of two frames after undoing the motion between them."""
    steps = some([0.1, 0.3, 1, 3], quick)
    splats = cloud(800, size=0.3)
    bench.show(splats)
    curves: Curves = {}
    for name, distance in (("by z (ours)", orders.by_z), ("by distance", orders.by_distance)):
        alone, left = [], []
        for step in steps:
            cameras = [
                motion.turned(outside(), math.radians(step * frame))
                for frame in range(3 if quick else 9)
            ]
            kept = [
                orders.keyed(bench.view(camera), bench.map, orders.full, distance)
                for camera in cameras
            ]
            frames = [
                ordered(bench, splats, camera, order)
                for camera, order in zip(cameras, kept, strict=True)
            ]
            popped, residual = 0.0, 0.0
            for i in range(1, len(cameras)):
                late = ordered(bench, splats, cameras[i], _in_both(kept[i - 1], kept[i]))
                same = ordered(bench, splats, cameras[i], _in_both(kept[i], kept[i - 1]))
                popped = max(popped, float(np.abs(late - same).max()))
                residual = max(
                    residual, _residual(frames[i - 1], frames[i], *cameras[i - 1 : i + 1])
                )
            alone.append(round(popped, 4))
            left.append(round(residual, 4))
        curves[f"{name}, by the order alone"] = alone
        curves[f"{name}, left after the motion"] = left
    return steps, curves


def _in_both(order: Order, other: Order) -> Order:
    """An order without the slots that another one lacks."""
    return order[np.isin(order, other)]


def _residual(before: Image, after: Image, a: Camera, b: Camera) -> float:
    """99.9 % quantile of the difference between a frame and the last one as the motion moves it."""
    intrinsics = np.array([[a.fx, 0, a.cx - 0.5], [0, a.fy, a.cy - 0.5], [0, 0, 1]])
    turn = b.world_to_camera[:3, :3] @ a.world_to_camera[:3, :3].T
    homography = intrinsics @ turn @ np.linalg.inv(intrinsics)
    size = (a.width, a.height)
    warped = cv2.warpPerspective(
        np.clip(before, 0, 1).astype(np.float32), homography, size, flags=cv2.INTER_CUBIC,
        borderValue=(np.nan,) * 3,
    )  # fmt: skip
    error = np.abs(np.clip(after, 0, 1) - warped).max(axis=2)
    return float(np.nanquantile(error, 0.999))


@case("Edits that the order hasn't heard of", "% of the splats edited")
def edits(bench: Bench, quick: bool) -> tuple[Sequence[float], Curves]:
    shares = some([0, 0.1, 1, 10, 50], quick)
    splats = cloud(2000, size=0.1)
    camera = outside()
    curves: Curves = {"moved, old order": [], "moved, merged (ours)": []}
    for share in shares:
        count = round(len(splats) * share / 100)
        moved = replace(splats, positions=splats.positions.copy())
        moved.positions[:count] = cloud(2000, seed=7).positions[:count]
        expected = truth(moved, camera)
        bench.show(replace(splats))  # a map of its own each time
        order = bench.order(camera)
        bench.draw(camera, order)
        if count:
            bench.edit(UPSERT, 0, moved[:count])
        bench.renderer.settings.float_blending = True
        bench.renderer.draw(VIEW_ID)
        old = bench.renderer.read_color()[..., :3].astype(np.float64)
        curves["moved, old order"].append(decibels(old, expected))
        bench.renderer.settings.order = OrderSource.AUTO  # from now on as the Display does
        deadline = time.monotonic() + 0.2  # within the display's patience with the sidecar
        while count and bench.renderer.draw(VIEW_ID)["order_source"] == SOURCE:
            if time.monotonic() > deadline:
                break
            time.sleep(0.005)
        merged = bench.renderer.read_color()[..., :3].astype(np.float64)
        curves["moved, merged (ours)"].append(decibels(merged, expected))
    return shares, curves


# --- Blending -------------------------------------------------------------------------------------


@case("Layers of fog", "layers")
def layers(bench: Bench, quick: bool) -> tuple[Sequence[float], Curves]:
    counts = [10, 1000] if quick else [10, 100, 1000, 10_000]
    curves: Curves = {"RGBA32F": [], "RGBA16F": [], "RGBA8 (model)": []}
    random = np.random.default_rng(0)
    for count in map(int, counts):
        positions = np.column_stack(
            [random.normal(scale=0.05, size=(count, 2)), np.linspace(2, 3, count)]
        )
        fog = balls(positions, 0.5, min(0.5, 3 / count), random.uniform(0.2, 1, (count, 3)))
        # Below 1/255 nothing is drawn: fewer, stronger layers where the fog would be thinner.
        fog = replace(fog, opacities=np.maximum(fog.opacities, np.float32(0.01)))
        camera = replace(ahead(), width=64, height=48, fx=60, fy=60, cx=32, cy=24)
        expected = truth(fog, camera)
        curves["RGBA32F"].append(decibels(shown(bench, fog, camera), expected))
        half = shown(bench, fog, camera, float_blending=False)
        curves["RGBA16F"].append(decibels(half, expected))
        coarse = fragments.picture(fog, camera, fragments.rounded(255))
        curves["RGBA8 (model)"].append(decibels(coarse, expected))
    return counts, curves


@case("Faint splats and the cut at 1/255", "peak opacity")
def faint(bench: Bench, quick: bool) -> tuple[Sequence[float], Curves]:
    opacities = some([0.003, 0.004, 0.006, 0.01, 0.03, 0.1, 0.3], quick)
    curves: Curves = {"ours against fog without a cut": [], "ours against the reference": []}
    camera = replace(ahead(), width=64, height=48, fx=60, fy=60, cx=32, cy=24)
    for opacity in opacities:
        count = round(1.5 / opacity)
        fog = balls(np.tile([0, 0, 2.0], (count, 1)), 0.3, opacity, 0.8)
        picture = shown(bench, fog, camera)
        y, x = np.mgrid[:48, :64] + 0.5
        variance = (60 * 0.3 / 2) ** 2 + 0.3
        gauss = np.exp(-((x - 32) ** 2 + (y - 24) ** 2) / (2 * variance))
        uncut = 0.8 * (1 - (1 - np.float32(opacity) * gauss) ** count)
        uncut_rgb = np.repeat(uncut[..., None], 3, axis=2)
        curves["ours against fog without a cut"].append(decibels(picture, uncut_rgb))
        curves["ours against the reference"].append(decibels(picture, truth(fog, camera)))
    return opacities, curves


@case("Opaque walls and the cap at 0.99", "opaque layers before a white lamp", "lamp's leak")
def opaque(bench: Bench, quick: bool) -> tuple[Sequence[float], Curves]:
    counts = some([1, 2, 3, 4], quick)
    curves: Curves = {"ours, 32F": [], "0.01^layers": []}
    for count in map(int, counts):
        positions = [[0, 0, 2 + 0.1 * i] for i in range(count + 1)]
        colors = [[0, 0, 0]] * count + [[1, 1, 1]]
        wall = balls(positions, 0.5, 1.0, np.array(colors))
        picture = shown(bench, wall, ahead())
        curves["ours, 32F"].append(float(f"{picture[HEIGHT // 2, WIDTH // 2].max():.3g}"))
        curves["0.01^layers"].append(float(f"{0.99 * 0.01**count:.3g}"))
    return counts, curves


@case("Harmonics that overshoot", "amplitude of the bands above 0")
def overshoot(bench: Bench, quick: bool) -> tuple[Sequence[float], Curves]:
    amplitudes = some([0, 0.1, 0.3, 1, 3, 10], quick)
    curves: Curves = {"clamped at 0 (ours)": [], "clamped at 0 and 1 (model)": []}

    def clamped(band: fragments.Fragments) -> Image:
        return fragments.over(replace(band, colors=np.minimum(1, band.colors)))

    for amplitude in amplitudes:
        splats = cloud(400, degree=3)
        splats.sh[:, 1:] *= np.float32(amplitude / 0.3)
        expected = truth(splats, outside())
        curves["clamped at 0 (ours)"].append(decibels(shown(bench, splats, outside()), expected))
        curves["clamped at 0 and 1 (model)"].append(
            decibels(fragments.picture(splats, outside(), clamped), expected)
        )
    return amplitudes, curves


# --- What is written ------------------------------------------------------------------------------


def save(path: Path, findings: Sequence[Finding]) -> None:
    """Writes findings as JSON."""
    write_text(path, json.dumps([asdict(f) for f in findings], indent=0) + "\n")
