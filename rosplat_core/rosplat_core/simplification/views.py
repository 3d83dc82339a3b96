"""Cameras that look at a map: from anywhere, or from along a path."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from rosplat_core.cameras import Camera, Place, look_at, place, resized
from rosplat_core.first_look import sample, views_within
from rosplat_core.simplification.merging import in_chunks
from rosplat_core.splats import InputError, Splats
from rosplat_core.upright import find_up

Point = NDArray[np.float64]

WIDTH, HEIGHT = 960, 540  # of views that maps are compared in [px]
FOCAL = 0.5 * HEIGHT / math.tan(math.radians(30))  # 60 degrees from top to bottom [px]
NEAREST, FARTHEST = 0.1, 2.5  # distances of cameras from the map's middle, in its radii
WIDEST = 1e9  # most radius of a map, so that 32-bit floats hold near planes [m]
REMOTEST = 1e12  # most distance of a map from zero, in its radii: cameras are in 64-bit floats
CELLS = 16  # of the grid that tells free places, in a radius
OPAQUE = 0.3  # least opacity of splats that no camera is put beside
PATIENCE = 64  # tries to find a free place for a camera
ORBITS = 0.5, 2.4  # distances of cameras around a map from its middle, in its radii
LOWEST, HIGHEST = -15, 75  # their elevations [deg]
OFF = 0.15  # standard deviation of what they look at from the middle, in radii
ASTRAY = 20  # by which cameras within are turned at most, each way [deg]
STRAY = 0.05  # by which they are moved at most, as a share of their view's depth
CHECKED = 40  # views that a search begins to check maps by
CHECKED_SEED = 1
LEAST_BETWEEN = 10  # cameras of a path from one that is held back to the next
MARGIN = 0.25  # of neighbours from the path, as a share of the way to the nearest splats
TURN = 10  # by which neighbours are turned at most [deg]
WIDE = 60  # to which pictures to learn from reach from their middle, unless they are wider [deg]
TURNED = 0.25  # share of the neighbours that look anywhere around
GOLDEN = (math.sqrt(5) - 1) / 2


def whereabouts(splats: Splats) -> Place:
    """Where the bulk of the splats is; its radius is at least two typical scales of a splat.

    Raises InputError where it is too wide, or too far from zero, for a camera to look at.
    """
    here = place(splats)
    away = float(np.abs(here.centre).max())
    if here.radius > WIDEST:
        raise InputError(f"the scene is {2 * here.radius:.1g} m wide: no camera can look at it")
    if away > REMOTEST * here.radius:
        raise InputError(
            f"the scene is {2 * here.radius:.1g} m wide and {away:.1g} m from zero: "
            "no camera can look at it"
        )
    largest = float(np.median(splats.scales.max(axis=1)))
    return Place(here.centre, min(max(here.radius, 2 * largest), WIDEST))


class Views(Protocol):
    """Views from which a map is looked at."""

    margin: float | None
    """Most distance of views from a path; None without a path. [m]"""
    path: list[Camera]
    """The path's own cameras; empty without a path."""
    unseen: float
    """Transmittance at which each splat counts as seen beside what such views see of it."""
    checked: list[Camera]
    """The views that a search begins to check maps by."""
    pixels: NDArray[np.floating[Any]]
    """(n,) size of a pixel at each splat. [m]"""

    def cameras(self, count: int, seed: int) -> list[Camera]:
        """The first count views of a seed; another seed gives other views."""

    def to_learn(self, count: int, seed: int) -> list[Camera]:
        """Views that see all that the views of this seed see, and what is just beside it."""


