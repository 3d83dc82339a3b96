"""Pictures of a map and a MuJoCo model by mujoco_warp, on the processor: the other that draws both.

Its splats have one colour for all directions, and stand still in the world of the model.
"""

from __future__ import annotations

from importlib.metadata import version
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rosplat_core import harmonics
from rosplat_core.quaternions import from_matrices, to_matrices
from rosplat_core.splats import Splats

NAME = "mujoco_warp"


class WarpCamera:
    """A camera of a MuJoCo model, through which mujoco_warp sees its bodies and a map."""

    def __init__(
        self, model: Any, data: Any, splats: Splats, map_pose: NDArray[np.float64], camera: str
    ) -> None:
        """map_pose: (4, 4) the map's pose in MuJoCo's world [m]. Raises ImportError."""
        import mujoco_warp
        import warp

        warp.config.log_level = warp.LOG_ERROR  # else it tells of all that it compiles
        self.name = f"{NAME} {version('mujoco-warp')}"
        self._warp, self._mujoco_warp = warp, mujoco_warp
        self._model = model
        place, turn = map_pose[:3, 3], map_pose[:3, :3]
        orientations = from_matrices(turn @ to_matrices(splats.orientations))
        colours = np.clip(0.5 + harmonics.C0 * splats.sh[:, 0], 0, 1)
        number = model.camera(camera).id
        width, height = model.cam_resolution[number].tolist()
        with warp.ScopedDevice("cpu"):
            self._warp_model = mujoco_warp.put_model(model)
            self._context = mujoco_warp.create_render_context(
                model,
                cam_active=[number],
                render_rgb=True,
                render_depth=True,
                splat_position=_floats((splats.positions + splats.origin) @ turn.T + place),
                splat_rotation=_floats(np.roll(orientations, 1, axis=1)),  # w first
                splat_scale=_floats(splats.scales),
                splat_rgba=_floats(np.column_stack([colours, splats.opacities])),
            )
            self._rgb = warp.empty((1, height, width), dtype=warp.vec3)
            self._depth = warp.empty((1, height, width), dtype=float)
        self.set_data(data)

    def set_data(self, data: Any) -> None:
        """Takes the state of the pictures to come."""
        with self._warp.ScopedDevice("cpu"):
            self._data = self._mujoco_warp.put_data(self._model, data)

    def render(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Colours (height, width, 3), 0 to 1, and depths (height, width) as it means them."""
        with self._warp.ScopedDevice("cpu"):
            self._mujoco_warp.refit_bvh(self._warp_model, self._data, self._context)
            self._mujoco_warp.render(self._warp_model, self._data, self._context)
            self._mujoco_warp.get_rgb(self._context, 0, self._rgb)
            self._mujoco_warp.get_depth(self._context, 0, 1.0, self._depth)
            return self._rgb.numpy()[0], self._depth.numpy()[0]


def _floats(values: NDArray[np.floating]) -> NDArray[np.float32]:
    return np.ascontiguousarray(values, np.float32)
