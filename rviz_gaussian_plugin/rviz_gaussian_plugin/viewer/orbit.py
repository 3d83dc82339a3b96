"""The bounds by which the embedded viewer frames a map, and a camera that orbits it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rosplat_core.cameras import Camera, look_at

if TYPE_CHECKING:
    from rosplat_core.first_look import FirstView

# Limits of the cameras that the renderer can draw from: 32-bit floats hold the squares of
# coordinates, and a near plane of 1e-9 to 1e9 m. A map may be larger, or its middle farther away.
NEAREST, FARTHEST = 1e-5, 1e17  # camera to target; FARTHEST also limits the target [m]
NEAR_PLANE = 1e9  # at most [m]
FAR_PLANE = 1e10  # at least [m]


def bounds(positions: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    """Centre and radius of the middle of (n, 3) positions, which a few far ones don't change. [m]

    Coordinates beyond FARTHEST count as FARTHEST.
    """
    positions = np.clip(positions, -FARTHEST, FARTHEST)
    positions = positions[~np.isnan(positions).any(axis=1)]
    if not len(positions):
        return np.zeros(3), 1.0
    low, high = np.quantile(positions, [0.01, 0.99], axis=0)
    return (low + high) / 2, max(float(np.linalg.norm(high - low)) / 2, 1e-3)


def _axes(up: NDArray[np.float64]) -> tuple[NDArray[np.float64], ...]:
    """The axes of yaw 0 and of a quarter turn from it, and the vertical, (3,) each."""
    up = up / np.linalg.norm(up)
    side = np.cross(up, [1.0, 0, 0] if abs(up[0]) < 0.9 else [0, 1.0, 0])
    side /= np.linalg.norm(side)
    return np.cross(side, up), side, up


@dataclass
class OrbitCamera:
    """A camera that looks at a point from somewhere on a sphere around it.

    inside: the map surrounds it, so it turns on the spot, and its zoom moves it and the point.
    """

    target: NDArray[np.float64]
    distance: float
    up: NDArray[np.float64]
    yaw: float = 0.6
    pitch: float = 0.35
    inside: bool = False

    def __post_init__(self) -> None:
        """Clamps the camera to where it can be drawn from; all that moves it does so, too."""
        self.target = np.clip(self.target, -FARTHEST, FARTHEST)
        self.distance = float(np.clip(self.distance, NEAREST, FARTHEST))

    @classmethod
    def of(cls, view: FirstView, width: int, height: int) -> OrbitCamera:
        """The camera of a view in a window of width x height, about its target."""
        away = view.eye_for(width, height) - view.target
        distance = float(np.linalg.norm(away))
        ahead, side, up = _axes(view.up)
        return cls(
            target=view.target, distance=distance, up=view.up,
            yaw=math.atan2(away @ side, away @ ahead),
            pitch=math.asin(float(np.clip(away @ up / max(distance, NEAREST), -1, 1))),
            inside=view.inside,
        )  # fmt: skip

    @classmethod
    def around(
        cls, centre: NDArray[np.float64], radius: float, up: NDArray[np.float64],
        width: int, height: int,
    ) -> OrbitCamera:  # fmt: skip
        """The camera whose picture of width x height a ball fits. [m]"""
        slope = math.tan(math.radians(22.5)) * min(1.0, width / height)
        return cls(target=centre, distance=radius / math.sin(math.atan(slope)), up=up)

    def camera(self, width: int, height: int) -> Camera:
        """The camera for a picture of width x height [px], with a view 45 degrees high."""
        outward = self._outward()
        # From the direction alone: far from 0, eye and target may round to the same point.
        transform = look_at(outward, np.zeros(3), self.up)
        transform[:3, 3] = -transform[:3, :3] @ (self.target + self.distance * outward)
        focal = 0.5 * height / math.tan(math.radians(22.5))
        return Camera(
            id=0, width=width, height=height, fx=focal, fy=focal, cx=width / 2, cy=height / 2,
            world_to_camera=transform, near=min(0.001 * self.distance, NEAR_PLANE),
            far=max(1000 * self.distance, FAR_PLANE),
        )  # fmt: skip

    def turn(self, right: float, down: float) -> None:
        """Turns around the target, or on the spot, by angles [rad]."""
        eye = self.target + self.distance * self._outward()
        self.yaw -= right
        self.pitch = float(np.clip(self.pitch + down, -1.55, 1.55))
        if self.inside:
            self.target = eye - self.distance * self._outward()
            self.__post_init__()

    def zoom(self, factor: float) -> None:
        """Multiplies the distance to the target, or moves ahead by as much."""
        if self.inside:
            self.target = self.target + (factor - 1) * self.distance * self._outward()
        else:
            self.distance *= factor
        self.__post_init__()

    def _outward(self) -> NDArray[np.float64]:
        """The direction from the target to the camera, (3,)."""
        ahead, side, up = _axes(self.up)
        around = math.cos(self.yaw) * ahead + math.sin(self.yaw) * side
        return math.cos(self.pitch) * around + math.sin(self.pitch) * up

    def pan(self, right: float, down: float) -> None:
        """Shifts the target by parts of the picture's height."""
        step = 2 * self.distance * math.tan(math.radians(22.5))
        rotation = self.camera(64, 64).camera_to_world[:3, :3]
        self.target = self.target - step * (right * rotation[:, 0] + down * rotation[:, 1])
        self.__post_init__()