class Around:
    """Cameras where a map is looked at from.

    Within, where the map surrounds its free places, as rooms do. Else half of them look at its
    middle from around, each octave of the distance as often, and half are at free places, near and
    far, and look at some splat.
    """

    margin: float | None = None
    unseen: float = 0.03

    def __init__(self, splats: Splats) -> None:
        """Raises InputError, as whereabouts."""
        self._here = whereabouts(splats)
        self.path: list[Camera] = []
        radius = self._here.radius
        offsets = splats.positions + (splats.origin - self._here.centre)
        targets = offsets[np.linalg.norm(offsets, axis=1) <= radius].astype(np.float32)
        self._targets = targets if len(targets) else np.zeros((1, 3), np.float32)
        self._taken = _cells(offsets[splats.opacities >= OPAQUE], radius)
        self._up = np.asarray(splats.up or find_up(sample(splats)), np.float64)
        self._within = views_within(splats, self._up)
        self.pixels = np.broadcast_to(radius / FOCAL, len(splats))
        self.checked = self.cameras(CHECKED, CHECKED_SEED)

    def cameras(self, count: int, seed: int) -> list[Camera]:
        """The first count views of a seed; another seed gives other views."""
        random = np.random.default_rng(seed)
        kinds = [self._inside] if self._within else [self._orbiting, self._free]
        cameras = []
        for index in range(count):
            eye, target = kinds[index % len(kinds)](random)
            view = look_at(eye, target, self._up)
            cameras.append(
                Camera(
                    index, WIDTH, HEIGHT, FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2, view,
                    near=0.001 * self._here.radius,
                )
            )  # fmt: skip
        return cameras

    def to_learn(self, count: int, seed: int) -> list[Camera]:
        """The views themselves: any direction is as likely as another."""
        return self.cameras(count, seed)

    def _inside(self, random: np.random.Generator) -> tuple[Point, Point]:
        view = self._within[random.integers(len(self._within))]
        ahead = view.target - view.eye
        eye = view.eye + STRAY * np.linalg.norm(ahead) * random.uniform() * _direction(random)
        yaw, pitch = np.radians(random.uniform(-ASTRAY, ASTRAY, 2))
        aside = np.cross(ahead, self._up)
        turn = Rotation.from_rotvec(yaw * self._up / np.linalg.norm(self._up))
        turn *= Rotation.from_rotvec(pitch * aside / np.linalg.norm(aside))
        return eye, eye + turn.apply(ahead)

    def _orbiting(self, random: np.random.Generator) -> tuple[Point, Point]:
        radius, centre = self._here.radius, self._here.centre
        low, high = np.sin(np.radians([LOWEST, HIGHEST]))
        up = self._up / np.linalg.norm(self._up)
        for _ in range(PATIENCE):
            level = np.cross(up, _direction(random))
            level /= np.linalg.norm(level)
            height = random.uniform(low, high)
            outward = np.exp(random.uniform(*np.log(ORBITS))) * radius
            outward *= math.sqrt(1 - height**2) * level + height * up
            if not _beside(outward, self._taken, radius):
                break
        else:
            outward *= ORBITS[1] * radius / np.linalg.norm(outward)
        return centre + outward, centre + OFF * radius * random.normal(size=3)

    def _free(self, random: np.random.Generator) -> tuple[Point, Point]:
        radius, centre = self._here.radius, self._here.centre
        for _ in range(PATIENCE):
            outward = random.uniform(NEAREST, FARTHEST) * radius * _direction(random)
            target = self._targets[random.integers(len(self._targets))]
            far_enough = np.linalg.norm(outward - target) > NEAREST * radius
            if far_enough and not _beside(outward, self._taken, radius):
                break
        else:
            outward *= FARTHEST * radius / np.linalg.norm(outward)
        return centre + outward, centre + target


