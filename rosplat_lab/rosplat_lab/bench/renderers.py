"""Renderers to time beside the display's own: a class each, and a row in RENDERERS."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from rosplat_core import rendering
from rosplat_core.cameras import Camera
from rosplat_core.splats import Splats


class Renderer(Protocol):
    """Holds a map and draws it. Making it raises ImportError or RuntimeError where it can't."""

    device: str
    """What draws."""

    def show(self, splats: Splats) -> None:
        """Takes a map."""

    def draw(self, camera: Camera) -> None:
        """Sorts and draws; returns when the picture is whole."""


class CpuRenderer:
    """The plugin's rasteriser on the processor. Its times include the copy into NumPy's arrays."""

    def __init__(self) -> None:

        self._camera = rendering.SplatCamera
        self._renderer = rendering.CpuRenderer()
        self.device = f"CPU, {self._renderer.instructions}"

    def show(self, splats: Splats) -> None:
        rendering.insert_all(self._renderer, splats)

    def draw(self, camera: Camera) -> None:
        self._renderer.draw(self._camera(*rendering.pose(camera)))


class GsplatRenderer:
    """gsplat's rasterisation by CUDA, without gradients, until its colours are on the GPU."""

    def __init__(self) -> None:
        import gsplat
        import torch

        if not torch.cuda.is_available():
            raise RuntimeError("torch finds no GPU")
        self._gsplat, self._torch = gsplat, torch
        self.device = f"{torch.cuda.get_device_name()}, gsplat {gsplat.__version__}"

    def show(self, splats: Splats) -> None:
        def put(values: NDArray[np.float32]) -> Any:
            return self._torch.from_numpy(np.ascontiguousarray(values)).cuda()

        self._origin = splats.origin
        self._degree = splats.sh_degree
        self._mode = "antialiased" if splats.antialiased else "classic"
        self._splats = [
            put(splats.positions),
            put(np.roll(splats.orientations, 1, axis=1)),  # w first
            put(splats.scales),
            put(splats.opacities),
            put(splats.sh),
        ]

    def draw(self, camera: Camera) -> None:
        torch = self._torch
        view = camera.world_to_camera.copy()
        view[:3, 3] += view[:3, :3] @ self._origin
        lens = [[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]]
        with torch.no_grad():
            self._gsplat.rasterization(
                *self._splats,
                torch.tensor(view[None], dtype=torch.float32, device="cuda"),
                torch.tensor([lens], dtype=torch.float32, device="cuda"),
                camera.width, camera.height, near_plane=camera.near, far_plane=camera.far,
                sh_degree=self._degree, packed=False, rasterize_mode=self._mode,
                camera_model="ortho" if camera.orthographic else "pinhole",
            )  # fmt: skip
        torch.cuda.synchronize()


RENDERERS: dict[str, Callable[[], Renderer]] = {"cpu": CpuRenderer, "gsplat": GsplatRenderer}
