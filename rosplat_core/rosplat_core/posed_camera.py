"""The camera that an order is asked for, as the message ViewCamera describes it, checked."""

from __future__ import annotations

import math
from dataclasses import dataclass

LARGEST = 3.4028234663852886e38  # of float32, which pictures are drawn with


class CameraError(ValueError):
    """A camera that nothing can be ordered for; the text names the field."""


@dataclass(frozen=True)
class PosedCamera:
    """A camera in the map's frame, as ViewCamera describes it: numbers in SplatCamera's order.

    position: of the optical frame, x y z [m]. orientation: of the optical frame, a quaternion
    x y z w of any length but zero. fx fy: [px], orthographic [px/m]. cx cy width height: [px].
    near_clip far_clip: [m]. extent_scale: factor by which splats are drawn larger than in the map.
    Raises CameraError for values that no picture can be drawn with.
    """

    position: tuple[float, float, float]
    orientation: tuple[float, float, float, float]
    orthographic: bool
    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int
    near_clip: float
    far_clip: float
    extent_scale: float = 1.0

    def __post_init__(self) -> None:
        finite = ("position", "orientation", "fx", "fy", "cx", "cy", "near_clip", "far_clip")
        for name in (*finite, "extent_scale"):
            value = getattr(self, name)
            if not all(
                abs(v) <= LARGEST for v in (value if isinstance(value, tuple) else (value,))
            ):
                raise CameraError(f"{name} is not finite, or beyond float32: {value}")
        if math.hypot(*self.orientation) == 0:
            raise CameraError("orientation is a quaternion of length zero")
        for name in ("fx", "fy", "width", "height", "extent_scale"):
            if getattr(self, name) <= 0:
                raise CameraError(f"{name} is {getattr(self, name)}, it must be positive")
        if self.near_clip >= self.far_clip:
            raise CameraError(f"near_clip {self.near_clip} is not below far_clip {self.far_clip}")
        if self.near_clip <= 0 and not self.orthographic:
            raise CameraError(f"near_clip is {self.near_clip}, a perspective needs more than 0")
