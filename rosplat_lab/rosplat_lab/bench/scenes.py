"""Scenes to measure with, and cameras that move around them. Knows no ROS."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from rosplat_core.cameras import Camera, look_at, orbit, place
from rosplat_core.generated import rooms
from rosplat_core.harmonics import C0
from rosplat_core.scenes import PROCEDURAL, ROOMS, load_scene
from rosplat_core.slot_order import put_in_slot_order
from rosplat_core.splats import Splats

EYE = 1.6  # height of a person's eyes above a room's floor [m]
STEP = math.radians(1)  # by which the camera turns from picture to picture
PICTURES = ((1280, 720), (1920, 1080))


def load(name: str) -> Splats:
    """A scene by its name, or one of THIN, as publishers send it. Raises InputError."""
    splats = THIN[name]() if name in THIN else load_scene(name, lambda _: None, lambda _: None)
    put_in_slot_order(splats)
    return splats


def names(sizes: Sequence[int], scenes: Sequence[str]) -> list[str]:
    """Procedural scenes of these sizes, smallest first, then those by name."""
    return [f"{PROCEDURAL}{size}" for size in sorted(sizes)] + [*scenes]


def all_of_it(splats: Splats, width: int, height: int, count: int) -> list[Camera]:
    """From so far that every splat is in the picture."""
    bounds = np.stack([splats.positions.min(axis=0), splats.positions.max(axis=0)]) + splats.origin
    turns = round(2 * math.pi / STEP)
    return orbit(bounds, turns, width=width, height=height)[:count]


def _around(
    distance: float, elevation: float, fov: float,
    splats: Splats, width: int, height: int, count: int, step: float = STEP,
) -> list[Camera]:  # fmt: skip
    """Cameras at a distance in radii, looking at the centre; fov: height of the picture [deg]."""
    here = place(splats)
    focal = 0.5 * height / math.tan(math.radians(fov / 2))
    level, up = math.cos(elevation), math.sin(elevation)
    cameras = []
    for index in range(count):
        turn = 0.6 + index * step
        outward = np.array([level * math.cos(turn), level * math.sin(turn), up])
        eye = here.centre + distance * here.radius * outward
        cameras.append(
            Camera(
                index, width, height, focal, focal, width / 2, height / 2,
                look_at(eye, here.centre), near=0.001 * here.radius,
            )
        )  # fmt: skip
    return cameras


overview = partial(_around, 2.5, 0.35, 45)
"""The bulk of the scene fills the picture, as the embedded viewer begins."""
inside = partial(_around, 0.6, 0.3, 60)
"""From within the scene, where much of it is beside or behind the camera."""


def room(splats: Splats, width: int, height: int, count: int) -> list[Camera]:
    """From the door of the middle room of generated rooms: walls hide most of the others."""
    x, y = rooms.middle(1, 1)
    return _turning(
        (x - 1.7, y + rooms.DOOR_ASIDE, EYE), (x + 1, y + 0.9, 0.8), width, height, count
    )


def eye_level(splats: Splats, width: int, height: int, count: int) -> list[Camera]:
    """Along the row of doors of generated rooms: through some walls, past others."""
    x, y = rooms.middle(0, 1)
    eye = (x - 1.8, y + rooms.DOOR_ASIDE, EYE)
    return _turning(eye, (eye[0] + 4, eye[1], EYE - 0.3), width, height, count)


Motion = Callable[[Splats, int, int, int], list[Camera]]
"""Cameras that turn around a scene by STEP from one to the next: splats, width, height, count."""

VIEWS: dict[str, Motion] = {
    "all": all_of_it,
    "overview": overview,
    "inside": inside,
    "room": room,
    "eye level": eye_level,
}


def views(name: str) -> tuple[str, ...]:
    """The VIEWS that a scene's frames are measured in."""
    return ("room", "eye level", "overview") if name.startswith(ROOMS) else ("overview", "inside")


def placed(camera: Camera, position: ArrayLike) -> Camera:
    """The camera somewhere else, looking the same way."""
    pose = camera.world_to_camera.copy()
    pose[:3, 3] = -pose[:3, :3] @ np.asarray(position, np.float64)
    return replace(camera, world_to_camera=pose)


def turned(camera: Camera, angle: float) -> Camera:
    """The camera turned to its right about its vertical axis. [rad]"""
    cosine, sine = math.cos(angle), math.sin(angle)
    turn = np.eye(4)
    turn[[0, 0, 2, 2], [0, 2, 0, 2]] = cosine, -sine, sine, cosine
    return replace(camera, world_to_camera=turn @ camera.world_to_camera)


