"""gaussian_splatting_msgs/GaussianSplats, of nicholaslu/gaussian_splatting: flat arrays.

A message is a whole map: 3D Gaussians, or 2D ones (discs), drawn as classic or antialiased. Scales
and opacities are linear, quaternions x y z w; harmonics after the first lie splat by splat.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from std_msgs.msg import Header

from rosplat_core.formats.decoded import Columns, IntoSplats
from rosplat_core.models import Model
from rosplat_core.splats import LOW_PASS, MAX_SH_DEGREE, InputError, Splats, sh_coefficients
from rosplat_ros.messages import as_array, plain_frame
from rosplat_tools.foreign import MapReader

TYPE = "gaussian_splatting_msgs/msg/GaussianSplats"
TOPIC = "gaussian_splats"
DEPTH = 1
FIELDS = ("type", "means", "sh_rest")


class Reader(MapReader):
    """The map of the last message."""

    def add(self, message: Any) -> bool:
        """Raises InputError for a message that contradicts itself."""
        self._splats = self._read(message)
        self.frame_id = plain_frame(message.header.frame_id)
        return True

    def _read(self, message: Any) -> Splats:
        if message.type not in (message.TYPE_3DGS, message.TYPE_2DGS):
            raise InputError(f"{self._name}: type: {message.type} is neither 3DGS nor 2DGS")
        if message.sh_degree > MAX_SH_DEGREE:
            raise InputError(
                f"{self._name}: sh_degree: {message.sh_degree}, at most {MAX_SH_DEGREE}"
            )
        n = len(message.means) // 3
        k = sh_coefficients(message.sh_degree)
        positions = self._array(message, "means", n, 3)
        is_disc = message.type == message.TYPE_2DGS
        given = 2 if is_disc and len(message.scales) == 2 * n else 3
        scales = np.zeros((n, 3), np.float32)
        scales[:, :given] = self._array(message, "scales", n, given)
        if is_disc:
            scales[:, 2] = 0  # means nothing
        elif n and abs(message.eps2d - LOW_PASS) > 1e-3:
            self._warn(
                f"{self._name}: eps2d: {message.eps2d:g} px^2, drawn with the usual {LOW_PASS}"
            )
        model = Model.DISC if is_disc else Model.EWA
        if not is_disc and message.rasterize_mode == message.RASTERIZE_MODE_ANTIALIASED:
            model = Model.EWA_ANTIALIASED
        columns = Columns(
            positions.astype(np.float64),
            self._array(message, "quats", n, 4),
            scales,
            self._array(message, "opacities", n, 1).ravel(),
            np.concatenate(
                [
                    self._array(message, "sh_dc", n, 3).reshape(n, 1, 3),
                    self._array(message, "sh_rest", n, 3 * (k - 1)).reshape(n, k - 1, 3),
                ],
                axis=1,
            ),
        )
        return IntoSplats().make(Path(self._name), self._warn, columns, model)

    def _array(self, message: Any, field: str, n: int, width: int) -> np.ndarray:
        values = np.array(getattr(message, field), np.float32)
        if len(values) != n * width:
            raise InputError(
                f"{self._name}: {field}: {len(values)} numbers, expected {n * width} for {n} splats"
            )
        return values.reshape(n, width)


def messages(kind: Any, splats: Splats, header: Header) -> Iterator[Any]:
    """One message."""
    message = kind()
    message.header = header
    message.type = kind.TYPE_2DGS if splats.model == Model.DISC else kind.TYPE_3DGS
    is_antialiased = splats.model == Model.EWA_ANTIALIASED
    message.rasterize_mode = (
        kind.RASTERIZE_MODE_ANTIALIASED if is_antialiased else kind.RASTERIZE_MODE_CLASSIC
    )
    message.eps2d = LOW_PASS
    message.sh_degree = splats.sh_degree
    message.means = as_array("f", (splats.positions + splats.origin).astype(np.float32))
    message.scales = as_array("f", splats.scales)
    message.quats = as_array("f", splats.orientations)
    message.opacities = as_array("f", splats.opacities)
    message.sh_dc = as_array("f", splats.sh[:, 0])
    message.sh_rest = as_array("f", splats.sh[:, 1:])
    yield message
