"""Renderers to be measured: the display's, the processor's rasteriser, and others.

Each renderer to hold beside the display's has a class, and a row in RENDERERS. Knows no rviz and no
ROS.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from rosplat_core import rendering
from rosplat_core.cameras import Camera
from rosplat_core.models import Model
from rosplat_core.rendering import MAP, RenderSettings, pose
from rosplat_core.splats import Splats
from rosplat_lab.bench.isolation import isolated
from rosplat_lab.bench.records import Budget, Event, Measurement, milliseconds

if TYPE_CHECKING:
    from rviz_gaussian_plugin.offscreen import Renderer as Offscreen

WARM_UP = 0.4  # of drawing, until a graphics card that had nothing to do has its full clock [s]


class Renderer(Protocol):
    """Holds a map and draws it. Making it raises ImportError or RuntimeError where it can't."""

    device: str
    """The name of what draws."""

    def set_map(self, splats: Splats) -> None:
        """Takes a map. Raises ValueError for one that it can't draw."""

    def set_camera(self, camera: Camera) -> None:
        """Takes the camera of the pictures to come."""

    def draw(self) -> None:
        """Sorts and draws; returns when the picture is whole."""

    def picture(self) -> NDArray[np.float32]:
        """The picture drawn last: premultiplied RGB over black, (height, width, 3)."""

    def graphics_memory(self) -> tuple[int, int] | None:
        """GPU memory of the map, and the most so far with what drawing took; None where there is
        none. [bytes]"""


def gl_finish() -> Callable[[], None]:
    """OpenGL's glFinish, of the context that is current: waits until all is drawn."""
    finish = ctypes.CDLL("libGL.so.1").glFinish
    finish.restype = None
    return lambda: finish()


class NumberedView:
    """A view of the renderer, whose cameras are numbered as the renderer wants it."""

    def __init__(self, renderer: Offscreen, name: str = "bench") -> None:
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


def accelerated() -> bool:
    """Whether a graphics card draws here. Needs a display. Raises RuntimeError where none draws."""
    (drawing,) = isolated(_hardware)
    return isinstance(drawing, Measurement) and "llvmpipe" not in drawing.gpu


def _hardware() -> Iterator[Event]:
    yield Measurement("", "", 0, gpu=DisplayRenderer().device)


def in_turn(renderer: Renderer, cameras: Sequence[Camera], budget: Budget) -> list[float]:
    """Times of frames with cameras in turn. [ms]"""

    def frame(number: int) -> float:
        renderer.set_camera(cameras[number % len(cameras)])
        return milliseconds(renderer.draw)

    return budget.spend(frame, WARM_UP)


class CpuRenderer:
    """The plugin's rasteriser on the processor. Its times include the copy into NumPy's arrays."""

    report: dict[str, Any]
    """Of the last picture: `splats` drawn, the `error` of their levels [px], and more."""

    def __init__(self) -> None:
        self.renderer = rendering.CpuRenderer()
        self.device = f"CPU, {self.renderer.instructions}"

    def use(self, values: dict[str, Any]) -> None:
        """Sets these settings, enumerations by name, and all others to their defaults."""
        self.renderer.settings = changed(values)

    def set_map(self, splats: Splats) -> None:
        rendering.insert_all(self.renderer, splats)

    def set_camera(self, camera: Camera) -> None:
        self._camera = rendering.posed(camera)

    def draw(self) -> None:
        self.report = self.renderer.draw(self._camera)

    def picture(self) -> NDArray[np.float32]:
        colour: NDArray[np.float32] = self.report["colour"]
        return colour[..., :3]

    def merge(self) -> dict[str, float]:
        """Brings the levels up to date with the map. Returns the `memory` that they take [bytes],
        and their number of `nodes` where it is known."""
        nodes = self.renderer.merge()
        return {"nodes": nodes, "memory": self.renderer.levels_bytes}

    def graphics_memory(self) -> None:
        return None


class DisplayRenderer:
    """The display's renderer, one in a process: by OpenGL, or by the processor in its own thread.

    Making it raises RuntimeError where it can't draw.
    """

    def __init__(self) -> None:
        from rviz_gaussian_plugin.offscreen import Renderer

        self.renderer = Renderer()
        self.device: str = self.renderer.renderer_info
        self.accelerated = "llvmpipe" not in self.device
        self.view = NumberedView(self.renderer)
        self.finish = gl_finish()
        self._small = NumberedView(self.renderer, "small")

    def use(self, values: dict[str, Any]) -> None:
        self.renderer.settings = changed(values)

    def set_map(self, splats: Splats) -> None:
        rendering.insert_all(self.renderer, splats)
        self.use({})
        self._draw_small()  # uploads all that waits

    def set_camera(self, camera: Camera) -> None:
        self.number, self._sorts = self.view.set_camera(camera), True

    def set_order(self, order: NDArray[np.uint32]) -> None:
        """Takes a sorter's order for the current camera."""
        self._sorts = False
        self.view.set_order(self.number, self.renderer.revision, order)

    def draw(self) -> None:
        self.report = self.view.draw(sort_now=self._sorts)
        self.finish()

    def picture(self) -> NDArray[np.float32]:
        colour: NDArray[np.float32] = self.renderer.read_color()
        return colour[..., :3]

    def merge(self) -> dict[str, float]:
        """As of CpuRenderer, with the upload of the nodes to a card. The small view keeps the
        levels, which go when no view wants them."""
        self.renderer.settings.detail = "1px"
        return {"memory": self._draw_small()["levels_bytes"]}

    def _draw_small(self) -> dict[str, Any]:
        self._small.set_camera(Camera(0, 16, 16, 16.0, 16.0, 8.0, 8.0, np.eye(4)))
        report = self._small.draw(sort_now=True)
        self.finish()
        return report

    def graphics_memory(self) -> tuple[int, int]:
        return self.report["map_bytes"], self.report["gpu_bytes"]


