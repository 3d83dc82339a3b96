"""Levels of detail: what building and repairing them takes, frames of a budget, and popping.

`make lab` has their error.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rosplat_core import rendering
from rosplat_core.cameras import Camera
from rosplat_core.splats import InputError, Splats
from rosplat_lab.bench import scenes
from rosplat_lab.bench.isolation import isolated
from rosplat_lab.bench.plan import Plan
from rosplat_lab.bench.records import Budget, Doing, Event, Measurement, milliseconds
from rosplat_lab.bench.renderers import CpuRenderer, DisplayRenderer, Ours, accelerated, in_turn

Array = NDArray[np.float64]

SIZES, QUICK_SIZES = (5_000_000,), (20_000,)
PICTURE, QUICK_PICTURE = (1280, 720), (320, 180)
SPLATS = 1_000_000  # that a budget allows
EDITED = 10_000  # splats, of an edit
PATH, QUICK_PATH = 30, 4  # pictures
POPPING = ("2px", "4px", "8px")
STEPS = 8  # cameras that take turns
STEP = 0.005  # from one picture to the next [m]
NEAR = 0.5  # distance of what the camera comes nearer by STEP [m]


DRAWERS: dict[str, Callable[[], Ours]] = {"processor": CpuRenderer, "card": DisplayRenderer}


def measure(plan: Plan) -> Iterator[Event]:
    """Building and repairing levels; frames in full and of a budget; popping."""
    from rviz_gaussian_plugin.offscreen import ensure_display

    sizes = plan.sizes or ((QUICK_SIZES if plan.quick else SIZES) if not plan.scenes else ())
    picture = QUICK_PICTURE if plan.quick else PICTURE
    length = QUICK_PATH if plan.quick else PATH
    if unknown := set(plan.variants) - DRAWERS.keys():
        known = ", ".join(DRAWERS)
        raise InputError(f"unknown variant '{unknown.pop()}', known are {known}")
    with nullcontext() if set(plan.variants) == {"processor"} else ensure_display():
        drawers = plan.variants or (tuple(DRAWERS) if accelerated() else ("processor",))
        jobs = [(name, which) for name in scenes.names(sizes, plan.scenes) for which in drawers]
        for number, (name, which) in enumerate(jobs):
            yield Doing(f"{name}, {which}", number / len(jobs))
            yield from isolated(_scene, name, which, picture, length, plan.budget)


def _scene(
    name: str, which: str, picture: tuple[int, int], length: int, budget: Budget
) -> Iterator[Event]:
    splats = scenes.load(name)
    drawer = DRAWERS[which]()
    rendering.insert_all(drawer.renderer, splats)

    def of(what: str, unit: str, samples: Any, **parameters: str | float) -> Measurement:
        return Measurement(what, unit, samples, name, len(splats), drawer.device, **parameters)

    camera = scenes.overview(splats, *picture, 1)[0]
    _show(drawer, camera, "full")  # uploads the map
    yield of("build", "s per million splats", 1e3 * milliseconds(drawer.merge) / len(splats))
    held = drawer.merge()
    if "nodes" in held:
        yield of("nodes", "per splat", held["nodes"] / len(splats))
    yield of("memory", "bytes per splat", held["memory"] / len(splats))
    yield of("repair", "ms", [_repair(drawer, splats, part) for part in range(5)])
    for view in scenes.views(name):
        cameras = scenes.VIEWS[view](splats, *picture, STEPS)
        ways = [("full", False), (f"{SPLATS}", False)]
        if which == "card":  # where an interactive picture isn't an older one
            ways.append((f"{SPLATS}", True))
        for detail, interactive in ways:
            _show(drawer, cameras[0], detail, interactive)
            times = in_turn(drawer, cameras, budget)
            _show(drawer, cameras[0], detail, interactive)
            drawn: dict[str, Any] = {"px": drawer.report["error"], "drawn": drawer.report["splats"]}
            kept = "in motion" if interactive else "at once"
            yield of("frame", "ms", times, view=view, detail=detail, kept=kept, **drawn)
    camera = scenes.inside(splats, *picture, 1)[0]
    for detail, changes in _fades(drawer, camera, length).items():
        most = [np.quantile(change, 0.999) for change in changes]
        yield of("popping of a camera at rest, 99.9 % of pixels", "/255", most, detail=detail)
        worst = [change.max() for change in changes]
        yield of("popping of a camera at rest, worst pixel", "/255", worst, detail=detail)


def _repair(drawer: Ours, splats: Splats, part: int) -> float:
    """Milliseconds that the levels take for an edit of neighbouring splats."""
    count = min(EDITED, len(splats))
    first = (len(splats) - count) * part // 4
    rendering.insert(drawer.renderer, splats, slice(first, first + count), 1000 + part)
    return milliseconds(drawer.merge)


def _show(drawer: Ours, camera: Camera, detail: str, interactive: bool = False) -> None:
    drawer.use({"detail": detail, "interactive": interactive})
    drawer.set_camera(camera)
    drawer.draw()


def _picture(drawer: Ours, camera: Camera, detail: str) -> Array:
    """(height, width, 3) as a screen shows it, over black."""
    _show(drawer, camera, detail)
    return np.clip(drawer.picture().astype(np.float64), 0, 1)


def _fades(drawer: Ours, camera: Camera, length: int) -> dict[str, list[Array]]:
    """How much pixels change from picture to picture by the cut alone [/255]. The camera rests, and
    the error grows as that of something NEAR would along the path."""

    def pictures(detail: str) -> Iterator[Array]:
        for index in range(length):
            error = float(detail.removesuffix("px")) * (1 + STEP / NEAR) ** index
            yield _picture(drawer, camera, f"{error:.6g}px")

    return {
        detail: [255 * np.abs(b - a).max(axis=2) for a, b in itertools.pairwise(pictures(detail))]
        for detail in POPPING
    }
