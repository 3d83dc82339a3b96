"""The real pipeline on a bench: one map, the sorter's backends, the renderer without rviz."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rosplat_core.cameras import Camera
from rosplat_core.maps import REPLACE
from rosplat_core.posed_camera import PosedCamera
from rosplat_core.rendering import (
    OrderSource,
    Rasterizer,
    RenderSettings,
    insert,
    pose,
)
from rosplat_core.splats import Splats
from rosplat_core.view import SortView
from rosplat_lab.bench.baselines import Positions
from rosplat_lab.bench.baselines import Sort as Baseline
from rosplat_lab.bench.embedded import gl_finish
from rosplat_lab.lab.motion import FRAME_RATE
from rosplat_lab.lab.orders import Order
from rosplat_sorter.backends import BACKENDS, Backend, Unavailable, open_backend
from rosplat_sorter.map import SplatMap
from rviz_gaussian_plugin.offscreen import Renderer

Image = NDArray[np.float64]
Sort = Callable[["Bench", Camera], Order | None]
"""Finds an order; None where the renderer is to sort by itself."""

VIEW_ID = SOURCE = "lab"
PATIENCE = 0.5  # after so long a picture is made for the last time [s]
EXACT = ("native", "numpy")  # whose orders are drawn where the backend is not the question
NO_SLOTS = np.zeros(0, np.uint32)


@dataclass(frozen=True)
class Shot:
    """A picture and what it cost."""

    picture: Image
    """(height, width, 3) RGB over black."""
    sort_ms: float
    """Of finding the order, its share of a frame if several draw it."""
    draw_ms: float
    """Of uploading the order and drawing, until the graphics are done."""
    pose_ms: float
    """From a camera's pose until the picture drawn by its order is complete."""
    splats: int | None
    """How many were drawn; None where the renderer sorts."""


