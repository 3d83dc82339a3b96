"""Obstacles in a map: how many of them are found, how many are none, and how long that takes.

The truth is that of generated rooms: the surfaces that their splats were laid on.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rosplat_core import rendering
from rosplat_core.generated import generate
from rosplat_core.generated.rooms import ROOMS, SIZE, WALL_HEIGHT, Rooms
from rosplat_core.occupancy import FREE, OCCUPIED, Grid, OccupancyMap, depth_of, grid_of
from rosplat_core.slot_order import put_in_slot_order
from rosplat_core.splats import Splats
from rosplat_lab.bench.isolation import isolated
from rosplat_lab.bench.plan import Plan
from rosplat_lab.bench.records import Budget, Doing, Event, Measurement, milliseconds
from rosplat_lab.reference import occupancy as reference

SIZES, QUICK_SIZES = (100_000, 1_000_000), (20_000,)
RESOLUTIONS = (0.05, 0.1)  # [m]
ACROSS = 1024  # voxels
SEED = 1
TOLERANCE = 1e-3  # of surfaces that lie between two voxels [m]
POINTS = 100_000  # of surfaces: recall is the share that is found
LIGHT = "light along axes"
CHOSEN = 0.5  # the default of rosplat_tools' occupancy
THRESHOLDS = {
    LIGHT: (0.1, 0.2, 0.3, 0.4, CHOSEN, 0.6, 0.7, 0.8, 0.9),
    "density": (0.003, 0.01, 0.03, 0.1, 0.2, 0.4),
    "centres": (0.1, 0.5),
}
BAND = (0.1, 1.8)  # of a robot over the floor [m]
START = (-1.2, -1.2)  # in the middle room, between its doors [m]
EDITED = 1_000

Judged = Callable[[Splats, float], tuple[NDArray[np.int64], NDArray[np.float64]]]


def measure(plan: Plan) -> Iterator[Event]:
    """Precision and recall by method and threshold; seconds a million, and ms an edit."""
    sizes = plan.sizes or (QUICK_SIZES if plan.quick else SIZES)
    for number, size in enumerate(sizes):
        yield Doing(f"{size:,} splats", number / len(sizes))
        for resolution in RESOLUTIONS:
            yield from isolated(_found, size, resolution)
            yield from isolated(_timed, size, resolution, plan.budget)


def as_trained(splats: Splats, seed: int) -> Splats:
    """Generated splats with the faults of trained ones.

    They lie 5 mm off the surface, differ in size and opacity, and every twentieth floats in the
    air, faint and 5 cm wide.
    """
    rng = np.random.default_rng(seed)
    count, floating = len(splats), len(splats) // 20
    positions = splats.positions + rng.normal(scale=0.005, size=(count, 3))
    scales = splats.scales * np.exp(rng.normal(scale=0.4, size=(count, 3)))
    opacities = splats.opacities * rng.uniform(0.4, 1, count)
    half = ROOMS * SIZE / 2
    stray = rng.choice(count, floating, replace=False)
    positions[stray] = rng.uniform((-half, -half, 0), (half, half, WALL_HEIGHT), (floating, 3))
    scales[stray] = 0.05 * np.exp(rng.normal(scale=0.6, size=(floating, 3)))
    opacities[stray] = rng.uniform(0.02, 0.3, floating)
    return replace(
        splats,
        positions=positions.astype(np.float32),
        scales=scales.astype(np.float32),
        opacities=opacities.astype(np.float32),
    )


def light(splats: Splats, resolution: float) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Keys of voxels, and the share of the light that they take away, (n, 1)."""
    voxels = OccupancyMap(resolution, ACROSS)
    rendering.insert_all(voxels, splats)
    cells, depths = voxels.find(depth_of(0.01))
    absorbed = -np.expm1(-depths.max(axis=1, keepdims=True).astype(np.float64))
    return reference.keys_of(cells.astype(np.int64)), absorbed


