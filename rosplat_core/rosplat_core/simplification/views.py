"""Cameras that look at a map of which nothing is known but its splats."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from rosplat_core.cameras import Camera, Place, look_at, place
from rosplat_core.splats import SceneError, Splats

WIDTH, HEIGHT = 1280, 720  # [px]
FOCAL = 0.5 * HEIGHT / math.tan(math.radians(30))  # 60 degrees from top to bottom [px]
NEAREST, FARTHEST = 0.1, 2.5  # of cameras from the middle of the map, in its radii
WIDEST = 1e9  # radius of a map, so that near planes are those of 32-bit floats [m]
REMOTEST = 1e12  # of its radii, how far it is from zero: cameras are in 64-bit floats
CELLS = 16  # of the grid that tells free places, in a radius
OPAQUE = 0.3  # opacity of splats that no camera is put beside
PATIENCE = 64  # tries to find a free place for a camera


def whereabouts(splats: Splats) -> Place:
    """Where the bulk of the splats is, as large as they are where they lie in one place.

    Raises SceneError where it is too wide, or too far from zero, for a camera to look at.
    """
    here = place(splats)
    away = float(np.abs(here.centre).max())
    if here.radius > WIDEST:
        raise SceneError(f"the scene is {2 * here.radius:.1g} m wide: no camera can look at it")
    if away > REMOTEST * here.radius:
        raise SceneError(
            f"the scene is {2 * here.radius:.1g} m wide and {away:.1g} m from zero: "
            "no camera can look at it"
        )
    largest = float(np.median(splats.scales.max(axis=1)))
    return Place(here.centre, min(max(here.radius, 2 * largest), WIDEST))


def views(
    splats: Splats, count: int, seed: int, width: int = WIDTH, height: int = HEIGHT
) -> list[Camera]:
    """Cameras at free places in and around the bulk of a map, each of which looks at some splat.

    The same seed has the same cameras; with another, no camera is the same.
    """
    random = np.random.default_rng(seed)
    here = whereabouts(splats)
    offsets = splats.positions + (splats.origin - here.centre)
    targets = offsets[np.linalg.norm(offsets, axis=1) <= here.radius]
    if not len(targets):
        targets = np.zeros((1, 3))
    taken = _cells(offsets[splats.opacities >= OPAQUE], here.radius)
    focal = FOCAL * height / HEIGHT
    cameras = []
    for index in range(count):
        for _ in range(PATIENCE):
            outward = random.normal(size=3)
            outward *= random.uniform(NEAREST, FARTHEST) * here.radius / np.linalg.norm(outward)
            target = targets[random.integers(len(targets))]
            far_enough = np.linalg.norm(outward - target) > NEAREST * here.radius
            if far_enough and not _beside(outward, taken, here.radius):
                break
        else:
            outward = FARTHEST * here.radius * outward / np.linalg.norm(outward)
        world_to_camera = look_at(here.centre + outward, here.centre + target)
        cameras.append(
            Camera(
                index, width, height, focal, focal, width / 2, height / 2, world_to_camera,
                near=0.001 * here.radius,
            )
        )  # fmt: skip
    return cameras


def _cells(offsets: NDArray[np.float64], radius: float) -> NDArray[np.bool_]:
    """In which cells of a grid around the middle something is, as far as cameras go and beyond."""
    half = math.ceil((FARTHEST + 1) * CELLS)
    taken = np.zeros((2 * half, 2 * half, 2 * half), bool)
    cells = _cell(offsets[np.abs(offsets).max(axis=1, initial=0) < half * radius / CELLS], radius)
    taken[tuple(cells.T)] = True
    return taken


def _beside(offset: NDArray[np.float64], taken: NDArray[np.bool_], radius: float) -> bool:
    """Whether something is in a place's cell or one that touches it."""
    x, y, z = _cell(offset, radius)
    return bool(taken[x - 1 : x + 2, y - 1 : y + 2, z - 1 : z + 2].any())


def _cell(offsets: NDArray[np.float64], radius: float) -> NDArray[np.intp]:
    half = math.ceil((FARTHEST + 1) * CELLS)
    return half + np.floor(offsets * (CELLS / radius)).astype(np.intp)