class Bench:
    """Shows maps, orders and draws them, and takes the times. One in a process.

    Raises RuntimeError where there is no display or no OpenGL 4.4.
    """

    def __init__(
        self, threads: int = 0, repeats: int = 3, renderer: Renderer | None = None
    ) -> None:
        """threads: of backends on the CPU, 0 for all. repeats: the fastest of so many counts.
        renderer: one that there is, of which a process can have one."""
        self.renderer = renderer or Renderer()
        self.graphics: str = self.renderer.renderer_info
        self.accelerated = "llvmpipe" not in self.graphics
        self._finish = gl_finish()
        self.repeats = repeats
        self.backends: dict[str, Backend] = {}
        self.unavailable: dict[str, str] = {}
        try:
            for name in BACKENDS:
                try:
                    self.backends[name] = open_backend(name, threads)
                except Unavailable as reason:
                    self.unavailable[name] = str(reason)
        except BaseException:
            self.close()
            raise
        self.splats: Splats
        self._baselines: dict[object, Baseline] = {}
        self._maps = 0
        self._revision = 0
        self._sequence = 0

    def close(self) -> None:
        """Closes the renderer's window, which must be before its display closes."""
        del self.renderer

    def show(self, splats: Splats) -> None:
        """Replaces the map, in the renderer and in every backend."""
        if self._maps and splats is self.splats:
            return
        self.splats = splats
        self._baselines.clear()
        self._maps += 1
        self._revision = 0
        self.edit(REPLACE, 0, splats)
        self.map = SplatMap()
        insert(self.map, splats, slice(0, len(splats)), 1)
        for backend in self.backends.values():
            backend.update(self.map, slice(0, self.map.rows))

    def edit(self, operation: int, first: int, splats: Splats) -> None:
        """Sends a batch to the renderer alone: an edit that no sorter has heard of yet."""
        self._revision += 1
        self.renderer.apply(
            operation, first, len(splats), NO_SLOTS, splats.sh_degree, splats.antialiased,
            tuple(splats.origin), splats.positions.ravel(), splats.orientations.ravel(),
            splats.scales.ravel(), splats.opacities, splats.sh.ravel(),
            str(self._maps), self._revision,
        )  # fmt: skip

    def view(self, camera: Camera) -> SortView:
        """A camera as sorters need it."""
        x, y, z = camera.position
        return SortView.of(
            PosedCamera(
                (float(x), float(y), float(z)), tuple(camera.orientation), camera.fx, camera.fy,
                camera.cx, camera.cy, camera.width, camera.height, camera.near, camera.far,
                camera.orthographic,
            ),
            self.map.frames,
        )  # fmt: skip

    def order(self, camera: Camera, backend: str = "") -> Order:
        """A backend's order, by default of the first that there is in EXACT."""
        backend = backend or next(name for name in EXACT if name in self.backends)
        order: Order = self.backends[backend].order(self.view(camera)).copy()
        return order

    def baseline(self, make: Callable[[Positions], Baseline], camera: Camera) -> Order:
        """The order that another viewer's sort finds, of all slots."""
        if make not in self._baselines:
            self._baselines[make] = make(self.splats.positions)
        slots: Order = self._baselines[make](self.view(camera)).ravel().view(np.uint32)
        return slots

    def draw(self, camera: Camera, order: Order | None, **settings: Any) -> Image:
        """(height, width, 3) RGB over black of an order; None lets the renderer sort.

        settings: of RenderSettings, by name. Raises KeyError for one that the renderer lacks.
        """
        self._use(order is None, settings)
        self._look(camera, order)
        self._check(self.renderer.draw(VIEW_ID), order)
        pixels: NDArray[np.float32] = self.renderer.read_color()
        return pixels[..., :3].astype(np.float64)

    def shoot(self, camera: Camera, sort: Sort, age: int = 0, **settings: Any) -> Shot:
        """A picture by an order that is found for each of age + 1 frames and drawn age frames late.

        settings: as those of draw. Of each time the least of what the bench repeats.
        """
        times: list[tuple[float, float, float]] = []
        left = self.repeats
        while left:
            left = 0 if sum(posing for _, _, posing in times) > PATIENCE else left - 1
            # What stays is not drawn again: each but the last looks a little past the camera.
            looking = replace(camera, cx=camera.cx + 1e-3 * left)
            start = time.perf_counter()
            order = sort(self, looking)
            sorted_at = time.perf_counter()
            self._use(order is None, settings)
            self._look(looking, order)
            looked = time.perf_counter()
            drawn = self.renderer.draw(VIEW_ID)
            self._finish()
            end = time.perf_counter()
            times.append((sorted_at - start, end - looked, end - start))
        sorting, drawing, posing = map(min, zip(*times, strict=True))
        self._check(drawn, order)
        pixels: NDArray[np.float32] = self.renderer.read_color()
        return Shot(
            pixels[..., :3].astype(np.float64),
            0.0 if order is None else 1e3 * sorting / (age + 1),
            1e3 * drawing,
            1e3 * (posing + age / FRAME_RATE),
            None if order is None else len(order),
        )

    def _use(self, renderer_sorts: bool, settings: dict[str, Any]) -> None:
        rendering = RenderSettings()
        for name, value in settings.items():
            if not hasattr(rendering, name):
                raise KeyError(f"the renderer has no setting {name}")
            setattr(rendering, name, value)
        # Not Auto: a graphics card would then sort by itself whatever it is given.
        rendering.order = OrderSource.GPU if renderer_sorts else OrderSource.SIDECAR
        self.renderer.settings = rendering

    def _check(self, drawn: dict[str, Any], order: Order | None) -> None:
        """Raises RuntimeError where something else was drawn than what was asked for."""
        own = ("gpu", "processor")
        by = (SOURCE,) if order is not None else own
        if drawn["order_source"] not in by or not drawn["order_fresh"]:
            raise RuntimeError(f"the renderer drew the order of {drawn['order_source']}")
        wanted = self.renderer.settings.rasterizer
        if wanted != Rasterizer.AUTO and wanted.name.lower() != drawn["rasterizer"]:
            raise RuntimeError(f"the renderer drew in {drawn['rasterizer']}")

    def _look(self, camera: Camera, order: Order | None) -> None:
        """Tells the renderer of a camera and of its order, and uploads what the map still lacks."""
        self._sequence += 1
        self.renderer.set_camera(VIEW_ID, self._sequence, *pose(camera))
        if order is not None:
            self.renderer.set_order(
                VIEW_ID, self._sequence, str(self._maps), self._revision, SOURCE, 0.0, order
            )
        if not self.renderer.has_order(VIEW_ID) and order is not None:
            raise RuntimeError("the renderer refused the order")
