"""What the tests of renderers share: cameras, splats, what draws a map, how far pictures differ."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from geometry_msgs.msg import Pose
from numpy.typing import ArrayLike, NDArray
from std_msgs.msg import Header

from rosplat_core import rendering
from rosplat_core.cameras import Camera, look_at
from rosplat_core.models import Model
from rosplat_core.rendering import posed
from rosplat_core.splats import Splats
from rosplat_lab.bench.renderers import NumberedView
from rosplat_msgs.msg import GaussianArray
from rosplat_ros.messages import Slots
from rosplat_testing import messages

Array = NDArray[Any]


def camera_at(
    eye: tuple[float, float, float], target: ArrayLike = (0, 0, 0), **overrides: Any
) -> Camera:
    """A camera that looks at a place, from an eye relative to it. [m]"""
    fields = {
        "id": 0, "width": 190, "height": 130, "fx": 170.0, "fy": 170.0, "cx": 95.0, "cy": 65.0,
        "world_to_camera": look_at(np.add(target, eye), target),
    }  # fmt: skip
    return Camera(**(fields | overrides))


VIEWS: dict[str, dict[str, Any]] = {  # of camera_at()
    "outside": {"eye": (2.0, 1.0, 0.7)},
    "inside": {"eye": (0.2, 0.1, 0.1)},
    "off-centre": {"eye": (-1.5, 1.5, 1.0), "cx": 20.3, "cy": 99.6, "fx": 210.0},
    "orthographic": {"eye": (1.0, -2.0, 1.0), "orthographic": True, "fx": 60.0, "fy": 60.0},
}
CAMERAS = {name: camera_at(**view) for name, view in VIEWS.items()}


def cloud(model: Model = Model.EWA) -> Splats:
    """Anisotropic splats of all opacities, as packed slots hold them but for size and rotation."""
    random = np.random.default_rng(4)
    count = 600
    orientations = random.normal(size=(count, 4))
    return Splats(
        positions=random.normal(scale=0.4, size=(count, 3)).astype(np.float32),
        orientations=(orientations / np.linalg.norm(orientations, axis=1, keepdims=True)).astype(
            np.float32
        ),
        scales=(0.15 * random.uniform(0.02, 1, size=(count, 3)) ** 2).astype(np.float32),
        opacities=(random.integers(0, 65536, count) / 65535).astype(np.float32),
        sh=random.normal(scale=0.8, size=(count, 1, 3)).astype(np.float16).astype(np.float32),
        model=model,
    )


def draw(renderer: rendering.CpuRenderer, camera: Camera, **wanted: Any) -> dict[str, Any]:
    drawn: dict[str, Any] = renderer.draw(posed(camera), **wanted)
    return drawn


def decibels(picture: Array, expected: Array) -> float:
    """PSNR of what a screen could show, peak 1."""
    error = np.clip(picture, 0, 1).astype(np.float64) - np.clip(expected, 0, 1)
    return float(-10 * np.log10(np.mean(error**2) + 1e-300))


@dataclass
class Target:
    """A map that messages bring, and what draws it: the processor, or OpenGL in a view."""

    renderer: Any
    view: NumberedView | None = None
    map_id: int = 0
    revision: int = 0

    def set(self, **settings: Any) -> None:
        for name, value in settings.items():
            setattr(self.renderer.settings, name, value)

    def begin(self, splats: Splats | None = None) -> None:
        """A new map, of splats or empty."""
        self.map_id += 1
        self.revision = 0
        if splats is None:
            self._apply(GaussianArray(operation=GaussianArray.REPLACE, **self._next()))
        else:
            self.write(range(len(splats)), splats, operation=GaussianArray.REPLACE)

    def write(
        self,
        slots: Slots,
        splats: Splats,
        group: int = 0,
        operation: int = GaussianArray.UPSERT,
    ) -> None:
        self._apply(
            messages.encode(splats, slots, group=group, operation=operation, **self._next())
        )

    def delete(self, slots: Slots) -> None:
        self._apply(messages.encode_deletion(slots, **self._next()))

    def move(self, poses: Mapping[int, Pose]) -> None:
        self._apply(messages.encode_move(poses, **self._next()))

    def _next(self) -> dict[str, Any]:
        self.revision += 1
        return {"header": Header(), "map_id": str(self.map_id), "revision": self.revision}

    def _apply(self, batch: GaussianArray) -> None:
        self.renderer.apply(batch)

    def draw(self, camera: Camera = CAMERAS["outside"]) -> Array:
        """(height, width, 4) premultiplied RGBA."""
        if self.view is None:
            return draw(self.renderer, camera)["colour"]  # type: ignore[no-any-return]
        self.view.set_camera(camera)
        self.view.draw(sort_now=True)
        picture: Array = self.renderer.read_color()
        return picture
