"""A camera as sorters need it: in float32, relative to where each group of splats is."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rosplat_core.posed_camera import CameraError, PosedCamera
from rosplat_core.quaternions import to_matrices

# The reach of the low-pass filter, 3.33 * sqrt(0.3) = 1.82 px, and of a disc's spot, 3.33 *
# sqrt(0.5) = 2.35 px, with room for rounding.
MARGIN_PIXELS = 2.5
# An order is culled to so many times the picture's size: by the time it is drawn, the camera has
# moved on and sees more. 1.25 saves 11 dB after a turn of 3 degrees (docs/stability.md).
OVERSCAN = 1.25

IDENTITY: NDArray[np.float64] = np.eye(4)[None]


@dataclass(frozen=True)
class SortView:
    """A camera's numbers for the depths and culling of all groups, as SortView in C++.

    rotations: each group's frame to camera optical frame, float32 (g, 3, 3). translations: of each
    group's origin in the camera frame, float32 (g, 3) [m]. The rest are float32 as well: focal
    lengths [px] (orthographic [px/m]), the principal point from the picture's centre, half the
    picture's size with a margin [px], the growth of a footprint with a splat's extent [px]
    (orthographic [px/m]), depths [m].
    """

    rotations: NDArray[np.float32]
    translations: NDArray[np.float32]
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
    def of(cls, camera: PosedCamera, frames: ArrayLike = IDENTITY) -> SortView:
        """The view of a camera on groups in the given frames, float64 (g, 4, 4).

        frames: rigid transforms into the map's frame from the one that each group's positions are
        in. Everything is float64 until the end: float32 would lose digits far from the origin. A
        group whose translation is beyond float32 isn't visible: its translation becomes infinite.
        Raises CameraError for a camera that float32 can't hold.
        """
        frames = np.asarray(frames, np.float64)
        rotation = frame_at(camera.position, camera.orientation)[:3, :3].T
        # Sums of three are written out: rounding in NumPy's depends on the number of groups.
        with np.errstate(over="ignore", invalid="ignore"):
            x, y, z = (np.asarray(camera.position) - frames[:, :3, 3]).T[:, :, None]
            translations = -rotation[:, 0] * x - rotation[:, 1] * y - rotation[:, 2] * z
            translations = translations.astype(np.float32)
        # An infinite depth is never nearer than far_clip, so the group is culled.
        translations[~np.isfinite(translations).all(axis=1)] = np.inf

        def slope(focal: float, centre: float, size: int) -> float:
            # A perspective footprint grows with its ray's slope, which the renderer clamps like so.
            if camera.orthographic:
                return camera.extent_scale * focal
            tangent = max(size - centre, centre) / focal + 0.3 * (0.5 * size / focal)
            return camera.extent_scale * focal * math.sqrt(1.0 + tangent * tangent)

        with np.errstate(over="ignore"):  # checked below
            view = cls(
                rotations=(rotation @ frames[:, :3, :3]).astype(np.float32),
                translations=translations,
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
                orthographic=bool(camera.orthographic),
            )
        for name, value in vars(view).items():
            if name != "translations" and not np.isfinite(value).all():
                raise CameraError(f"{name} of the view is beyond float32")
        return view


def frame_at(
    position: ArrayLike, orientation: Sequence[float] = (0.0, 0.0, 0.0, 1.0)
) -> NDArray[np.float64]:
    """Rigid transform, float64 (4, 4), from a frame to the one that its pose is given in.

    position: 3 [m]. orientation: quaternion x y z w, of any length but zero.
    """
    frame = np.eye(4)
    largest = max(map(abs, orientation))  # divides all, since its square may overflow
    frame[:3, :3] = to_matrices([value / largest for value in orientation])
    frame[:3, 3] = position
    return frame


def unmoved(origin: ArrayLike) -> NDArray[np.float64]:
    """The frames, float64 (1, 4, 4), of a map whose one group is at the identity. origin: 3 [m]."""
    return frame_at(origin)[None]
