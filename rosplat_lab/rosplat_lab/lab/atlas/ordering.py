"""Where orders fail: coarse keys, ties, an order of some frames ago."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np

from rosplat_core.cameras import Camera
from rosplat_core.generated import generate
from rosplat_core.maps import UPSERT
from rosplat_core.rendering import OrderSource, Rasterizer
from rosplat_core.splats import concatenate
from rosplat_core.view import OVERSCAN
from rosplat_lab.lab import motion, orders
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
    some,
    truth,
)
from rosplat_lab.lab.bench import SOURCE, VIEW_ID, Bench, Image
from rosplat_lab.lab.methods import widened
from rosplat_lab.lab.orders import Order

CASES = Cases()

KEYS = {
    "float32 (ours)": orders.full,
    "linear 16 bit": orders.linear(16),
    "float 16 bit": orders.truncated(16),
    "adaptive 16 bit": orders.equalised(16),
}


@CASES.enter("A far outlier starves the keys", "outlier's distance over the scene's")
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


@CASES.enter("Millimetres to kilometres in one view", "farthest over nearest")
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


@CASES.enter(
    "Ties: coplanar splats, 60 static frames", "frame", "frames that differ from the first"
)
def ties(bench: Bench, quick: bool) -> tuple[Sequence[float], Curves]:
    flat = cloud(2000)
    flat = replace(flat, positions=flat.positions * floats(1, 1, 0) + floats(0, 0, 2))
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


@CASES.enter("Yesterday's order: turning", "degrees since it was sorted")
def stale_turning(bench: Bench, quick: bool) -> tuple[Sequence[float], Curves]:
    amounts = some([0, 0.1, 0.3, 1, 3, 10, 30], quick)
    return amounts, _stale(bench, quick, "rotation", [math.radians(a) for a in amounts])


@CASES.enter("Yesterday's order: orbiting", "degrees since it was sorted")
def stale_orbit(bench: Bench, quick: bool) -> tuple[Sequence[float], Curves]:
    amounts = some([0, 0.1, 0.3, 1, 3, 10, 30], quick)
    return amounts, _stale(bench, quick, "orbit", [math.radians(a) for a in amounts])


@CASES.enter("Yesterday's order: coming (+) and going (-)", "% of the distance since it was sorted")
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


@CASES.enter("Popping under slow rotation", "degrees a frame", "worst pixel")
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


@CASES.enter("Edits that the order hasn't heard of", "% of the splats edited")
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
        # On the processor an order of a map before gives way to its own.
        bench.draw(camera, order, rasterizer=Rasterizer.TILES)
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