def _found(size: int, resolution: float) -> Iterator[Event]:
    generated = generate(size, SEED, 0, scene="rooms")
    rooms = Rooms(np.random.default_rng(SEED))
    truth = reference.truth(rooms, resolution, TOLERANCE)
    points = reference.surface_points(rooms, POINTS, SEED)
    expected = _grid(truth, resolution)
    of = partial(Measurement, scene=f"rooms:{size}:{SEED}", splats=size, resolution=resolution)
    methods: dict[str, Judged] = {
        LIGHT: light, "density": reference.densities, "centres": reference.centres,
    }  # fmt: skip
    for state, splats in (("generated", generated), ("trained", as_trained(generated, SEED))):
        for method, judged in methods.items():
            yield Doing(f"{size:,} splats, {resolution:g} m, {state}, {method}", 0.0)
            keys, values = judged(splats, resolution)
            for threshold in THRESHOLDS[method]:
                found = np.sort(keys[values[:, 0] >= threshold])
                labels: dict[str, Any] = {"map": state, "method": method, "threshold": threshold}
                right = np.isin(found, truth).mean() if len(found) else 0.0
                yield of("precision of voxels", "share", right, **labels)
                seen = reference.met(points, found, resolution, TOLERANCE).mean()
                yield of("recall of voxels", "share", seen, **labels)
                if (method, threshold) == (LIGHT, CHOSEN):
                    for name, value in _compared(_grid(found, resolution), expected).items():
                        yield of(name, "share", value, map=state)


def _grid(keys: NDArray[np.int64], resolution: float) -> Grid:
    cells = reference.cells_of(keys).astype(np.int32)
    return grid_of(cells, resolution, BAND, 0.0, START)


def _compared(found: Grid, expected: Grid) -> dict[str, float]:
    """Precision and recall of a grid's occupied and free cells."""
    width = ROOMS * SIZE + 1  # of all that is looked at [m]
    maps = [_window(grid, width) for grid in (found, expected)]
    shares = {}
    for name, value in (("occupied", OCCUPIED), ("free", FREE)):
        ours, true = (cells == value for cells in maps)
        shares[f"precision of {name} cells"] = float((ours & true).sum() / max(1, ours.sum()))
        shares[f"recall of {name} cells"] = float((ours & true).sum() / max(1, true.sum()))
    return shares


def _window(grid: Grid, width: float) -> NDArray[np.int8]:
    """The same area of any grid: a square around the origin."""
    half = round(width / 2 / grid.resolution)
    window = np.full((2 * half, 2 * half), -1, np.int8)
    x, y = (round(corner / grid.resolution) + half for corner in grid.origin)
    rows, columns = grid.cells.shape
    window[y : y + rows, x : x + columns] = grid.cells
    return window


def _timed(size: int, resolution: float, budget: Budget) -> Iterator[Event]:
    splats = generate(size, SEED, 0, scene="rooms")
    put_in_slot_order(splats)
    of = partial(Measurement, scene=f"rooms:{size}:{SEED}", splats=size, resolution=resolution)
    voxels = OccupancyMap(resolution, ACROSS)

    def build(_: int) -> float:
        nonlocal voxels
        voxels = OccupancyMap(resolution, ACROSS)
        return milliseconds(lambda: rendering.insert_all(voxels, splats))

    built = np.array(budget.spend(build)) * 1e-3 / (size / 1e6)
    yield of("build", "s a million", built)
    rng = np.random.default_rng(SEED)
    revision = voxels.revision

    def edit(_: int) -> float:
        nonlocal revision
        revision += 1
        slots = rng.choice(size, EDITED, replace=False)
        some = splats[rng.choice(size, EDITED, replace=False)]
        return milliseconds(lambda: rendering.edit(voxels, rendering.UPSERT, slots, some, revision))

    yield of(f"edit of {EDITED:,} splats", "ms", budget.spend(edit))
    depth = depth_of(CHOSEN)

    def grid(_: int) -> float:
        return milliseconds(lambda: grid_of(voxels.find(depth)[0], resolution, BAND, 0.0, START))

    yield of("grid", "ms", budget.spend(grid))
    yield of("surface", "ms", budget.spend(lambda _: milliseconds(lambda: voxels.surface(depth))))
