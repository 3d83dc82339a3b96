"""What `simplify` promises, and what views have that it never saw."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import numpy as np

from rosplat_core.cameras import Camera, load_cameras, orbit, place
from rosplat_core.scenes import ROOMS
from rosplat_core.splats import Splats
from rosplat_core.upright import find_up
from rosplat_lab.bench import scenes
from rosplat_lab.bench.isolation import isolated
from rosplat_lab.bench.plan import Plan
from rosplat_lab.bench.records import Doing, Event, Measurement

BOUNDS, QUICK_BOUNDS = (35, 45, 55), (35,)  # [dB]
SIZES, QUICK_SIZES = (20_000,), (3_000,)
HELD = 64  # views that judge
NEW_SEED = 1_000_000  # beyond those of searches
ELEVATIONS = (0.0, 0.3, 0.6, 0.9)  # of orbits around a scene [rad]


def measure(plan: Plan) -> Iterator[Event]:
    """What most views reach, all together and the worst have: as simplify prints it, in HELD new
    views, and in HELD others. [dB]

    New ones are of the kind that the search looks from. The others are orbits that show the whole
    scene, or turns within rooms. Where a path is given, the search has its odd cameras, and the
    others are even ones.
    """
    sizes = plan.sizes or (() if plan.scenes else QUICK_SIZES if plan.quick else SIZES)
    path = load_cameras(plan.cameras) if plan.cameras else None
    bounds = QUICK_BOUNDS if plan.quick else BOUNDS
    for number, name in enumerate(names := scenes.names(sizes, plan.scenes)):
        yield Doing(name, number / len(names))
        yield from isolated(_scene, name, path, bounds)


def _scene(name: str, path: list[Camera] | None, bounds: tuple[int, ...]) -> Iterator[Event]:
    from rosplat_core.simplification.judging import Judge, Quality, Trial
    from rosplat_core.simplification.search import Simplification

    splats = scenes.load(name)
    held = Judge(Trial(splats), _even(path) if path else _held_back(name, splats))
    for number, bound in enumerate(bounds):
        yield Doing(f"{name}, {bound} dB", number / len(bounds))
        began = time.process_time()
        work = Simplification(splats, path=path[1::2] if path else None)
        work.shrink(bound)
        took = time.process_time() - began
        work.look_anew()
        new = Judge(Trial(splats), work.views.cameras(HELD, NEW_SEED))
        for views, judge in (("printed", work.judge), ("new", new), ("held back", held)):
            errors = judge.errors(Trial(work.splats))
            quality = Quality.of(errors)
            labels: dict[str, Any] = {
                "scene": name, "splats": len(work.splats), "of": len(splats), "bound": bound,
                "views": views, "judged in": len(judge),
            }  # fmt: skip
            reached = int((errors <= 10 ** (-bound / 10)).sum())
            yield Measurement("views that reach the bound", "1", reached, **labels)
            yield Measurement("PSNR that most views reach", "dB", quality.psnr, **labels)
            yield Measurement("PSNR", "dB", quality.mean, **labels)
            yield Measurement("PSNR of the worst view", "dB", quality.worst, **labels)
        yield Measurement(
            "processor time", "s", took, scene=name, splats=len(work.splats), bound=bound
        )


def _even(path: list[Camera]) -> list[Camera]:
    even = path[::2]
    return [even[i] for i in np.linspace(0, len(even) - 1, min(HELD, len(even))).astype(int)]


def _held_back(name: str, splats: Splats) -> list[Camera]:
    each = HELD // len(ELEVATIONS)
    if name.startswith(ROOMS):
        step = 2 * 360 // HELD
        return [
            camera
            for motion in (scenes.room, scenes.eye_level)
            for camera in motion(splats, 1280, 720, 360)[::step][: HELD // 2]
        ]
    here, up = place(splats), splats.up or find_up(splats)
    half = np.full(3, here.radius / np.sqrt(3))
    return [
        camera
        for turn, elevation in enumerate(ELEVATIONS)
        for camera in orbit(
            [here.centre - half, here.centre + half], each, elevation=elevation, azimuth=turn, up=up
        )
    ]