Ours = CpuRenderer | DisplayRenderer
"""A renderer of this project, with RenderSettings and levels of detail."""

GSPLAT: dict[Model, tuple[str, dict[str, Any]]] = {
    Model.EWA: ("rasterization", {}),
    Model.EWA_ANTIALIASED: ("rasterization", {"rasterize_mode": "antialiased"}),
    Model.RAY: ("rasterization", {"with_ut": True, "with_eval3d": True}),
    Model.DISC: ("rasterization_2dgs", {}),
}
"""gsplat's function for maps of a model, and what it is told."""


class GsplatRenderer:
    """gsplat's rasterisation by CUDA, without gradients, until its colours are on the GPU."""

    def __init__(self) -> None:
        import gsplat
        import torch

        if not torch.cuda.is_available():
            raise RuntimeError("torch finds no GPU")
        self._gsplat, self._torch = gsplat, torch
        self.device = f"{torch.cuda.get_device_name()}, gsplat {gsplat.__version__}"

    def set_map(self, splats: Splats) -> None:
        self._origin = splats.origin
        self._model = splats.model
        self._upload(
            self._put(splats.positions),
            self._put(np.roll(splats.orientations, 1, axis=1)),  # w first
            self._put(splats.scales),
            self._put(splats.opacities),
            self._put(splats.sh),
            splats.sh_degree,
        )
        self._torch.cuda.reset_peak_memory_stats()
        self._map_bytes = int(self._torch.cuda.memory_allocated())

    def set_camera(self, camera: Camera) -> None:
        view = camera.world_to_camera.copy()
        view[:3, 3] += view[:3, :3] @ self._origin
        lens = [[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]]
        self._camera = camera
        self._view, self._lens = self._put(view[None]), self._put(np.array([lens]))

    def draw(self) -> None:
        with self._torch.no_grad():
            self._drawn = self._rasterise(self._camera)
        self._torch.cuda.synchronize()

    def picture(self) -> NDArray[np.float32]:
        drawn: NDArray[np.float32] = self._drawn[0, ..., :3].float().cpu().numpy()
        return drawn

    def graphics_memory(self) -> tuple[int, int]:
        return self._map_bytes, int(self._torch.cuda.max_memory_allocated())

    def _put(self, values: NDArray[Any]) -> Any:
        return self._torch.from_numpy(np.ascontiguousarray(values, np.float32)).cuda()

    def _upload(
        self, means: Any, quats: Any, scales: Any, opacities: Any, sh: Any, degree: int
    ) -> None:
        self._splats = (means, quats, scales, opacities, sh)
        self._degree = degree

    def _rasterise(self, camera: Camera) -> Any:
        """The picture on the GPU, (1, height, width, 3 or more)."""
        function, settings = GSPLAT[self._model]
        return getattr(self._gsplat, function)(
            *self._splats, self._view, self._lens, camera.width, camera.height,
            near_plane=camera.near, far_plane=camera.far, sh_degree=self._degree, packed=False,
            **settings,
        )[0]  # fmt: skip


class GsplatInferenceRenderer(GsplatRenderer):
    """gsplat 1.6's experimental path for inference: half floats, macro tiles of 8 or 16 px."""

    def __init__(self, tile: int) -> None:
        super().__init__()
        from gsplat.experimental.render import GaussianInferenceRenderer
        from gsplat.scene import GaussianInferenceScene

        self._scene, self._renderer = GaussianInferenceScene, GaussianInferenceRenderer
        self._tile = tile

    def _upload(
        self, means: Any, quats: Any, scales: Any, opacities: Any, sh: Any, degree: int
    ) -> None:
        if self._model is not Model.EWA:
            raise ValueError(f"it draws {Model.EWA}, not {self._model}")
        unit = quats / quats.norm(dim=-1, keepdim=True)
        scene = self._scene.from_gaussian_tensors(
            means, unit, scales, opacities, sh, degree, "none", id="map"
        )
        self._native = self._renderer(scene, tile_size=self._tile)

    def _rasterise(self, camera: Camera) -> Any:
        return self._native.render(
            viewmats=self._view, Ks=self._lens, width=camera.width, height=camera.height,
            near_plane=camera.near, far_plane=camera.far,
        ).frame  # fmt: skip


RENDERERS: dict[str, Callable[[], Renderer]] = {
    "cpu": CpuRenderer,
    "gsplat": GsplatRenderer,
    "gsplat-inference-8": partial(GsplatInferenceRenderer, 8),
    "gsplat-inference-16": partial(GsplatInferenceRenderer, 16),
}
