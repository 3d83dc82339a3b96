"""Levels of detail on the processor: error against what they save, what they cost, and popping."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rosplat_lab import metrics
from rosplat_lab.bench import embedded, scenes
from rosplat_lab.bench.isolation import isolated
from rosplat_lab.bench.plan import Plan
from rosplat_lab.bench.records import Budget, Doing, Event, Measurement, milliseconds
from rosplat_tools.cameras import Camera
from rosplat_tools.splats import Splats

if TYPE_CHECKING:
    from rviz_gaussian_plugin.offscreen import CpuRenderer

Array = NDArray[np.float64]

SIZES, QUICK_SIZES = (5_000_000,), (20_000,)
PICTURE, QUICK_PICTURE = (1280, 720), (320, 180)
ERRORS = (1, 2, 3, 4, 6, 8, 12, 16)  # [px]
SPLATS = 1_000_000  # that a budget allows
VIEWS = ("overview", "inside")
EDITED = 10_000  # splats, of an edit
SUPERSAMPLED = 4  # pixels of the truth in one, along an axis
PATH, QUICK_PATH = 30, 4  # pictures
POPPING = ("2px", "4px", "8px")
STEP, TURN = 0.005, math.radians(0.1)  # from one to the next [m], [rad]


def measure(plan: Plan) -> Iterator[Event]:
    """Building and repairing levels; PSNR and frames by error; popping along a slow path."""
    sizes = plan.sizes or ((QUICK_SIZES if plan.quick else SIZES) if not plan.scenes else ())
    names = scenes.names(sizes, plan.scenes)
    for number, name in enumerate(names):
        yield Doing(name, number / len(names))
        picture = QUICK_PICTURE if plan.quick else PICTURE
        length = QUICK_PATH if plan.quick else PATH
        yield from isolated(_scene, name, picture, length, plan.budget)


def _scene(name: str, picture: tuple[int, int], length: int, budget: Budget) -> Iterator[Event]:
    from rviz_gaussian_plugin.offscreen import CpuRenderer

    splats = scenes.load(name)
    renderer = CpuRenderer()
    embedded.insert_all(renderer, splats)

    def of(what: str, unit: str, samples: Any, **parameters: str | float) -> Measurement:
        device = f"CPU, {renderer.instructions}"
        return Measurement.of(what, unit, samples, name, len(splats), device, **parameters)

    took = milliseconds(renderer.merge)
    yield of("build", "s per million splats", 1e3 * took / len(splats))
    yield of("nodes", "per splat", renderer.merge() / len(splats))
    yield of("memory", "bytes per splat", renderer.levels_bytes / len(splats))
    yield of("repair", "ms", [_repair(renderer, splats, part) for part in range(5)])
    for view in VIEWS:
        camera = scenes.VIEWS[view](splats, *picture, 1)[0]
        full = _picture(renderer, camera, "full")
        truth = _truth(renderer, camera)
        yield of("PSNR against the truth", "dB", _psnr(full, truth), view=view, px=0.0)
        for detail in ("full", f"{SPLATS}", *(f"{error}px" for error in ERRORS)):
            renderer.settings.detail = detail
            pose = _pose(camera)
            times = budget.spend(lambda _, pose=pose: milliseconds(lambda: renderer.draw(pose)))
            drawn = renderer.draw(pose)
            shown = {"view": view, "detail": detail, "px": drawn["error"]}
            shown |= {"drawn": drawn["splats"]}
            yield of("frame", "ms", times, **shown)
            if detail == "full":
                whole = drawn["splats"]
                continue
            shown |= {"share": drawn["splats"] / max(whole, 1)}
            colour = np.clip(drawn["colour"][..., :3].astype(np.float64), 0, 1)
            yield of("PSNR", "dB", _psnr(colour, full), **shown)
            yield of("PSNR against the truth", "dB", _psnr(colour, truth), **shown)
    camera = scenes.inside(splats, *picture, 1)[0]
    for detail, changes in _pops(renderer, camera, length).items():
        most = [np.quantile(change, 0.999) for change in changes]
        yield of("popping, 99.9 % of pixels", "/255", most, detail=detail)
        worst = [change.max() for change in changes]
        yield of("popping, worst pixel", "/255", worst, detail=detail)


def _psnr(picture: Array, reference: Array) -> float:
    return min(metrics.psnr(picture, reference), metrics.MOST_PSNR)


def _repair(renderer: CpuRenderer, splats: Splats, part: int) -> float:
    """Milliseconds that the levels take for an edit of neighbouring splats."""
    count = min(EDITED, len(splats))
    first = (len(splats) - count) * part // 4
    embedded.insert(renderer, splats, slice(first, first + count), 1000 + part)
    return milliseconds(renderer.merge)


def _pose(camera: Camera) -> Any:
    from rviz_gaussian_plugin import offscreen

    return offscreen.Camera(*embedded.pose(camera))


def _picture(renderer: CpuRenderer, camera: Camera, detail: str) -> Array:
    """(height, width, 3) as a screen shows it, over black."""
    renderer.settings.detail = detail
    colour = renderer.draw(_pose(camera))["colour"][..., :3]
    return np.clip(colour.astype(np.float64), 0, 1)


def _truth(renderer: CpuRenderer, camera: Camera) -> Array:
    """The same, each pixel the mean of many: without what the low-pass filter adds to it."""
    n = SUPERSAMPLED
    fine = replace(
        camera, width=n * camera.width, height=n * camera.height, fx=n * camera.fx,
        fy=n * camera.fy, cx=n * camera.cx, cy=n * camera.cy,
    )  # fmt: skip
    colour = _picture(renderer, fine, "full")
    mean: Array = colour.reshape(camera.height, n, camera.width, n, 3).mean(axis=(1, 3))
    return mean


def _path(camera: Camera, length: int) -> Iterator[Camera]:
    """A slow one, forwards and to the side."""
    for index in range(length):
        turn = index * TURN
        step = np.eye(4)
        step[:3, :3] = [
            [math.cos(turn), 0, math.sin(turn)], [0, 1, 0], [-math.sin(turn), 0, math.cos(turn)],
        ]  # fmt: skip
        step[2, 3] = -index * STEP
        yield replace(camera, world_to_camera=step @ camera.world_to_camera)


def _pops(renderer: CpuRenderer, camera: Camera, length: int) -> dict[str, list[Array]]:
    """By how much pixels change from picture to picture, beyond those of the full map [/255]."""
    changes: dict[str, list[Array]] = {detail: [] for detail in POPPING}
    before: dict[str, Array] = {}
    for here in _path(camera, length):
        now = {detail: _picture(renderer, here, detail) for detail in ("full", *POPPING)}
        for detail in POPPING if before else ():
            change = np.abs(now[detail] - before[detail]) - np.abs(now["full"] - before["full"])
            changes[detail].append(255 * np.maximum(change.max(axis=2), 0))
        before = now
    return changes
