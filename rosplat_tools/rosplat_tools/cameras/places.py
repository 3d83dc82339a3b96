"""Places from which a map has been seen, and pictures found near them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from rosplat_core.cameras import Camera, load_cameras, load_trajectory
from rosplat_core.lens_warps import Straightened
from rosplat_core.relocalisation import Relocaliser
from rosplat_core.rendering import CpuRenderer
from rosplat_core.splats import InputError
from rosplat_tools.cameras.health import NoPicture, drawn
from rosplat_tools.cameras.refining import Refined
from rosplat_tools.cameras.taken_pictures import Taken

MOST_PLACES = 200  # of a file, evenly spread


class Places:
    """Poses of a file. Keeps their thumbnails while the map and the lens stay the same."""

    def __init__(self, path: str) -> None:
        """path: a camera file, a trajectory if it ends with .txt, or empty. Raises InputError."""
        cameras: list[Camera] = []
        if path:
            # Of a trajectory's camera, the pose alone counts.
            any_lens = Camera(0, 1, 1, 1.0, 1.0, 0.5, 0.5, np.eye(4))
            trajectory = Path(path).suffix == ".txt"
            cameras = load_trajectory(path, any_lens) if trajectory else load_cameras(path)
            if not cameras:
                raise InputError(f"{path}: holds no cameras")
        some = cameras[:: -(-len(cameras) // MOST_PLACES) or 1]
        self._poses = [camera.world_to_camera for camera in some]
        self._drawn: tuple[object, ...] = ()
        self._search: Relocaliser | None = None

    def found(self, renderer: CpuRenderer, taken: Taken[Straightened], patience: float) -> Refined:
        """Where a picture was taken; patience: as of Relocaliser. Raises NoPicture."""
        if not self._poses:
            raise NoPicture("without a pose", "the parameter places names no file")
        drawn_of = renderer.map.map_id, renderer.map.revision, taken.optics
        with drawn():
            if not self._search or self._drawn != drawn_of:
                camera = taken.camera(taken.optics.camera)
                self._search, self._drawn = Relocaliser(renderer, camera, self._poses), drawn_of
            colours, counts = taken.optics.picture(taken.colours, taken.counts)
            found = self._search.relocalise(colours, counts, patience=patience)
        return Refined.of(found, taken)
