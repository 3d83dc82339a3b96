"""Scenes to measure with, and cameras that move around them. Knows no ROS."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from rosplat_core.cameras import Camera, Place, look_at, orbit, place
from rosplat_core.generated import rooms
from rosplat_core.scenes import PROCEDURAL, ROOMS, load_scene
from rosplat_core.slot_order import put_in_slot_order
from rosplat_core.splats import Splats
from rosplat_lab.bench.thin import THIN

EYE = 1.6  # height of a person's eyes above a room's floor [m]
STEP = math.radians(1)  # by which the camera turns from picture to picture
PICTURES = ((1280, 720), (1920, 1080))


def load(name: str) -> Splats:
    """A scene by its name, or one of THIN, as publishers send it. Raises InputError."""
    splats = THIN[name]() if name in THIN else load_scene(name, lambda _: None, lambda _: None)
    put_in_slot_order(splats)
    return splats


def names(sizes: tuple[int, ...], scenes: tuple[str, ...]) -> list[str]:
    """Procedural scenes of these sizes, smallest first, then those by name."""
    return [f"{PROCEDURAL}{size}" for size in sorted(sizes)] + list(scenes)


def all_of_it(splats: Splats, width: int, height: int, count: int) -> list[Camera]:
    """From so far that every splat is in the picture."""
    bounds = np.stack([splats.positions.min(axis=0), splats.positions.max(axis=0)]) + splats.origin
    turns = round(2 * math.pi / STEP)
    return orbit(bounds, turns, width=width, height=height)[:count]


def overview(
    splats: Splats, width: int, height: int, count: int, step: float = STEP
) -> list[Camera]:
    """The bulk of the scene fills the picture, as the embedded viewer begins."""
    return _around(place(splats), 2.5, 0.35, 45, width, height, count, step)


def inside(splats: Splats, width: int, height: int, count: int, step: float = STEP) -> list[Camera]:
    """From within the scene, where much of it is beside or behind the camera."""
    return _around(place(splats), 0.6, 0.3, 60, width, height, count, step)


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


def _around(
    here: Place, distance: float, elevation: float, fov: float,
    width: int, height: int, count: int, step: float,
) -> list[Camera]:  # fmt: skip
    """Cameras at a distance in radii, looking at the centre; fov: height of the picture [deg]."""
    focal = 0.5 * height / math.tan(math.radians(fov / 2))
    cameras = []
    for index in range(count):
        turn = 0.6 + index * step
        outward = np.array(
            [
                math.cos(elevation) * math.cos(turn),
                math.cos(elevation) * math.sin(turn),
                math.sin(elevation),
            ]
        )
        eye = here.centre + distance * here.radius * outward
        cameras.append(
            Camera(
                index, width, height, focal, focal, width / 2, height / 2,
                look_at(eye, here.centre), near=0.001 * here.radius,
            )
        )  # fmt: skip
    return cameras