class Along:
    """Cameras along a path, and neighbours of them: beside the path, and turned."""

    unseen: float = 3e-5  # tells which goes first of what no view sees, and no more

    def __init__(self, splats: Splats, path: Sequence[Camera], margin: float | None = None) -> None:
        """margin: most distance of neighbours from the path [m], by default MARGIN of the median
        distance from the path to the nearest opaque splats. Raises InputError for an empty path.
        """
        if not path:
            raise InputError("the path has no camera")
        self.path = path = [resized(camera, WIDTH * HEIGHT) for camera in path]
        away, free = _clearances(splats, np.array([camera.position for camera in path]))
        self.margin: float | None = MARGIN * float(np.median(free)) if margin is None else margin
        focal = float(np.median([max(camera.fx, camera.fy) for camera in path]))
        depth = 1.0 if path[0].orthographic else np.maximum(away, path[0].near)
        self.pixels = np.broadcast_to(depth / focal, len(splats))
        up = -np.mean([camera.world_to_camera[1, :3] for camera in path], axis=0)
        self._up = up / max(float(np.linalg.norm(up)), 1e-9)
        every = max(LEAST_BETWEEN, math.ceil(len(path) / (CHECKED // 2)))
        learnt = np.arange(len(path)) % every != every // 2
        self._learnt = [path[i] for i in np.flatnonzero(learnt)]
        self._reach = np.minimum(self.margin, free[learnt] / 2)
        self.checked = [path[i] for i in np.flatnonzero(~learnt)]
        self.checked += self.cameras(CHECKED - len(self.checked), CHECKED_SEED)

    def cameras(self, count: int, seed: int) -> list[Camera]:
        """The first count views of a seed; another seed gives other views."""
        random = np.random.default_rng(seed)
        start = random.uniform()
        cameras = []
        for index in range(count):
            # Steps of the golden ratio spread evenly, however many there are.
            number = int(len(self._learnt) * ((start + GOLDEN * index) % 1))
            camera, reach = self._learnt[number], self._reach[number]
            aside = reach * random.uniform() ** (1 / 3) * _direction(random)
            turn = Rotation.from_rotvec(math.radians(TURN) * random.uniform() * _direction(random))
            around = 2 * math.pi * random.uniform()
            if random.uniform() < TURNED:
                turn *= Rotation.from_rotvec(around * self._up)
            moved = np.eye(4)
            moved[:3, :3] = camera.world_to_camera[:3, :3] @ turn.as_matrix()
            moved[:3, 3] = -moved[:3, :3] @ (camera.position + aside)
            cameras.append(replace(camera, world_to_camera=moved))
        return cameras

    def to_learn(self, count: int, seed: int) -> list[Camera]:
        """These see TURN more on each side: what few turns bring in is in all of their pictures."""
        return [_wider(camera, TURN) for camera in self.cameras(count, seed)]


def _wider(camera: Camera, by: float) -> Camera:
    """The camera with a picture that reaches so much farther on each side, WIDE at most. [deg]"""
    if camera.orthographic or camera.model:  # of a panorama
        return camera
    reach = np.array([camera.cx, camera.cy, camera.width - camera.cx, camera.height - camera.cy])
    focal = np.array([camera.fx, camera.fy] * 2)
    angles = np.arctan(reach / focal)
    angles = np.maximum(angles, np.minimum(angles + math.radians(by), math.radians(WIDE)))
    left, top, right, bottom = focal * np.tan(angles)
    return replace(
        camera, width=math.ceil(left + right), height=math.ceil(top + bottom), cx=left, cy=top
    )


def _clearances(
    splats: Splats, places: NDArray[np.float64]
) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    """(n,) from each splat to the nearest place, (m,) from each place to the nearest opaque. [m]"""
    places = places - splats.origin
    tree = cKDTree(places)
    away = np.empty(len(splats), np.float32)
    opaque = splats.opacities >= min(OPAQUE, splats.opacities.max())

    def find(part: slice) -> Point:
        """Upper bounds: a place's nearest splat may be nearer to another."""
        distances, nearest = tree.query(splats.positions[part])
        away[part] = distances
        bounds = np.full(len(places), np.inf)
        np.minimum.at(bounds, nearest[opaque[part]], distances[opaque[part]])
        return bounds

    bounds = np.min(in_chunks(len(splats), find), axis=0)
    reach = bounds[np.isfinite(bounds)].max()
    near = splats.positions[opaque & (away <= np.float32(reach))]
    return away, np.minimum(cKDTree(near).query(places)[0], reach)


def _direction(random: np.random.Generator) -> NDArray[np.float64]:
    """(3,) of unit length, each as likely."""
    direction = random.normal(size=3)
    return direction / np.linalg.norm(direction)


def _cells(offsets: NDArray[np.float64], radius: float) -> NDArray[np.bool_]:
    """Which cells of a grid around the middle hold an offset; it reaches past all cameras."""
    half = math.ceil((FARTHEST + 1) * CELLS)
    taken = np.zeros((2 * half, 2 * half, 2 * half), bool)
    cells = _cell(offsets[np.abs(offsets).max(axis=1, initial=0) < half * radius / CELLS], radius)
    taken[tuple(cells.T)] = True
    return taken


def _beside(offset: NDArray[np.float64], taken: NDArray[np.bool_], radius: float) -> bool:
    """Whether a place's cell, or one that touches it, is taken."""
    x, y, z = _cell(offset, radius)
    return bool(taken[x - 1 : x + 2, y - 1 : y + 2, z - 1 : z + 2].any())


def _cell(offsets: NDArray[np.float64], radius: float) -> NDArray[np.intp]:
    half = math.ceil((FARTHEST + 1) * CELLS)
    return half + np.floor(offsets * (CELLS / radius)).astype(np.intp)
