"""A flight around a map, and what an IMU and a camera aboard measure of it. Knows no ROS.

The robot circles the map with its nose to the middle, in waves and rolling and pitching a little,
so that every axis of the IMU has something to show. All is a function of time, with its derivatives
written out. REP-103: the world's z is up; the body's x is forward, y left, z up.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rosplat_core.cameras import Camera
from rosplat_core.quaternions import to_matrices
from rosplat_core.rigid import placed

Array = NDArray[np.float64]

GRAVITY = np.array([0.0, 0.0, -9.80665])

# Waves in a round, whole numbers so that the path closes, and their amplitudes: of BOBS in parts of
# the radius [1], of the others as angles [rad].
BOBS, BOB = 3, 0.06
ROLLS, ROLL = 5, 0.12
PITCHES, PITCH = 4, 0.07

CAMERA_OFFSET = 0.1  # by which the camera is ahead of the IMU [m]
FIELD_OF_VIEW = 1.0  # of the picture's height [rad]


@dataclass(frozen=True)
class Attitude:
    """A rotation: roll about x, then pitch about y, then yaw about z. [rad]"""

    roll: float
    pitch: float
    yaw: float

    @property
    def rotation(self) -> Array:
        """(3, 3) from the rotated frame to the one it is rotated in."""
        return to_matrices(self.quaternion)

    @property
    def quaternion(self) -> tuple[float, float, float, float]:
        """The same rotation as x, y, z, w."""
        (sr, cr), (sp, cp), (sy, cy) = (
            _sin_cos(angle / 2) for angle in (self.roll, self.pitch, self.yaw)
        )
        return (
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
            cr * cp * cy + sr * sp * sy,
        )


@dataclass(frozen=True, eq=False)
class Motion:
    """Where the body is at one moment, and how it moves."""

    position: Array
    """(3,) in the world. [m]"""
    attitude: Attitude
    """Of the body in the world."""
    acceleration: Array
    """(3,) in the world, without gravity. [m/s^2]"""
    angular_velocity: Array
    """(3,) of the body in the world, along the body's axes. [rad/s]"""

    @property
    def specific_force(self) -> Array:
        """(3,) what an accelerometer reads along the body's axes: at rest, +g upward. [m/s^2]"""
        force: Array = self.attitude.rotation.T @ (self.acceleration - GRAVITY)
        return force


@dataclass(frozen=True, eq=False)
class Flight:
    """A closed path at height [m] over a centre (3,) [m], radius [m] away, period [s] a round."""

    centre: Array
    radius: float
    height: float
    period: float

    @classmethod
    def around(cls, positions: Array, period: float) -> Flight:
        """A flight around the middle of positions (n, 3) [m], which a few far ones don't change."""
        low, high = np.quantile(positions, [0.05, 0.95], axis=0)
        reach = max(float(np.linalg.norm(high - low)) / 2, 0.01)
        return cls((low + high) / 2, 1.2 * reach, 0.5 * reach, period)

    def at(self, seconds: float) -> Motion:
        """The motion at a time; a whole number of periods later it is the same. [s]"""
        rate = 2 * math.pi / self.period
        turn = rate * (seconds % self.period)
        rise, rise_2 = _wave(turn, BOBS, BOB * self.radius)[::2]
        roll, roll_1, _ = _wave(turn, ROLLS, ROLL)
        pitch, pitch_1, _ = _wave(turn, PITCHES, PITCH)
        outward = np.array([math.cos(turn), math.sin(turn), 0.0])
        up = np.array([0.0, 0.0, 1.0])
        # From the rates of yaw, pitch and roll to the body's axes.
        (sr, cr), (sp, cp) = _sin_cos(roll), _sin_cos(pitch)
        angular_velocity = np.array([roll_1 - sp, cr * pitch_1 + sr * cp, -sr * pitch_1 + cr * cp])
        return Motion(
            position=self.centre + self.radius * outward + (self.height + rise) * up,
            attitude=Attitude(roll, pitch, turn + math.pi),
            acceleration=rate**2 * (rise_2 * up - self.radius * outward),
            angular_velocity=rate * angular_velocity,
        )

    @property
    def mount(self) -> Attitude:
        """Attitude of the optical frame on the body, CAMERA_OFFSET ahead: it faces the centre."""
        down = math.atan2(self.height, self.radius)
        return Attitude(-math.pi / 2 - down, 0.0, -math.pi / 2)

    def camera(self, motion: Motion, width: int, height: int) -> Camera:
        """The camera aboard, for a picture of width x height. [px]"""
        body = motion.attitude.rotation
        eye = placed(motion.position + CAMERA_OFFSET * body[:, 0], body @ self.mount.rotation)
        to_camera = np.asarray(np.linalg.inv(eye), np.float64)
        focal = height / 2 / math.tan(FIELD_OF_VIEW / 2)
        return Camera(0, width, height, focal, focal, width / 2, height / 2, to_camera)


def _wave(turn: float, count: int, size: float) -> tuple[float, float, float]:
    """size sin(count turn) and its first two derivatives by turn."""
    sin, cos = math.sin(count * turn), math.cos(count * turn)
    return size * sin, size * count * cos, -size * count**2 * sin


def _sin_cos(angle: float) -> tuple[float, float]:
    return math.sin(angle), math.cos(angle)
