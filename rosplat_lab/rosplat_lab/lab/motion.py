"""Cameras for the laboratory: where scenes are looked at from, and how the camera moves."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rosplat_core.cameras import Camera, orbit
from rosplat_core.splats import Splats

FRAME_RATE = 60.0  # [Hz]
TYPICAL = (5, 95)  # percentiles of the means that a scene's size is taken from


def typical_bounds(splats: Splats) -> NDArray[np.float64]:
    """(2, 3) box of a scene without its outliers. [m]"""
    lower, upper = np.percentile(splats.positions.astype(np.float64), TYPICAL, axis=0)
    return np.stack([lower, upper]) + splats.origin


def around(
    splats: Splats, count: int, up: ArrayLike, width: int = 640, height: int = 360
) -> list[Camera]:
    """count cameras around a scene, every other one at half the distance."""
    bounds = typical_bounds(splats)
    outer = orbit(bounds, count, width=width, height=height, up=up)
    target = bounds.mean(axis=0)
    return [
        camera if camera.id % 2 == 0 else dollied(camera, target, 0.5, camera.id)
        for camera in outer
    ]


def dollied(camera: Camera, target: ArrayLike, factor: float, number: int = 0) -> Camera:
    """The camera at so many times its distance from a point. [m]"""
    target = np.asarray(target, np.float64)
    return placed(camera, target + factor * (camera.position - target), number)


def placed(camera: Camera, position: ArrayLike, number: int = 0) -> Camera:
    """The camera somewhere else, looking the same way."""
    pose = camera.world_to_camera.copy()
    pose[:3, 3] = -pose[:3, :3] @ np.asarray(position, np.float64)
    return replace(camera, world_to_camera=pose, id=number)


def turned(camera: Camera, angle: float, pivot: ArrayLike | None = None) -> Camera:
    """The camera turned to its right about its vertical axis [rad], or about a pivot (3,) [m]."""
    cosine, sine = math.cos(angle), math.sin(angle)
    turn = np.eye(4)
    turn[[0, 0, 2, 2], [0, 2, 0, 2]] = cosine, -sine, sine, cosine
    if pivot is not None:
        centre = camera.world_to_camera @ np.append(np.asarray(pivot, np.float64), 1.0)
        turn[:3, 3] = centre[:3] - turn[:3, :3] @ centre[:3]
    return replace(camera, world_to_camera=turn @ camera.world_to_camera)


def before(camera: Camera, motion: str, speed: float, seconds: float, target: ArrayLike) -> Camera:
    """Where a moving camera was.

    motion: "rotation" about itself or "orbit" about target (3,) [m] at speed [rad/s], "dolly"
    towards target at speed of its present distance [1/s].
    """
    if motion == "rotation":
        return turned(camera, -speed * seconds)
    if motion == "orbit":
        return turned(camera, -speed * seconds, target)
    if motion == "dolly":
        return dollied(camera, target, 1 + speed * seconds, camera.id)
    raise ValueError(f"motion is {motion!r}, known are rotation, orbit, dolly")
