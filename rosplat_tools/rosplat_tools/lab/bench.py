"""The real pipeline on a bench: one map, the sorter's backends, the renderer without rviz."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from rosplat_sorter import camera as sorter_camera
from rosplat_sorter.backends import BACKENDS, Backend, Unavailable, open_backend
from rosplat_sorter.depth import splat_extents
from rosplat_sorter.edits import REPLACE, Edit
from rosplat_sorter.map import SplatMap
from rosplat_sorter.view import View
from rosplat_tools.cameras import Camera
from rosplat_tools.lab.orders import Order
from rosplat_tools.splats import Splats
from rviz_gaussian_plugin.offscreen import OrderSource, Renderer, RenderSettings

Image = NDArray[np.float64]
T = TypeVar("T")

VIEW_ID = "lab"
EXACT = ("native", "numpy")  # whose orders are drawn where the backend is not the question
NO_SLOTS = np.zeros(0, np.uint32)


class Bench:
    """Shows maps, orders and draws them, and takes the times. One in a process.

    Raises RuntimeError where there is no display or no OpenGL 4.4.
    """

    def __init__(self, threads: int = 0, repeats: int = 3) -> None:
        """threads: of backends on the CPU, 0 for all. repeats: the fastest of so many counts."""
        self.renderer = Renderer()
        self.graphics: str = self.renderer.renderer_info
        self.repeats = repeats
        self.backends: dict[str, Backend] = {}
        self.unavailable: dict[str, str] = {}
        for name in BACKENDS:
            try:
                self.backends[name] = open_backend(name, threads)
            except Unavailable as reason:
                self.unavailable[name] = str(reason)
        self.splats: Splats
        self._maps = 0
        self._revision = 0
        self._sequence = 0

    def show(self, splats: Splats) -> None:
        """Replaces the map, in the renderer and in every backend."""
        if self._maps and splats is self.splats:
            return
        self.splats = splats
        self._maps += 1
        self._revision = 0
        self.edit(REPLACE, 0, splats)
        self.map = SplatMap()
        self.map.apply(
            Edit(
                map_id=str(self._maps), revision=1, frame_id="map", operation=REPLACE,
                origin=splats.origin, slots=slice(0, len(splats)), end=len(splats),
                positions=splats.positions,
                extents=splat_extents(splats.scales, splats.opacities), rejected=0,
            )
        )  # fmt: skip
        for backend in self.backends.values():
            backend.update(self.map, slice(0, len(splats)))

    def edit(self, operation: int, first: int, splats: Splats) -> None:
        """Sends a batch to the renderer alone: an edit that no sorter has heard of yet."""
        self._revision += 1
        self.renderer.apply(
            operation, first, len(splats), NO_SLOTS, splats.sh_degree, splats.antialiased,
            tuple(splats.origin), splats.positions.ravel(), splats.orientations.ravel(),
            splats.scales.ravel(), splats.opacities, splats.sh.ravel(),
            str(self._maps), self._revision,
        )  # fmt: skip

    def view(self, camera: Camera) -> View:
        """A camera as sorters need it."""
        x, y, z = camera.position
        return View.of(
            sorter_camera.Camera(
                (float(x), float(y), float(z)), tuple(camera.orientation), camera.fx, camera.fy,
                camera.cx, camera.cy, camera.width, camera.height, camera.near, camera.far,
                camera.orthographic,
            ),
            self.splats.origin,
        )  # fmt: skip

    def order(self, camera: Camera, backend: str = "") -> tuple[Order, float]:
        """A backend's order, by default of the first that there is in EXACT, and its time [ms]."""
        backend = backend or next(name for name in EXACT if name in self.backends)
        view = self.view(camera)
        slots, milliseconds = self.timed(lambda: self.backends[backend].order(view))
        return slots.copy(), milliseconds

    def draw(self, camera: Camera, order: Order | None, **settings: Any) -> tuple[Image, float]:
        """(height, width, 3) RGB over black of an order, and the time until it could be read [ms].

        order: None where the renderer is to sort on the GPU. settings: of RenderSettings, by name.
        Raises KeyError for one that the renderer lacks.
        """
        rendering = RenderSettings()
        for name, value in settings.items():
            if not hasattr(rendering, name):
                raise KeyError(f"the renderer has no setting {name}")
            setattr(rendering, name, value)
        if order is None:
            rendering.order = OrderSource.GPU
        self.renderer.settings = rendering
        best = float("inf")
        for left in reversed(range(self.repeats)):
            # What stays is not drawn again: each but the last looks a little past the camera.
            self._look(replace(camera, cx=camera.cx + 1e-3 * left), order)
            start = time.perf_counter()
            self.renderer.draw(VIEW_ID)
            pixels: NDArray[np.float32] = self.renderer.read_color()
            best = min(best, time.perf_counter() - start)
        _, reading = self.timed(self.renderer.read_color)  # nothing to wait for: the copy alone
        return pixels[..., :3].astype(np.float64), max(0.0, best * 1e3 - reading)

    def _look(self, camera: Camera, order: Order | None) -> None:
        """Tells the renderer of a camera and of its order, and uploads what the map still lacks."""
        self._sequence += 1
        self.renderer.set_camera(
            VIEW_ID, self._sequence, tuple(camera.position), tuple(camera.orientation),
            int(camera.orthographic), camera.fx, camera.fy, camera.cx, camera.cy,
            camera.width, camera.height, camera.near, camera.far,
        )  # fmt: skip
        if order is not None:
            self.renderer.set_order(
                VIEW_ID, self._sequence, str(self._maps), self._revision, "lab", 0.0, order
            )
        if not self.renderer.has_order(VIEW_ID) and order is not None:
            raise RuntimeError("the renderer refused the order")

    def timed(self, work: Callable[[], T]) -> tuple[T, float]:
        """What work answers, and the least of its times [ms]."""
        best = float("inf")
        for _ in range(self.repeats):
            start = time.perf_counter()
            result = work()
            best = min(best, time.perf_counter() - start)
        return result, best * 1e3
