"""Lenses: where a calibrated camera images a ray.

The models are those of sensor_msgs/distortion_models.hpp, as OpenCV defines them: plumb_bob and
rational_polynomial, also with thin prisms and a tilted sensor (Brown 1966; cv::projectPoints),
equidistant (Kannala and Brandt 2006; cv::fisheye); and double_sphere (Usenko et al. 2018), ftheta
(NVIDIA's). Fisheyes, which are the last three, are functions of the angle off the axis alone. And
equirectangular, a panorama: focal lengths are pixels for a radian of longitude and latitude.
Pixels are ROS's: the centre of the top left one is (0, 0). Knows no ROS.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.polynomial.polynomial import polyder, polyval
from numpy.typing import ArrayLike, NDArray

from rosplat_core.cameras import EQUIRECTANGULAR, PINHOLE, Camera
from rosplat_core.log_text import shown

Array = NDArray[np.float64]

PLUMB_BOB, RATIONAL = "plumb_bob", "rational_polynomial"
EQUIDISTANT, DOUBLE_SPHERE, F_THETA = FISHEYES = "equidistant", "double_sphere", "ftheta"
# How many coefficients a model may have; missing ones are 0.
COEFFICIENTS = {
    PINHOLE: (0,), PLUMB_BOB: (5,), RATIONAL: (8, 12, 14),
    EQUIDISTANT: (4,), DOUBLE_SPHERE: (2,), F_THETA: (6, 7, 13), EQUIRECTANGULAR: (0,),
}  # fmt: skip

# What calibrators and drivers call these models, in lower case with _ for - and blanks.
OTHER_NAMES = {
    "none": PINHOLE, "pinhole": PINHOLE, "rectilinear": PINHOLE,
    "radtan": PLUMB_BOB, "brown_conrady": PLUMB_BOB,
    "fisheye": EQUIDISTANT, "equi": EQUIDISTANT, "opencv_fisheye": EQUIDISTANT,
    "kannala_brandt": EQUIDISTANT, "kannala_brandt4": EQUIDISTANT,
}  # fmt: skip

LONGEST_SIDE = 8192  # [px]
STEEPEST = math.radians(84)  # most angle of a ray for polynomials of its tangent [rad]
MOST_STRETCH = 10  # of a fisheye: beyond, relative to the centre, it images nothing
NEWTON_STEPS = 4
TOLERANCE = 1e-4  # between a pixel and the projection of the ray found for it [px]


class LensError(ValueError):
    """A calibration that no camera has; the text names the field."""


@dataclass(frozen=True, eq=False)
class Lens:
    """A calibrated camera without its pose. Raises LensError for values that no camera has."""

    width: int
    """Size of the picture. [px]"""
    height: int
    fx: float
    """Focal lengths; with distortion, those at the centre; a double_sphere has 1 + xi times
    as many. [px]"""
    fy: float
    cx: float
    """Principal point, where the centre of the top left pixel is (0, 0). [px]"""
    cy: float
    model: str = PINHOLE
    coefficients: tuple[float, ...] = ()
    """As CameraInfo.d: plumb_bob k1 k2 p1 p2 k3; rational_polynomial k1 k2 p1 p2 k3 k4 k5 k6, then
    s1 s2 s3 s4 of thin prisms, then the sensor's tilt about x and y [rad]; equidistant k1 k2 k3 k4;
    double_sphere xi alpha. ftheta has the polynomial that gives a distance from the principal point
    in focal lengths for an angle [rad], from the constant, 0, to the fifth power; then the largest
    angle that it is for, 0 if for all; then, if that is the exact one, the polynomial that gives
    the angle for the distance.
    """

    def __post_init__(self) -> None:
        """Checks every value."""
        for name in ("width", "height"):
            if not 1 <= getattr(self, name) <= LONGEST_SIDE:
                raise LensError(f"{name} is {getattr(self, name)}, expected 1 to {LONGEST_SIDE}")
        numbers = (self.fx, self.fy, self.cx, self.cy, *self.coefficients)
        if not all(map(math.isfinite, numbers)):
            raise LensError("a number is not finite")
        if not (self.fx > 0 and self.fy > 0):
            said = f"k: focal lengths are {self.fx}, {self.fy}, expected more than 0"
            raise LensError(said if self.fx or self.fy else f"{said}: not calibrated?")
        name = self.model.lower().replace("-", "_").replace(" ", "_")
        model = OTHER_NAMES.get(name, name)
        # OpenCV takes the model from the count, and so some drivers don't mind the name.
        if model == PLUMB_BOB and any(self.coefficients[COEFFICIENTS[model][0] :]):
            model = RATIONAL
        if model not in COEFFICIENTS:
            known = ", ".join(filter(None, COEFFICIENTS))
            raise LensError(f"distortion_model is '{shown(self.model)}', known are {known}")
        object.__setattr__(self, "model", model)
        count, counts = len(self.coefficients), COEFFICIENTS[self.model]
        if any(self.coefficients[counts[-1] :]):
            expected = ", ".join(map(str, counts))
            raise LensError(f"d has {count} numbers, expected {expected} of '{self.model}'")
        size = next((size for size in counts if size >= count), counts[-1])
        padded = (*self.coefficients, *[0.0] * size)[:size]
        object.__setattr__(self, "coefficients", padded)
        if self.model == DOUBLE_SPHERE and not (padded[0] > -1 and 0 <= padded[1] <= 1):
            said = f"xi is {padded[0]}, alpha {padded[1]}"
            raise LensError(f"d: {said}, expected more than -1, and 0 to 1")
        if self.model == F_THETA and (padded[0] or any(padded[7:8]) or not padded[1] > 0):
            raise LensError("d: expected polynomials that begin with 0, and then rise")

    @classmethod
    def of_view(cls, width: int, height: int, angle: float) -> Lens:
        """A pinhole camera that sees a horizontal angle [rad], with square pixels."""
        if not 0 < angle < math.pi:
            raise LensError(f"angle of view is {angle}, expected more than 0 and less than pi")
        focal = width / 2 / math.tan(angle / 2)
        return cls(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)

    @classmethod
    def of_camera(cls, camera: Camera) -> Lens:
        """The lens of a camera, pinhole or panorama."""
        size = camera.width, camera.height
        place = camera.fx, camera.fy, camera.cx - 0.5, camera.cy - 0.5
        return cls(*size, *place, camera.model)

    @property
    def is_pinhole(self) -> bool:
        """Whether straight lines stay straight."""
        bent = (EQUIDISTANT, F_THETA, EQUIRECTANGULAR)
        return self.model not in bent and not any(self.coefficients)

    @property
    def is_fisheye(self) -> bool:
        """Whether it may see behind itself, and is a function of the angle off its axis alone."""
        return self.model in FISHEYES and not self.is_pinhole

    def project(self, rays: ArrayLike) -> Array:
        """Pixels (..., 2) of rays (..., 3) of any length: x right, y down, z forward.

        NaN for rays past the fold of the distortion and, unless of a fisheye, from behind the lens.
        """
        rays = np.asarray(rays, np.float64)
        if self.model == EQUIRECTANGULAR:
            x, y, z = np.moveaxis(rays, -1, 0)
            angles = np.stack([np.arctan2(x, z), np.arctan2(y, np.hypot(x, z))], axis=-1)
            return angles * (self.fx, self.fy) + (self.cx, self.cy)
        ahead, beside = rays[..., 2], np.linalg.norm(rays[..., :2], axis=-1)
        with np.errstate(all="ignore"):
            if self.is_fisheye:
                radius = np.arctan2(beside, ahead)
                scale = np.where(beside > 0, self._profile(radius) / beside, 0)
                points = rays[..., :2] * scale[..., None]
            else:
                radius = np.where(ahead > 0, beside / ahead, np.inf)
                points = self._distorted(rays[..., :2] / ahead[..., None])
            points = np.where((radius <= self._reach[0][-1])[..., None], points, np.nan)
        return points * (self.fx, self.fy) + (self.cx, self.cy)

    @np.errstate(all="ignore")  # NaN where no ray is
    def rays(self, pixels: ArrayLike) -> Array:
        """Rays (..., 3) that arrive at pixels (..., 2), the inverse of project().

        Of fisheyes and panoramas, their length is 1; of others, their z. NaN where the distortion
        folds before.
        """
        pixels = np.asarray(pixels, np.float64)
        goals = (pixels - (self.cx, self.cy)) / (self.fx, self.fy)
        if self.is_pinhole:
            return np.concatenate([goals, np.ones((*goals.shape[:-1], 1))], axis=-1)
        if self.model == EQUIRECTANGULAR:
            goals = np.where(np.abs(goals) <= (math.pi, math.pi / 2), goals, np.nan)
            (x, y), (z, level) = (
                np.sin(np.moveaxis(goals, -1, 0)),
                np.cos(np.moveaxis(goals, -1, 0)),
            )
            return np.stack([level * x, y, level * z], axis=-1)
        if self._tilt is not None:
            goals = _mapped(np.asarray(np.linalg.inv(self._tilt), np.float64), goals)
        radii = np.linalg.norm(goals, axis=-1)
        found = np.interp(radii, self._reach[1], self._reach[0])
        turn = np.where(radii[..., None] > 0, goals / radii[..., None], 0)
        if self.is_fisheye:
            for _ in range(NEWTON_STEPS):
                slope = (self._profile(found + 1e-6) - self._profile(found - 1e-6)) / 2e-6
                found = found - (self._profile(found) - radii) / slope
            rays = np.concatenate(
                [turn * np.sin(found)[..., None], np.cos(found)[..., None]], axis=-1
            )
        else:
            points = turn * found[..., None]
            for _ in range(NEWTON_STEPS):
                points = points - self._newton_step(points, goals)
            rays = np.concatenate([points, np.ones((*points.shape[:-1], 1))], axis=-1)
        miss = np.abs(self.project(rays) - pixels).max(axis=-1)
        rays[~(miss < TOLERANCE)] = np.nan
        return rays

    @property
    def most_angle(self) -> float:
        """The angle off the axis up to which a fisheye images rays. [rad]"""
        return float(self._reach[0][-1])

    def radius(self, angles: Array) -> Array:
        """How far from the principal point a fisheye images angles off its axis [rad], in focal
        lengths."""
        return self._profile(angles)

    # --- Functions of the radius: a ray's tangent; of fisheyes, its angle -------------------------

    def _profile(self, radius: Array) -> Array:
        """Distorted radii by the radial part of the distortion."""
        square = radius * radius
        if not self.is_fisheye:
            return radius * self._radial(square)[0]
        if self.model == EQUIDISTANT:
            return radius * polyval(square, (1, *self.coefficients))
        if self.model == DOUBLE_SPHERE:
            xi, alpha = self.coefficients
            beside, ahead = np.sin(radius), xi + np.cos(radius)
            return beside / (alpha * np.hypot(beside, ahead) + (1 - alpha) * ahead)
        near = polyval(radius, self.coefficients[:6])
        exact = self.coefficients[7:]
        for _ in range(NEWTON_STEPS if any(exact) else 0):
            near = near - (polyval(near, exact) - radius) / polyval(near, polyder(exact))
        return np.asarray(near, np.float64)

    @cached_property
    def _reach(self) -> tuple[Array, Array]:
        """Radii up to the fold of the distortion, and their distorted radii, both ascending."""
        most = math.pi if self.is_fisheye else STEEPEST
        if self.model == F_THETA:
            most = min(most, *filter(None, self.coefficients[6:7]), math.pi)
        angles = np.linspace(0, most, 8192)
        radii = angles if self.is_fisheye else np.tan(angles)
        with np.errstate(all="ignore"):
            taken = self._profile(radii)
        rises = np.diff(taken)
        falls = ~(rises > 0)
        if self.is_fisheye:
            falls |= rises > MOST_STRETCH * rises[0]
        end = int(np.argmax(falls)) + 1 if falls.any() else len(radii)
        return radii[:end], taken[:end]

    def _radial(self, square: Array) -> tuple[Array, Array]:
        """The radial factor at squared radii, and its derivative by the squared radius."""
        k1, k2, _, _, k3, *below = self.coefficients[:8] or (0.0,) * 5
        above, denominator = (1, k1, k2, k3), (1, *below)
        a, b = polyval(square, above), polyval(square, denominator)
        da, db = polyval(square, polyder(above)), polyval(square, polyder(denominator))
        return a / b, (da * b - a * db) / (b * b)

    @property
    def _prisms(self) -> tuple[float, ...]:
        """s1 s2 s3 s4 of thin prisms."""
        return self.coefficients[8:12] or (0.0,) * 4

    @cached_property
    def _tilt(self) -> Array | None:
        """(3, 3) from the plane z = 1 to that of a tilted sensor, as homogeneous points."""
        x, y = (() if self.is_fisheye else self.coefficients[12:]) or (0.0, 0.0)
        if not (x or y):
            return None
        about_x = [[1, 0, 0], [0, math.cos(x), math.sin(x)], [0, -math.sin(x), math.cos(x)]]
        about_y = [[math.cos(y), 0, -math.sin(y)], [0, 1, 0], [math.sin(y), 0, math.cos(y)]]
        turn = np.array(about_y) @ np.array(about_x)
        ahead = turn[2, 2]
        flat = [[ahead, 0, -turn[0, 2]], [0, ahead, -turn[1, 2]], [0, 0, 1]]
        tilt: Array = np.array(flat) @ turn
        return tilt

    def _distorted(self, points: Array) -> Array:
        """Distorted places of points (..., 2), both on the plane z = 1."""
        bent = self._bent(points)
        return bent if self._tilt is None else _mapped(self._tilt, bent)

    def _bent(self, points: Array) -> Array:
        """As _distorted, on a sensor without tilt."""
        _, _, p1, p2, *_ = self.coefficients or (0.0,) * 5
        s1, s2, s3, s4 = self._prisms
        x, y = points[..., 0], points[..., 1]
        square = x * x + y * y
        factor, _ = self._radial(square)
        prism_x, prism_y = square * (s1 + s2 * square), square * (s3 + s4 * square)
        return np.stack(
            [
                x * factor + 2 * p1 * x * y + p2 * (square + 2 * x * x) + prism_x,
                y * factor + p1 * (square + 2 * y * y) + 2 * p2 * x * y + prism_y,
            ],
            axis=-1,
        )

    def _newton_step(self, points: Array, goals: Array) -> Array:
        """What to subtract from points (..., 2) so that, to first order, they are bent to goals."""
        _, _, p1, p2, *_ = self.coefficients
        s1, s2, s3, s4 = self._prisms
        x, y = points[..., 0], points[..., 1]
        square = x * x + y * y
        factor, slope = self._radial(square)
        prism_x, prism_y = 2 * (s1 + 2 * s2 * square), 2 * (s3 + 2 * s4 * square)
        mixed = 2 * x * y * slope + 2 * p1 * x + 2 * p2 * y
        xx = factor + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x + prism_x * x
        yy = factor + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x + prism_y * y
        xy, yx = mixed + prism_x * y, mixed + prism_y * x
        missed = (self._bent(points) - goals) / (xx * yy - xy * yx)[..., None]
        u, v = missed[..., 0], missed[..., 1]
        return np.stack([yy * u - xy * v, xx * v - yx * u], axis=-1)


def _mapped(homography: Array, points: Array) -> Array:
    """Points (..., 2) of the plane z = 1, moved by a matrix (3, 3)."""
    moved = points @ homography[:, :2].T + homography[:, 2]
    return moved[..., :2] / moved[..., 2:]


# --- Pictures to the lens's -----------------------------------------------------------------------