def _turning(
    eye: tuple[float, ...], target: tuple[float, ...], width: int, height: int, count: int
) -> list[Camera]:
    """Cameras at one place, of which the first looks at target. [m]"""
    focal = 0.5 * height / math.tan(math.radians(60 / 2))
    across, along, down = np.subtract(target, eye)
    heading, distance = math.atan2(along, across), math.hypot(across, along)
    cameras = []
    for index in range(count):
        turn = heading + index * STEP
        ahead = [distance * math.cos(turn), distance * math.sin(turn), down]
        transform = look_at(eye, np.add(eye, ahead))
        cameras.append(Camera(index, width, height, focal, focal, width / 2, height / 2, transform))
    return cameras


# --- Scenes of thin things, which fill little of a picture ----------------------------------------


def wires() -> Splats:
    """Eight wires that hang between two rows of poles, of uneven grey, and nothing else."""
    number, along = np.divmod(np.arange(8 * 600), 600)
    along = (along + 0.5) / 300 - 1
    sag = 1 - (0.1 + 0.02 * number) * (1 - along**2)
    pole, up = np.divmod(np.arange(16 * 60), 60)
    grey = np.random.default_rng(0).uniform(0.2, 0.5, len(along))
    return _scene(
        ([2 * along, 0.3 * (number - 3.5), sag], (0.005, 0.002, 0.002), grey),
        ([2 - 4 * (pole % 2), 0.3 * (pole // 2 - 3.5), up / 60], (0.01, 0.01, 0.02), 0.35),
    )


def fence() -> Splats:
    """Thin dark wires, across and upright, with bright inlays, above a bare ground."""
    random = np.random.default_rng(0)
    number, along = np.divmod(np.arange(60 * 80), 80)
    across = number % 2 == 1
    place = (number + 0.5) / 60 - 0.5
    along = (along + 0.5) / 80 - 0.5
    thin = np.full((len(along), 3), 0.002)
    thin[np.arange(len(along)), np.where(across, 0, 2)] = np.where(across, 0.025, 0.0125)
    grey = np.where(random.uniform(size=len(along)) < 0.1, 0.9, 0.25)
    x, z = np.where(across, 4 * along, 4 * place), 1 + np.where(across, 2 * place, 2 * along)
    ground = random.uniform(-2.5, 2.5, (1500, 2)).T
    return _scene(
        ([x, 0.02 * across, z], thin, grey),
        ([*ground, np.zeros(1500)], (0.08, 0.08, 0.005), random.uniform(0.2, 0.3, 1500)),
    )


def inlays() -> Splats:
    """A dark, grained board with frets and small bright inlays on both of its faces."""
    random = np.random.default_rng(0)
    board = random.uniform(-2, 2, 6000), random.uniform(-0.3, 0.3, 6000)
    fret, across = np.divmod(np.arange(24 * 40), 40)
    dots = random.uniform(-2, 2, 400), random.normal(0, 0.05, 400)
    face = np.split(random.choice([-1, 1], 7360), (6000, 6960))
    grain = random.uniform(0.1, 0.2, 6000)
    return _scene(
        ([*board, 0.05 * face[0]], (0.03, 0.03, 0.003), grain),
        ([fret / 6 - 1.92, (across - 19.5) / 66, 0.058 * face[1]], (0.004, 0.01, 0.004), 0.6),
        ([*dots, 0.056 * face[2]], (0.006, 0.006, 0.003), 0.95),
    )


def _scene(*parts: tuple[list[ArrayLike], ArrayLike, ArrayLike]) -> Splats:
    """Of parts: x, y and z, scales, and how bright they are."""
    places, scales, values = [], [], []
    for where, scale, value in parts:
        places.append(np.stack(where, axis=1))
        scales.append(np.broadcast_to(scale, places[-1].shape))
        values.append(np.broadcast_to(value, len(places[-1])))
    count = sum(map(len, places))
    sh = np.repeat((np.concatenate(values) - 0.5) / C0, 3).reshape(count, 1, 3).astype(np.float32)
    turns, opacities = np.tile([0, 0, 0, 1.0], (count, 1)), np.full(count, 0.9)
    return Splats(
        np.concatenate(places), turns, np.concatenate(scales), opacities, sh, up=(0, 0, 1)
    )


THIN = {"wires": wires, "fence": fence, "inlays": inlays}
