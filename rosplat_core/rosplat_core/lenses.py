"""Lenses: where a calibrated camera images a ray, and how pinhole pictures warp to its picture.

The models are those of sensor_msgs/distortion_models.hpp, as OpenCV defines them: plumb_bob and
rational_polynomial, also with thin prisms and a tilted sensor (Brown 1966; cv::projectPoints),
equidistant (Kannala and Brandt 2006; cv::fisheye); and double_sphere (Usenko et al. 2018), ftheta
(NVIDIA's). Fisheyes, which are the last three, are functions of the angle off the axis alone. And
equirectangular, a panorama: focal lengths are pixels for a radian of longitude and latitude.
Pixels are ROS's: the centre of the top left one is (0, 0). Knows no ROS.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.polynomial.polynomial import polyder, polyval
from numpy.typing import ArrayLike, NDArray

from rosplat_core.cameras import EQUIRECTANGULAR, PINHOLE, Camera
from rosplat_core.log_text import shown
from rosplat_core.models import Model

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix

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
WIDEST = math.tan(math.radians(50))  # beyond, splats lose their shape in one pinhole picture
STEEPEST = math.radians(84)  # most angle of a ray for polynomials of its tangent [rad]
MOST_STRETCH = 10  # of a fisheye: beyond, relative to the centre, it images nothing
NEWTON_STEPS = 4
TOLERANCE = 1e-4  # between a pixel and the projection of the ray found for it [px]
TILE = 16  # as the rasteriser's [px]
BEHIND = math.sin(math.radians(4))  # how far behind itself a lens may see that looks ahead
MARGIN = 3  # around the part of a pinhole picture that is warped, for the filter's taps [px]
PARTS = 4096  # of a lens's curve
ROUNDEST = math.radians(160)  # off the axis; beyond, a lens stretches splats too much for a curve
ROUNDED = math.radians(125)  # off the axis, where stereographic pictures of half of all end


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

_FACES = (  # the axes right, down, forward of each face of a cube around the camera
    ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    ((0, 0, -1), (0, 1, 0), (1, 0, 0)),
    ((0, 0, 1), (0, 1, 0), (-1, 0, 0)),
    ((1, 0, 0), (0, 0, -1), (0, 1, 0)),
    ((1, 0, 0), (0, 0, 1), (0, -1, 0)),
    ((-1, 0, 0), (0, 1, 0), (0, 0, -1)),
)


class Curve(NamedTuple):
    """A picture that is round about the camera's axis, for EWA: it projects splats by its Jacobian.

    A direction n of length 1 is imaged at the principal point + g (fx n_x, fy n_y), where g depends
    on w = (1 - n_z) / 2 alone: 0 ahead, 1 behind.
    """

    cubics: NDArray[np.float32]
    """(PARTS, 4) g in equal parts of w from 0 to end: coefficients of 1, t, t^2, t^3 for t of 0 to
    1 in a part."""
    end: float
    """Of w. Splats beyond are not drawn."""
    widest: float
    """w of the pixel that is farthest from the axis."""
    by_distance: bool
    """Splats count, and are ordered, by their distances, not by their depths along the axis."""

    @classmethod
    def of(
        cls, radius: Callable[[Array], Array], end: float, widest: float, *, by_distance: bool
    ) -> Curve:
        """Of a function from angles off the axis [rad] to radii in focal lengths, and two angles
        for w."""
        # The cubic through four points of each part, those at its ends shared with the next one.
        steps = np.arange(4) / 3
        end = math.sin(end / 2) ** 2
        places = (np.arange(PARTS)[:, None] + steps) / PARTS * end
        angles = 2 * np.arcsin(np.sqrt(np.maximum(places, 1e-12)))
        values = radius(angles) / np.sin(angles)
        cubics = values @ np.linalg.inv(steps[:, None] ** np.arange(4)).T
        return cls(cubics.astype(np.float32), end, math.sin(widest / 2) ** 2, by_distance)


class Samples(NamedTuple):
    """The n pixels of a part of the lens's picture, as places in the pinhole picture."""

    begins: NDArray[np.uint32]
    """Where those of each tile of TILE x TILE pixels begin, row by row of tiles, and the end."""
    x: NDArray[np.float32]
    """(n,) and y (n,), where the centre of the top left pixel is (0.5, 0.5); y ascends in a tile.
    [px]"""
    y: NDArray[np.float32]
    axis: tuple[float, float, float] | None
    """The lens's axis in the pinhole camera's frame: splats count, and are ordered, by their depths
    along it. None, for a lens that sees behind itself: by their distances."""

    @classmethod
    def of(
        cls, places: Array, width: int, height: int, axis: tuple[float, float, float] | None
    ) -> tuple[NDArray[np.intp], Samples]:
        """Samples at places (n, 2) in a picture [px], and which place each of them is at (n,)."""
        across, down = -(-width // TILE), -(-height // TILE)
        x, y = places.astype(np.float32).T
        tile = (y // TILE).astype(int) * across + (x // TILE).astype(int)
        order = np.lexsort((y, tile))
        ends = np.cumsum(np.bincount(tile, minlength=across * down))
        return order, cls(np.append(0, ends).astype(np.uint32), x[order], y[order], axis)


@dataclass(frozen=True, eq=False)
class _Part:
    """The n pixels of the lens's picture that are taken from one picture to draw."""

    camera: Camera  # its world is the lens's optical frame
    curve: Curve | None  # None: of a pinhole camera
    pixels: NDArray[np.intp]  # (n,) flat indices in the lens's picture
    places: Array | None = None  # (n, 2) in the picture to draw [px]; None: that is the lens's
    along: NDArray[np.float32] | float = 1.0  # (n,) depth along the lens's axis over the camera's

    @cached_property
    def taps(self) -> csr_matrix:
        """(n, pixels of the picture to draw) weights for resampling."""
        if self.places is None:
            count = len(self.pixels)
            rows = (np.ones(count, np.float32), self.pixels, np.arange(count + 1))
            return _sparse(rows, (count, self.camera.width * self.camera.height))
        return _taps(self.places, self.camera.width, self.camera.height)

    @cached_property
    def nearest(self) -> NDArray[np.intp]:
        """(n,) flat indices in the picture to draw."""
        if self.places is None:
            return self.pixels
        x, y = np.rint(self.places).astype(np.intp).T
        nearest: NDArray[np.intp] = y * self.camera.width + x
        return nearest


class Sheets:
    """Pictures to draw, which are warped to a lens's picture.

    Colours are resampled by cubic convolution (Keys 1981), depths and normals by their nearest
    pixel.
    """

    def __init__(self, size: tuple[int, int], parts: list[_Part]) -> None:
        """size: height and width of the lens's picture [px]."""
        self._size = size
        self._parts = parts
        self._same = parts[0].places is None and len(parts[0].pixels) == size[0] * size[1]

    def cameras(
        self, world_to_lens: NDArray[np.float64], near: float, far: float
    ) -> list[tuple[Camera, Curve | None]]:
        """What to draw, for the transform (4, 4) to the lens, and depths [m]."""
        return [
            (_placed(part.camera, world_to_lens, near, far), part.curve) for part in self._parts
        ]

    def colour(self, pictures: Sequence[NDArray[np.float32]]) -> NDArray[np.float32]:
        """(height, width, c) from one (h, w, c) for each camera; 0 where no ray arrives."""
        if self._same:
            return pictures[0]
        warped = self._empty(pictures[0].shape[2], 0.0)
        for part, picture in zip(self._parts, pictures, strict=True):
            flat = picture.reshape(-1, picture.shape[2])
            warped[part.pixels] = flat[part.pixels] if part.places is None else part.taps @ flat
        return warped.reshape(*self._size, -1)

    def depth(self, pictures: Sequence[NDArray[np.float32]]) -> NDArray[np.float32]:
        """(height, width) along the lens's axis [m] from one (h, w) for each camera.

        NaN where no ray arrives, the point is not in front of the lens, or the pictures have NaN.
        """
        if self._same and not self._parts[0].curve:
            return pictures[0]
        warped = self._empty(1, np.nan)[:, 0]
        for part, picture in zip(self._parts, pictures, strict=True):
            taken = picture.ravel()[part.nearest]
            warped[part.pixels] = part.along * np.where(taken > 0, taken, np.float32(np.nan))
        return warped.reshape(self._size)

    def nearest(self, pictures: Sequence[NDArray[np.float32]]) -> NDArray[np.float32]:
        """(height, width, c) from one (h, w, c) for each camera, unmixed; NaN without a ray."""
        if self._same:
            return pictures[0]
        channels = pictures[0].shape[2]
        warped = self._empty(channels, np.nan)
        for part, picture in zip(self._parts, pictures, strict=True):
            warped[part.pixels] = picture.reshape(-1, channels)[part.nearest]
        return warped.reshape(*self._size, channels)

    def back(self, values: NDArray[np.float32]) -> list[NDArray[np.float32]]:
        """(h, w) for each camera from (height, width): the adjoint of colour().

        Splits each value among the pixels that colour() mixes there, by their weights.
        """
        if self._same:
            return [values]
        flat = values.ravel()
        return [
            np.asarray(part.taps.T @ flat[part.pixels], np.float32).reshape(
                part.camera.height, part.camera.width
            )
            for part in self._parts
        ]

    def _empty(self, channels: int, value: float) -> NDArray[np.float32]:
        return np.full((self._size[0] * self._size[1], channels), value, np.float32)


class Warp:
    """How pictures of a lens are drawn.

    Along rays, each pixel has its place in the picture of a pinhole camera at the lens's place, or
    of the six faces of a cube around that (samples, placed, ahead). Ellipses (sheets): a lens
    without distortion needs one picture and no warp, a fisheye one by its own curve. For others, a
    wider pinhole picture is warped that ends 50 degrees off the axis; beyond, a stereographic one,
    which leaves shapes as they are, or two, ahead and behind.
    """

    def __init__(self, lens: Lens, beyond: tuple[int, int] = (0, 0)) -> None:
        """beyond: how many rows the whole picture has above and below these, if they are a band of
        it. Raises LensError for too large a picture to draw, or a fold of the distortion in view.

        Around the round picture of a fisheye, though, pixels may have no ray.
        """
        self.lens, self.beyond = lens, beyond
        self.met: NDArray[np.bool_] = np.ones((lens.height, lens.width), bool)
        """(height, width) whether a ray arrives at a pixel."""
        self.samples: list[Samples] = []
        """The lens's pixels in the picture of each camera; none of a lens without distortion."""
        centre = lens.cx + 0.5, lens.cy + 0.5  # Camera has the first pixel's centre at 0.5
        whole = Camera(0, lens.width, lens.height, lens.fx, lens.fy, *centre, np.eye(4))
        if lens.is_pinhole:
            self._faces = [_Part(whole, None, np.arange(lens.width * lens.height))]
            self._sheets = self._faces
            return
        columns, rows = np.meshgrid(np.arange(lens.width), np.arange(lens.height))
        every = np.stack([columns, rows], axis=-1).reshape(-1, 2)
        rays = lens.rays(every)
        met = np.isfinite(rays).all(axis=1)
        if not met.all() and not (lens.is_fisheye and met.any()):
            x, y = every[np.argmin(met)]
            around = lens.model == EQUIRECTANGULAR
            why = "k: more than all around" if around else "d: the distortion folds"
            raise LensError(f"{why}: no ray arrives at pixel {x}, {y}")
        self.met = met.reshape(lens.height, lens.width)
        pixels = np.flatnonzero(met)
        rays = rays[met] / np.linalg.norm(rays[met], axis=1, keepdims=True)
        self._behind = bool((rays[:, 2] < -BEHIND).any())
        self._faces = self._cube(rays, pixels)
        self._sheets = self._faces
        widest = math.acos(max(float(rays[:, 2].min()), -1.0))
        if lens.is_fisheye and widest <= ROUNDEST:
            end = min(lens.most_angle, (ROUNDEST + math.pi) / 2)
            curve = Curve.of(lens.radius, end, widest, by_distance=self._behind)
            self._sheets = [_Part(whole, curve, pixels)]
        elif len(self._faces) > 1:
            self._sheets = self._rounds(rays, pixels)

    def cameras(self, world_to_lens: NDArray[np.float64], near: float, far: float) -> list[Camera]:
        """The pinhole cameras that together see what the lens sees; samples are in their pictures.

        world_to_lens: (4, 4); depths [m].
        """
        return [_placed(part.camera, world_to_lens, near, far) for part in self._faces]

    def sheets(self, model: Model) -> Sheets:
        """What to draw of a map of a model, if not by samples."""
        parts = self._faces if model in (Model.RAY, Model.DISC) else self._sheets
        return Sheets(self.met.shape, parts)

    def placed(
        self, values: Sequence[NDArray[np.float32]], missing: float = 0.0
    ) -> NDArray[np.float32]:
        """(height, width, c) from values of samples (n, c) for each camera."""
        placed = np.full((self.lens.height * self.lens.width, values[0].shape[1]), missing, "f4")
        for part, of_part in zip(self._faces, values, strict=True):
            placed[part.pixels] = of_part
        return placed.reshape(self.lens.height, self.lens.width, -1)

    def ahead(self, depths: Sequence[NDArray[np.float32]]) -> list[NDArray[np.float32]]:
        """Depths along the lens's axis from those of samples (n,) for each camera. [m]"""
        return [part.along * depth for part, depth in zip(self._faces, depths, strict=True)]

    def _cube(self, rays: Array, pixels: NDArray[np.intp]) -> list[_Part]:
        """One pinhole picture, or the faces of a cube. Appends to samples."""
        faces = np.array(_FACES, np.float64)
        of = np.argmax(rays @ faces[:, 2].T, axis=1)
        with np.errstate(all="ignore"):
            steep = np.abs(rays[:, :2] / rays[:, 2:]).max(axis=1)
        if ((rays[:, 2] > 0) & (steep <= WIDEST)).all():
            of[:] = 0
        parts = []
        for number, face in enumerate(faces):
            seen = of == number
            if not seen.any():
                continue
            turned = rays[seen] @ face.T
            places, camera = self._framed(turned[:, :2] / turned[:, 2:], face)
            axis = None if self._behind else tuple(face[:, 2].tolist())
            order, samples = Samples.of(places + 0.5, camera.width, camera.height, axis)
            self.samples.append(samples)
            ahead = rays[seen, 2][order]
            with np.errstate(all="ignore"):
                along = np.where(ahead > 0, ahead / turned[order, 2], np.nan).astype(np.float32)
            parts.append(_Part(camera, None, pixels[seen][order], places[order], along))
        return parts

    def _rounds(self, rays: Array, pixels: NDArray[np.intp]) -> list[_Part]:
        """One stereographic picture; of a lens that sees behind itself, one of each half."""
        ahead = (rays[:, 2] > 0) | (not self._behind)
        parts = []
        for seen, face, along in ((ahead, _FACES[0], 1.0), (~ahead, _FACES[5], math.nan)):
            if not seen.any():
                continue
            turn = np.array(face, np.float64)
            turned = rays[seen] @ turn.T
            half = 2 / (1 + turned[:, 2:])  # 2 tan(a / 2) of an angle a, over its sine
            places, camera = self._framed(turned[:, :2] * half, turn)
            widest = math.acos(min(float(turned[:, 2].min()), 1.0))
            curve = Curve.of(
                lambda angles: 2 * np.tan(angles / 2), ROUNDED, widest, by_distance=self._behind
            )
            parts.append(_Part(camera, curve, pixels[seen], places, along))
        return parts

    def _framed(self, points: Array, rotation: Array) -> tuple[Array, Camera]:
        """Places (n, 2) [px] of points (n, 2) in focal lengths, and the camera of their picture."""
        places = points * (self.lens.fx, self.lens.fy)
        low = np.floor(places.min(axis=0)).astype(int) - MARGIN
        width, height = (np.ceil(places.max(axis=0)).astype(int) + MARGIN - low + 1).tolist()
        if max(width, height) > LONGEST_SIDE:
            raise LensError(f"d: the lens needs a picture of {width} x {height} pixels")
        pose = np.eye(4)
        pose[:3, :3] = rotation
        left, top = (0.5 - low).tolist()
        camera = Camera(0, width, height, self.lens.fx, self.lens.fy, left, top, pose)
        return places - low, camera


def _placed(camera: Camera, world_to_lens: Array, near: float, far: float) -> Camera:
    """A camera in the lens's frame, in the world."""
    pose = camera.world_to_camera @ world_to_lens
    return replace(camera, world_to_camera=pose, near=near, far=far)


class Straightened:
    """Warps the picture of a lens to that of a pinhole camera at its place: Warp, the other way."""

    def __init__(self, lens: Lens) -> None:
        """Raises LensError for a lens that has no ray ahead, or needs too large a picture.

        The pinhole picture leaves out all beyond 50 degrees off the axis.
        """
        self._lens = lens
        self.camera: Camera
        """The pinhole camera; its world is the lens's optical frame."""
        self._places: Array | None = None  # (2, height, width) rows, columns in the lens's picture
        if lens.is_pinhole:
            (self.camera,) = Warp(lens).cameras(np.eye(4), 0.01, 1e10)
            return
        columns, rows = np.meshgrid(np.arange(lens.width), np.arange(lens.height))
        rays = lens.rays(np.stack([columns, rows], axis=-1).reshape(-1, 2))
        ahead = rays[rays[:, 2] > 0]
        points = ahead[:, :2] / ahead[:, 2:]
        points = points[np.abs(points).max(axis=1) <= WIDEST]
        if not len(points):
            raise LensError("d: no ray arrives from ahead")
        low = points.min(axis=0) * (lens.fx, lens.fy)
        size = np.ceil(points.max(axis=0) * (lens.fx, lens.fy) - low).astype(int) + 1
        width, height = size.tolist()
        if max(width, height) > LONGEST_SIDE:
            raise LensError(f"d: the lens needs a picture of {width} x {height} pixels")
        left, top = (0.5 - low).tolist()
        self.camera = Camera(0, width, height, lens.fx, lens.fy, left, top, np.eye(4))
        columns, rows = np.meshgrid(np.arange(width), np.arange(height))
        x, y = (columns + low[0]) / lens.fx, (rows + low[1]) / lens.fy
        self._places = np.moveaxis(lens.project(np.stack([x, y, np.ones_like(x)], -1)), 2, 0)[::-1]

    def picture(
        self, colours: NDArray[np.uint8], counts: NDArray[np.bool_]
    ) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
        """Warps the lens's colours (h, w, 3), linearly, and the mask (h, w) of those that count."""
        from scipy.ndimage import map_coordinates  # takes its time

        if self._places is None:
            return colours, counts

        def at(values: NDArray[Any]) -> NDArray[np.float32]:
            taken: NDArray[np.float32] = map_coordinates(
                values.astype(np.float32), self._places, order=1, cval=np.nan
            )
            return taken

        met = at(counts) > 0.999
        straight = np.stack([at(colours[..., channel]) for channel in range(3)], axis=-1)
        return np.where(met[..., None], straight + 0.5, 0).astype(np.uint8), met


def _taps(places: Array, width: int, height: int) -> csr_matrix:
    """(n, width * height) weights, 16 a row, of cubic convolution at places (n, 2). [px]"""
    first = np.floor(places)
    wx, wy = np.moveaxis(_cubic((places - first).astype(np.float32)), 1, 0)
    near = np.arange(-1, 3, dtype=np.int32)
    beside = (near[:, None] * np.int32(width) + near).reshape(-1)
    columns = (first @ (1, width)).astype(np.int32)[:, None] + beside
    shares = wy[:, :, None] * wx[:, None, :]
    ends = np.arange(0, 16 * len(places) + 1, 16, dtype=np.int32)
    taps = (shares.reshape(-1), columns.reshape(-1), ends)
    return _sparse(taps, (len(places), width * height))


def _sparse(rows: tuple[NDArray[Any], ...], shape: tuple[int, int]) -> csr_matrix:
    from scipy.sparse import csr_matrix  # takes its time

    return csr_matrix(rows, shape=shape)


def _cubic(t: NDArray[np.float32]) -> NDArray[np.float32]:
    """Weights (..., 4) of pixels -1, 0, 1, 2 at places t, 0 to 1 (Keys 1981, a = -1/2)."""
    t2, t3 = t * t, t * t * t
    shares: NDArray[np.float32] = np.stack(
        [
            -0.5 * t3 + t2 - 0.5 * t,
            1.5 * t3 - 2.5 * t2 + 1,
            -1.5 * t3 + 2 * t2 + 0.5 * t,
            0.5 * t3 - 0.5 * t2,
        ],
        axis=-1,
    )
    return shares
