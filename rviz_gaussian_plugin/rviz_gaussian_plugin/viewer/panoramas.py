"""Panoramas, which the processor draws, of a map of their own."""

from __future__ import annotations

import time
from queue import Empty, SimpleQueue

import numpy as np
from rclpy.node import Node

from rosplat_core.cameras import EQUIRECTANGULAR
from rosplat_core.lens_pictures import EXPECTED, LensPicture, take_picture
from rosplat_core.lens_warps import Warp
from rosplat_core.lenses import Lens
from rosplat_core.maps import Arrival
from rosplat_core.posed_camera import PosedCamera
from rosplat_core.rendering import CpuRenderer
from rosplat_core.view import frame_at
from rosplat_msgs.msg import GaussianArray, ViewCamera
from rosplat_ros.map_receiver import MapReceiver
from rosplat_ros.view_cameras import numbers

PATIENCE = 0.5  # how long a picture waits for the map [s]
MOST_PIXELS = 1 << 23


class Panoramas:
    """Hears the map once more: make it when the first panorama is asked for."""

    def __init__(self, node: Node) -> None:
        self.renderer = CpuRenderer()
        self._waiting: SimpleQueue[tuple[GaussianArray, Arrival]] = SimpleQueue()
        self._receiver = MapReceiver(node, lambda *batch: self._waiting.put(batch))

    def draw(self, message: ViewCamera, map_id: str, revision: int) -> tuple[LensPicture, bool]:
        """A picture, whose colours have an alpha, and whether it shows all of a revision of a map.

        Raises ValueError for a camera that can't be, naming the field.
        """
        position, orientation, _, *rest = numbers(message)
        camera = PosedCamera(position, orientation, False, *rest)
        width, height = camera.width, camera.height
        if width * height > MOST_PIXELS:
            raise ValueError(
                f"a panorama of {width} x {height} pixels, expected at most {MOST_PIXELS:,}"
            )
        focal, centre = (camera.fx, camera.fy), (camera.cx - 0.5, camera.cy - 0.5)
        warp = Warp(Lens(width, height, *focal, *centre, EQUIRECTANGULAR))
        world_to_lens = np.linalg.inv(frame_at(position, orientation)).astype(np.float64)
        whole = self._follow(map_id, revision)
        picture = take_picture(
            self.renderer, warp, world_to_lens,
            near=camera.near_clip, far=camera.far_clip, depth=EXPECTED, alpha=True,
        )  # fmt: skip
        return picture, whole

    def _follow(self, map_id: str, revision: int) -> bool:
        """Applies what has come, until that is all of a revision of the map; whether it is."""
        books, deadline = self.renderer.map, time.monotonic() + PATIENCE
        while True:
            whole = not (books.pulled or books.missed or self._receiver.pulling)
            if whole and (books.map_id, books.revision) == (map_id, revision):
                return True
            try:
                self.renderer.apply(
                    *self._waiting.get(timeout=max(deadline - time.monotonic(), 0.0))
                )
            except Empty:
                return False
            except MemoryError:
                self._receiver.pull_again()
                raise
            except ValueError:  # the viewer's own copy has refused the batch, too, and said so
                continue
