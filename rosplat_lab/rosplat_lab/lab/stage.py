"""What the cases of the atlas share: what draws, scenes, cameras, errors."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rosplat_core import harmonics
from rosplat_core.cameras import Camera, look_at
from rosplat_core.splats import Splats
from rosplat_lab import reference
from rosplat_lab.bench.renderers import CpuRenderer, DisplayRenderer, Ours
from rosplat_lab.lab.orders import Order
from rosplat_lab.metrics import psnr

Image = NDArray[np.floating[Any]]

WIDTH, HEIGHT = 192, 128
PROCESSOR, SHADERS = "processor", "card"  # the rasteriser's vectors; the display's compute shaders


class Stage:
    """The renderers, one stage in a process: the processor's rasteriser, and a card's shaders,
    which Mesa runs where there is no card. Raises RuntimeError where there is no OpenGL."""

    def __init__(self, quick: bool) -> None:
        self.quick = quick
        self.display = DisplayRenderer()
        self.graphics = self.display.device

    def some(self, values: Sequence[float]) -> list[float]:
        """All values, or in quick runs three, ends included."""
        middle = values[round((len(values) - 1) / 2)]
        return [values[0], middle, values[-1]] if self.quick else list(values)

    def shown(
        self, splats: Splats, camera: Camera, by: str, order: Order | None = None, **settings: Any
    ) -> Image:
        """(height, width, 3) RGB over black by PROCESSOR or SHADERS, in exact order unless one is
        given to the latter."""
        if by == PROCESSOR:
            renderer: Ours = CpuRenderer()
        else:
            renderer = self.display
            whose = "AUTO" if order is None else "SIDECAR"
            settings = {"rasterizer": "TILES", "order": whose} | settings
        renderer.set_map(splats)
        renderer.use(settings)
        if "detail" in settings:
            renderer.merge()
            renderer.use(settings)
        renderer.set_camera(camera)
        if order is not None:
            self.display.set_order(order)
        renderer.draw()
        return renderer.picture()

    def both(
        self, splats: Splats, camera: Camera, expected: Image, **settings: Any
    ) -> Iterator[tuple[str, float]]:
        """The PSNR of each of the two, by its name. [dB]"""
        for by in (PROCESSOR, SHADERS):
            yield by, decibels(self.shown(splats, camera, by, **settings), expected)


def cloud(count: int, size: float = 0.15, degree: int = 1) -> Splats:
    """Splats of all shapes and opacities in a ball of about a metre."""
    random = np.random.default_rng(0)
    turns = random.normal(size=(count, 4))
    return Splats(
        positions=random.normal(scale=0.4, size=(count, 3)).astype(np.float32),
        orientations=(turns / np.linalg.norm(turns, axis=1, keepdims=True)).astype(np.float32),
        scales=(size * random.uniform(0.05, 1, (count, 3))).astype(np.float32),
        opacities=random.uniform(0.1, 1, count).astype(np.float32),
        sh=random.normal(scale=0.3, size=(count, (degree + 1) ** 2, 3)).astype(np.float32),
    )


def floats(*values: float) -> NDArray[np.float32]:
    """Values as float32 (n,)."""
    return np.array(values, np.float32)


def balls(positions: ArrayLike, scale: ArrayLike, opacity: ArrayLike, colors: ArrayLike) -> Splats:
    """Unturned splats at (n, 3) with standard deviations and RGB that broadcast to (n, 3)."""
    positions = np.atleast_2d(np.asarray(positions, np.float64))
    n = len(positions)
    rgb = np.broadcast_to(np.asarray(colors, np.float64), (n, 3))
    return Splats(
        positions=positions.astype(np.float32),
        orientations=np.tile(floats(0, 0, 0, 1), (n, 1)),
        scales=np.broadcast_to(np.asarray(scale, np.float32), (n, 3)).copy(),
        opacities=np.broadcast_to(np.asarray(opacity, np.float32), n).copy(),
        sh=((rgb - 0.5) / harmonics.C0)[:, None].astype(np.float32),
    )


def ahead(fov: float = 0.9, **changes: Any) -> Camera:
    """At the origin, looking along z. fov: of the width. [rad]"""
    focal = WIDTH / 2 / math.tan(fov / 2)
    camera = Camera(0, WIDTH, HEIGHT, focal, focal, WIDTH / 2, HEIGHT / 2, np.eye(4))
    return replace(camera, **changes)


def outside(**changes: Any) -> Camera:
    """Looks at a cloud from two metres away."""
    return ahead(**({"world_to_camera": look_at((2.0, 1.0, 0.7), (0, 0, 0))} | changes))


def truth(splats: Splats, camera: Camera) -> Image:
    """(height, width, 3) by the reference renderer."""
    return reference.render(splats, camera).rgba[..., :3]


def decibels(picture: Image, expected: Image) -> float:
    """PSNR of what a screen shows; equal pictures count as MOST_PSNR."""
    return round(psnr(np.clip(picture, 0, 1), np.clip(expected, 0, 1)), 2)
