"""How pictures of lenses are drawn, and straightened: warps between theirs and pinhole pictures.

Pixels are ROS's, as of Lens. Knows no ROS.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rosplat_core.cameras import EQUIRECTANGULAR, Camera
from rosplat_core.lenses import LONGEST_SIDE, Lens, LensError
from rosplat_core.models import Model

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix

Array = NDArray[np.float64]

WIDEST = math.tan(math.radians(50))  # beyond, splats lose their shape in one pinhole picture
TILE = 16  # as the rasteriser's [px]
BEHIND = math.sin(math.radians(4))  # how far behind itself a lens may see that looks ahead
MARGIN = 3  # around the part of a pinhole picture that is warped, for the filter's taps [px]
PARTS = 4096  # of a lens's curve
ROUNDEST = math.radians(160)  # off the axis; beyond, a lens stretches splats too much for a curve
ROUNDED = math.radians(125)  # off the axis, where stereographic pictures of half of all end

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
    """Where those of the left half and of the right half of each tile of TILE x TILE pixels begin,
    row by row of tiles, and the end."""
    x: NDArray[np.float32]
    """(n,) and y (n,), where the centre of the top left pixel is (0.5, 0.5); y ascends in a
    half. [px]"""
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
        half = (y // TILE).astype(int) * (2 * across) + (x // (TILE / 2)).astype(int)
        order = np.lexsort((y, half))
        ends = np.cumsum(np.bincount(half, minlength=2 * across * down))
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
    of the six faces of a cube around that (cameras, samples). Ellipses (sheets): a lens without
    distortion needs one picture and no warp, a fisheye one by its own curve. For others, a
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

    def colour(self, values: Sequence[NDArray[np.float32]]) -> NDArray[np.float32]:
        """(height, width, c) from values of samples (n, c) for each camera; 0 without a ray."""
        return self._placed(values, 0.0)

    def depth(self, depths: Sequence[NDArray[np.float32]]) -> NDArray[np.float32]:
        """(height, width) along the lens's axis [m] from depths of samples (n,) for each camera."""
        ahead = [part.along * depth for part, depth in zip(self._faces, depths, strict=True)]
        return self._placed([each[:, None] for each in ahead], np.nan)[..., 0]

    def nearest(self, values: Sequence[NDArray[np.float32]]) -> NDArray[np.float32]:
        """As colour(), with NaN without a ray."""
        return self._placed(values, np.nan)

    def _placed(self, values: Sequence[NDArray[np.float32]], missing: float) -> NDArray[np.float32]:
        placed = np.full((self.lens.height * self.lens.width, values[0].shape[1]), missing, "f4")
        for part, of_part in zip(self._faces, values, strict=True):
            placed[part.pixels] = of_part
        return placed.reshape(self.lens.height, self.lens.width, -1)

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
            places, camera = _framed(self.lens, turned[:, :2] / turned[:, 2:], face)
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
            places, camera = _framed(self.lens, turned[:, :2] * half, turn)
            widest = math.acos(min(float(turned[:, 2].min()), 1.0))
            curve = Curve.of(
                lambda angles: 2 * np.tan(angles / 2), ROUNDED, widest, by_distance=self._behind
            )
            parts.append(_Part(camera, curve, pixels[seen], places, along))
        return parts


def _framed(
    lens: Lens, points: Array, rotation: Array, margin: int = MARGIN
) -> tuple[Array, Camera]:
    """Where points (n, 2) [focal lengths] are in their picture (n, 2) [px], and its camera.

    Without a margin, the first pixels' centres are the least x and the least y of all points.
    """
    places = points * (lens.fx, lens.fy)
    low = places.min(axis=0)
    low = np.floor(low).astype(int) - margin if margin else low
    width, height = (np.ceil(places.max(axis=0) - low).astype(int) + margin + 1).tolist()
    if max(width, height) > LONGEST_SIDE:
        raise LensError(f"d: the lens needs a picture of {width} x {height} pixels")
    pose = np.eye(4)
    pose[:3, :3] = rotation
    left, top = (0.5 - low).tolist()
    return places - low, Camera(0, width, height, lens.fx, lens.fy, left, top, pose)


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
        _, camera = _framed(lens, points, np.eye(3), margin=0)
        self.camera = camera
        columns, rows = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
        x, y = (columns + 0.5 - camera.cx) / lens.fx, (rows + 0.5 - camera.cy) / lens.fy
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
    return np.stack(
        [
            -0.5 * t3 + t2 - 0.5 * t,
            1.5 * t3 - 2.5 * t2 + 1,
            -1.5 * t3 + 2 * t2 + 0.5 * t,
            0.5 * t3 - 0.5 * t2,
        ],
        axis=-1,
    )
