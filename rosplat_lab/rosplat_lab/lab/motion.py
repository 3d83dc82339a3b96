"""Cameras that move, for the laboratory."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from rosplat_core.cameras import Camera


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
