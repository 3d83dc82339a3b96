"""Tells where a view is, and where it is about to be, from its cameras. Knows no ROS."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rosplat_core.posed_camera import CameraError, PosedCamera

AHEAD = 2.0  # how far to look ahead [s]
RECENT = 1.0  # cameras farther apart say nothing of how a view moves [s]


class FollowedView:
    """Expects a view to move on as between its last two cameras, for twice as long."""

    def __init__(self, camera: PosedCamera, now: float) -> None:
        """now: time of a steady clock [s]."""
        self._camera = camera
        self.heard = now
        self._speed = np.zeros(3)
        self._moves_until = now

    def move_to(self, camera: PosedCamera, now: float) -> None:
        """Takes the next camera."""
        since = now - self.heard
        if 0 < since < RECENT:
            with np.errstate(over="ignore"):
                self._speed = np.subtract(camera.position, self._camera.position) / since
            self._moves_until = now + 2 * since
        self._camera, self.heard = camera, now

    def cameras(self, now: float) -> list[PosedCamera]:
        """The view's camera; while it moves, also the camera expected in AHEAD seconds."""
        if now > self._moves_until or not self._speed.any():
            return [self._camera]
        x, y, z = (self._camera.position + AHEAD * self._speed).tolist()
        try:
            return [self._camera, replace(self._camera, position=(x, y, z))]
        except CameraError:  # so fast that its position overflows
            return [self._camera]
