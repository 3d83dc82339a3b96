"""The renderer without rviz and without ROS: what measuring with it needs."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rosplat_lab.bench.records import Event, Measurement
from rosplat_tools.cameras import Camera
from rosplat_tools.splats import Splats

if TYPE_CHECKING:
    from rviz_gaussian_plugin.offscreen import Renderer

REPLACE, UPSERT, DELETE = 0, 1, 2
CHUNK = 8_000_000  # as the publisher sends [bytes]
MAP = "bench"
WARM_UP = 0.4  # of drawing, until a graphics card that had nothing to do has its full clock [s]


def open_renderer() -> Renderer:
    """The one of this process. Raises RuntimeError where it can't draw."""
    from rviz_gaussian_plugin.offscreen import Renderer

    return Renderer()


def hardware() -> Iterator[Event]:
    """One measurement that says what draws."""
    yield Measurement.of("", "", 0, gpu=open_renderer().renderer_info)


def gl_finish() -> Callable[[], None]:
    """OpenGL's glFinish, of the context that is current: waits until all is drawn."""
    finish = ctypes.CDLL("libGL.so.1").glFinish
    finish.restype = None
    return lambda: finish()


def pose(camera: Camera) -> tuple[Any, ...]:
    """A camera as renderers take it."""
    return (
        tuple(camera.position.tolist()), tuple(camera.orientation.tolist()),
        int(camera.orthographic), camera.fx, camera.fy, camera.cx, camera.cy,
        camera.width, camera.height, camera.near, camera.far,
    )  # fmt: skip


class View:
    """A view of the renderer, whose cameras are numbered as the renderer wants it."""

    def __init__(self, renderer: Renderer, name: str = "bench") -> None:
        self._renderer = renderer
        self.name = name
        self._sequence = 0

    def look(self, camera: Camera) -> int:
        """Poses the view's camera; returns its number."""
        self._sequence += 1
        self._renderer.set_camera(self.name, self._sequence, *pose(camera))
        return self._sequence

    def give(self, number: int, revision: int, slots: NDArray[np.uint32]) -> None:
        """Gives the renderer a sorter's order for a camera of this view and a map's revision."""
        self._renderer.set_order(self.name, number, MAP, revision, "bench", 0.0, slots)

    def draw(self, sort_now: bool = False) -> dict[str, Any]:
        """Draws, sorted in this call if sort_now; returns what the renderer reports."""
        report: dict[str, Any] = self._renderer.draw(self.name, sort_now=sort_now)
        return report


def batches(splats: Splats) -> Iterator[slice]:
    """The batches in which a publisher would send them."""
    step = max(1, CHUNK * len(splats) // max(1, splats.nbytes))
    for start in range(0, len(splats), step):
        yield slice(start, min(start + step, len(splats)))


def insert(renderer: Renderer, splats: Splats, part: slice, revision: int) -> None:
    """Gives the renderer a part of the splats, of slots alike; revision 1 begins the map."""
    renderer.apply(
        REPLACE if revision == 1 else UPSERT, part.start, part.stop - part.start, _NO_SLOTS,
        splats.sh_degree, splats.antialiased, tuple(splats.origin.tolist()),
        splats.positions[part].ravel(), splats.orientations[part].ravel(),
        splats.scales[part].ravel(), splats.opacities[part], splats.sh[part].ravel(),
        MAP, revision, len(splats),
    )  # fmt: skip


def insert_all(renderer: Renderer, splats: Splats) -> int:
    """Gives the renderer a map, batch by batch; returns the last one's revision."""
    revision = 0
    for revision, part in enumerate(batches(splats), 1):
        insert(renderer, splats, part, revision)
    return revision


def edit(
    renderer: Renderer, operation: int, slots: NDArray[np.integer], splats: Splats, revision: int
) -> None:
    """UPSERT: writes splats to these slots. DELETE: empties them; of no splats."""
    renderer.apply(
        operation, 0, len(slots), slots.astype(np.uint32),
        splats.sh_degree, splats.antialiased, tuple(splats.origin.tolist()),
        splats.positions.ravel(), splats.orientations.ravel(),
        splats.scales.ravel(), splats.opacities, splats.sh.ravel(), MAP, revision,
    )  # fmt: skip


_NO_SLOTS: NDArray[np.uint32] = np.zeros(0, np.uint32)


def put(settings: Any, values: dict[str, Any]) -> None:
    """Sets fields of RenderSettings, enumerations by name."""
    for name, value in values.items():
        members = getattr(type(getattr(settings, name)), "__members__", None)
        setattr(settings, name, members[value] if members else value)
