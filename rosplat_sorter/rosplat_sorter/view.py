"""A camera as sorters need it: in float32, relative to the map's origin."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rosplat_sorter.camera import Camera, CameraError

# Half the low-pass filter's reach, 3.33 * sqrt(0.3) = 1.82 px, with room for rounding.
MARGIN_PIXELS = 2.0
# How much wider than the picture an order is culled: it is drawn for cameras that have moved on,
# and lacks what came in. 1.25 saves 18 dB after a turn of 3 degrees (docs/stability.md).
OVERSCAN = 1.25


@dataclass(frozen=True)
class View:
    """What positions are multiplied with. The twin of rosplat_sorter::View in C++.

    rotation: map to camera optical frame, float32 (3, 3). translation: of the map's origin in the
    camera frame, float32 (3,) [m]. The rest are float32 as well: focal lengths [px] (orthographic
    [px/m]), the principal point from the picture's centre, half the picture's size with a margin
    [px], the growth of a footprint with a splat's extent [px] (orthographic [px/m]), depths [m].
    """

    rotation: NDArray[np.float32]
    translation: NDArray[np.float32]
    fx: np.float32
    fy: np.float32
    offset_x: np.float32
    offset_y: np.float32
    half_width: np.float32
    half_height: np.float32
    slope_x: np.float32
    slope_y: np.float32
    near_clip: np.float32
    far_clip: np.float32
    orthographic: bool

    @classmethod
    def of(cls, camera: Camera, origin: ArrayLike = (0.0, 0.0, 0.0)) -> View:
        """The view of a camera on a map with the given origin, 3 float64 [m].

        Everything is float64 until the end, so that nothing is lost far from the frame's origin.
        Raises CameraError for what float32 can't hold.
        """
        rotation = rotation_matrix(*camera.orientation).T
        translation = -rotation @ (np.asarray(camera.position) - np.asarray(origin, np.float64))

        def slope(focal: float, centre: float, size: int) -> float:
            # A perspective footprint grows with the slope of its ray, which the renderer clamps so.
            if camera.orthographic:
                return camera.extent_scale * focal
            tangent = max(size - centre, centre) / focal + 0.3 * (0.5 * size / focal)
            return camera.extent_scale * focal * math.sqrt(1.0 + tangent * tangent)

        with np.errstate(over="ignore"):  # checked below
            view = cls(
                rotation=rotation.astype(np.float32),
                translation=translation.astype(np.float32),
                fx=np.float32(camera.fx),
                fy=np.float32(camera.fy),
                offset_x=np.float32(camera.cx - camera.width / 2.0),
                offset_y=np.float32(camera.cy - camera.height / 2.0),
                half_width=np.float32(OVERSCAN * camera.width / 2.0 + MARGIN_PIXELS),
                half_height=np.float32(OVERSCAN * camera.height / 2.0 + MARGIN_PIXELS),
                slope_x=np.float32(slope(camera.fx, camera.cx, camera.width)),
                slope_y=np.float32(slope(camera.fy, camera.cy, camera.height)),
                near_clip=np.float32(camera.near_clip),
                far_clip=np.float32(camera.far_clip),
                orthographic=camera.orthographic,
            )
        for name, value in vars(view).items():
            if not np.isfinite(value).all():
                raise CameraError(f"{name} of the view is beyond float32")
        return view


def rotation_matrix(x: float, y: float, z: float, w: float) -> NDArray[np.float64]:
    """Rotation, float64 (3, 3), of a quaternion of any length but zero."""
    x, y, z, w = np.array([x, y, z, w]) / math.hypot(x, y, z, w)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
