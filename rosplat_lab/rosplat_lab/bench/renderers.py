"""Renderers to time beside the display's own: a class each, and a row in RENDERERS."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from rosplat_lab.bench import embedded
from rosplat_tools.cameras import Camera
from rosplat_tools.splats import Splats


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
        from rviz_gaussian_plugin import offscreen

        self._camera = offscreen.Camera
        self._renderer = offscreen.CpuRenderer()
        self.device = f"CPU, {self._renderer.instructions}"

    def show(self, splats: Splats) -> None:
        embedded.insert_all(self._renderer, splats)

    def draw(self, camera: Camera) -> None:
        self._renderer.draw(self._camera(*embedded.pose(camera)))


RENDERERS: dict[str, Callable[[], Renderer]] = {"cpu": CpuRenderer}
