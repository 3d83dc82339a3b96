"""The renderer without rviz and without ROS: what measuring with it needs."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rosplat_core.cameras import Camera
from rosplat_core.rendering import MAP, RenderSettings, pose
from rosplat_lab.bench.records import Event, Measurement

if TYPE_CHECKING:
    from rviz_gaussian_plugin.offscreen import Renderer

WARM_UP = 0.4  # of drawing, until a graphics card that had nothing to do has its full clock [s]


def open_renderer() -> Renderer:
    """Makes the process's only renderer. Raises RuntimeError where it can't draw."""
    from rviz_gaussian_plugin.offscreen import Renderer

    return Renderer()


def hardware() -> Iterator[Event]:
    """One measurement, whose gpu says what draws."""
    yield Measurement.of("", "", 0, gpu=open_renderer().renderer_info)


def gl_finish() -> Callable[[], None]:
    """OpenGL's glFinish, of the context that is current: waits until all is drawn."""
    finish = ctypes.CDLL("libGL.so.1").glFinish
    finish.restype = None
    return lambda: finish()


class NumberedView:
    """A view of the renderer, whose cameras are numbered as the renderer wants it."""

    def __init__(self, renderer: Renderer, name: str = "bench") -> None:
        self._renderer = renderer
        self.name = name
        self._sequence = 0

    def set_camera(self, camera: Camera) -> int:
        """Poses the view's camera; returns its number."""
        self._sequence += 1
        self._renderer.set_camera(self.name, self._sequence, *pose(camera))
        return self._sequence

    def set_order(self, number: int, revision: int, slots: NDArray[np.uint32]) -> None:
        """Gives the renderer a sorter's order for a camera of this view and a map's revision."""
        self._renderer.set_order(self.name, number, MAP, revision, "bench", 0.0, slots)

    def draw(self, sort_now: bool = False) -> dict[str, Any]:
        """Draws, sorted in this call if sort_now; returns what the renderer reports."""
        report: dict[str, Any] = self._renderer.draw(self.name, sort_now=sort_now)
        return report


def changed(values: dict[str, Any]) -> RenderSettings:
    """The default settings but for these values, enumerations by name.

    Raises AttributeError for an unknown setting.
    """
    settings = RenderSettings()
    for name, value in values.items():
        members = getattr(type(getattr(settings, name)), "__members__", None)
        setattr(settings, name, members[value] if members else value)
    return settings
