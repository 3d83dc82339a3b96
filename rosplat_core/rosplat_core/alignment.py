"""A camera's pose, refined until the map looks as the camera's picture does. Knows no ROS.

Direct alignment, from coarse to fine (Lucas and Kanade 1981; Kerl et al. 2013): the map's colours
and depths are drawn at the pose, the drawn pixels are projected into the picture from another pose,
and Gauss-Newton steps find that pose, with a gain and a bias for each channel. Gradients are the
means of both pictures' (Malis 2004), errors have Cauchy's weights, and steps are damped (Levenberg
1944) by how far they move pixels, since metres and radians have no common measure.

On the finest level, errors have Tukey's biweight (Beaton and Tukey 1974), so that objects in front
of the map don't count, and steps are Newton's: they seek where the errors no longer go with the
map's gradients. How fast that changes is told by the products of the map's gradients and the
picture's, as instruments and regressors (Sargan 1958), so that fine detail which only one of the
two has adds nothing.

The covariance is that of such estimates (Huber 1967). Errors of a photograph are not noise:
neighbours err together where the map, the exposure or the lens is wrong. So tiles of the picture,
not pixels, are taken to be independent (Liang and Zeger 1986), and the covariance of noise is
multiplied by one factor (Kish 1965, the design effect), by how much tiles would move the pose: some
thirty tiles can't tell the 21 numbers of a covariance.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rosplat_core.cameras import Camera
from rosplat_core.quaternions import from_matrices, to_matrices
from rosplat_core.rendering import CpuRenderer, posed
from rosplat_core.splats import Splats, check_kind

Array = NDArray[np.float64]
Pixels = NDArray[np.float32]

LONGEST_SIDE = 640  # of the finest level, at most; larger pictures are reduced [px]
TRIES = 3
COARSEST = 10  # shorter side of the coarsest level, at least [px]
LEAST_POINTS = 60  # pixels that show the map, for a level to count
LEAST_ALPHA = 0.5  # of a pixel of the map that has a surface
LEAST_COMMON = 0.3  # share of the map's pixels that must stay in the picture
STEPS = 10  # between two drawings of the map, at most, on all levels but the finest
DRAWINGS, FINEST_DRAWINGS = 3, 8  # of a level, at most
LONGEST_STEP = 2.0  # root mean square of the pixels' motion, in pixels of the level [px]
STILL, FINEST_STILL = 0.1, 0.01  # a level ends once pixels move by less [px]
STILL_SHARE = 0.1  # the finest also once they move by less than this, of their standard deviations
DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-2, 1e-4, 1e4
NEWTON_DAMPING = 1e-3
CAUCHY = 1.5  # standard deviations, beyond which errors count less than half
BIWEIGHT = 4.685  # standard deviations, beyond which errors don't count on the finest level
LEAST_DEVIATION = 1 / 255
ROUNDING = LEAST_DEVIATION**2 / 12  # variance of values of 8 bits
TILES = 36  # squares of the picture whose errors are taken to be independent, about
RIDGE = 1e-6  # keeps gain and bias where a picture of one colour doesn't determine them
MOST_TINT = 2.0  # ratio of the largest gain of a channel to the smallest
LEAST_EXPLAINED = 0.75  # share of the picture's variance
MOST_UNCERTAIN = 0.01  # uncertainty of pixels by the pose's, as a share of the shorter side


@dataclass(frozen=True, eq=False)
class Alignment:
    """A refined pose, and how far it can be trusted."""

    world_to_camera: Array
    """(4, 4) rigid transform into the optical frame. [m]"""
    covariance: Array
    """(6, 6) of the camera's position [m] and its rotation about the map's axes x, y, z [rad], as
    in PoseWithCovariance. By how much tiles of the picture disagree, so it covers what the map, the
    exposure and the lens get wrong here and there, not what is wrong everywhere alike. Infinite
    where the search failed."""
    problem: str
    """Why the pose can't be used; empty where it converged."""
    iterations: int
    """How often the map was drawn."""
    residual: float
    """Standard deviation of the remaining errors, from their median. Colours are 0 to 1."""
    explained: float
    """Share of the picture's variance that the map explains, where it shows something."""
    gain: Array
    """(3,) The picture is about gain * the map's + bias, for red, green and blue."""
    bias: Array

    @property
    def converged(self) -> bool:
        """Whether the pose stands still, and the picture shows the map from there."""
        return not self.problem


def align(
    scene: Splats | CpuRenderer,
    picture: ArrayLike,
    camera: Camera,
    mask: ArrayLike | None = None,
    *,
    tries: int = TRIES,
    patience: float = math.inf,
) -> Alignment:
    """Refines the pose of `camera` by a picture that it took.

    picture: RGB (height, width, 3), uint8 or 0 to 1. mask: (height, width), true for pixels that
    count. tries: how many, each begun on a finer level, as the coarsest may lead astray. patience:
    time after which no other try begins [s]. To align several pictures with the same splats, keep a
    CpuRenderer. Raises ValueError for an orthographic camera, for a picture or mask of another
    size, and for less than one try.
    """
    if tries < 1:
        raise ValueError(f"tries is {tries}, expected 1 or more")
    renderer = scene if isinstance(scene, CpuRenderer) else CpuRenderer(scene)
    colours, counts = _checked(picture, camera, mask)
    reduction = -(-max(camera.width, camera.height) // LONGEST_SIDE)
    sizes = [reduction]
    while min(counts.shape) // (2 * sizes[-1]) >= COARSEST:
        sizes.append(2 * sizes[-1])
    levels = [_Level(colours, counts, camera, size, size == reduction) for size in sizes]
    uncertain = MOST_UNCERTAIN * min(levels[0].camera.width, levels[0].camera.height)
    drawings, until = 0, time.monotonic() + patience
    for begin in range(len(levels), max(len(levels) - tries, 0), -1):
        search = _Search(renderer, camera, uncertain, drawings)
        for level in reversed(levels[:begin]):
            search.refine(level)
        found = search.result()
        drawings = found.iterations
        if found.converged or time.monotonic() > until:
            break
    return found


def _checked(picture: ArrayLike, camera: Camera, mask: ArrayLike | None) -> tuple[Pixels, Pixels]:
    """Colours of 0 to 1, and how much each pixel counts."""
    check_kind(camera, Camera, "camera")
    if camera.orthographic:
        raise ValueError("camera: expected a perspective, got an orthographic one")
    pixels = np.asarray(picture)
    size = camera.height, camera.width
    if pixels.shape != (*size, 3):
        raise ValueError(f"picture: expected an array {(*size, 3)}, got {pixels.shape}")
    counted = np.ones(size, bool) if mask is None else np.asarray(mask, bool)
    if counted.shape != size:
        raise ValueError(f"mask: expected an array {size}, got {counted.shape}")
    colours: Pixels = pixels.astype(np.float32)
    if pixels.dtype == np.uint8:
        colours /= 255
    counts = np.isfinite(colours).all(axis=-1)
    colours[~counts] = 0
    return colours, np.asarray(counts & counted, np.float32)


# --- Pixels ---------------------------------------------------------------------------------------


def _blocks(values: Pixels, size: int) -> Pixels:
    """(h, size, w, size, ...) of an array (height, width, ...), without incomplete last blocks."""
    height, width = values.shape[0] // size, values.shape[1] // size
    cut = values[: height * size, : width * size]
    return cut.reshape(height, size, width, size, *values.shape[2:])


def _means(values: Pixels, size: int) -> Pixels:
    if size == 1:
        return values
    means: Pixels = _blocks(values, size).mean(axis=(1, 3))
    return means


def _masked_means(colours: Pixels, counts: Pixels, size: int) -> tuple[Pixels, Pixels]:
    """Means (h, w, 3) over each block's pixels that count, and the shares (h, w) of those."""
    shares = _means(counts, size)
    sums = _means(colours * counts[..., None], size)
    means = sums / np.maximum(shares, np.float32(1e-6))[..., None]
    return means.astype(np.float32), shares


def _reduced(camera: Camera, size: int) -> Camera:
    """The camera of the picture of means of size x size pixels."""
    return replace(
        camera, width=camera.width // size, height=camera.height // size,
        fx=camera.fx / size, fy=camera.fy / size, cx=camera.cx / size, cy=camera.cy / size,
    )  # fmt: skip


def _gradients(colours: Pixels) -> tuple[Pixels, Pixels]:
    """Gradients of each channel along x, and along y. [1/px]"""
    if min(colours.shape[:2]) < 2:
        return np.zeros_like(colours), np.zeros_like(colours)
    down, across = (np.asarray(each, np.float32) for each in np.gradient(colours, axis=(0, 1)))
    for slopes, axis in ((down, 0), (across, 1)):
        # Fourth order: differences of neighbours alone underestimate the slopes of fine detail.
        to, of = np.moveaxis(slopes, axis, 0), np.moveaxis(colours, axis, 0)
        to[2:-2] = (8 * (of[3:-1] - of[1:-3]) - (of[4:] - of[:-4])) / 12
    return across, down


def _between(values: Pixels, x: Pixels, y: Pixels) -> Pixels:
    """(n, c) bilinear samples of values (height, width, c) at places x, y (n,) inside. [px]"""
    height, width, channels = values.shape
    left = np.minimum(x.astype(np.int32), width - 2)
    top = np.minimum(y.astype(np.int32), height - 2)
    across, down = (x - left)[:, None], (y - top)[:, None]
    flat, first = values.reshape(-1, channels), top * width + left
    upper = flat[first] + (flat[first + 1] - flat[first]) * across
    first += width
    lower = flat[first] + (flat[first + 1] - flat[first]) * across
    between: Pixels = upper + (lower - upper) * down
    return between


class _Level:
    """The camera's picture in means of blocks of size x size pixels."""

    def __init__(
        self, colours: Pixels, counts: Pixels, camera: Camera, size: int, finest: bool
    ) -> None:
        self.size, self.camera, self.finest = size, _reduced(camera, size), finest
        means, shares = _masked_means(colours, counts, size)
        # Pixels beside those that don't count have no gradients, so they don't count either.
        means[shares == 0] = np.nan
        values = np.concatenate([means, *_gradients(means)], axis=-1)
        shares *= np.isfinite(values).all(axis=-1)
        # Colours, their gradients along x and y, and how much a pixel counts.
        self.values = np.nan_to_num(np.concatenate([values, shares[..., None]], axis=-1))


# --- The map's pixels, and equations for a pose ---------------------------------------------------


def motion(step: ArrayLike) -> Array:
    """(4, 4) motion of a camera along its axes by step[:3] [m], turned by vector step[3:] [rad]."""
    moved = np.eye(4)
    along, turn = np.split(np.asarray(step, np.float64), 2)
    angle = float(np.linalg.norm(turn))
    if angle > 0:
        axis = math.sin(angle / 2) * turn / angle
        moved[:3, :3] = to_matrices(np.append(axis, math.cos(angle / 2)))
    moved[:3, 3] = along
    return moved


@dataclass(frozen=True, eq=False)
class Equations:
    """Equations for a step: the pose's 6, as in motion(), then each channel's gain and bias.

    All sums are weighted means over pixels and channels.
    """

    hessian: Array
    """(12, 12) change of the gradient by a step."""
    gradient: Array
    """(12,)"""
    flow: Array
    """(6, 6) step @ flow @ step is the mean square by which a step moves pixels. [px^2]"""
    contrast: float
    """Weighted mean square of the gradients along an axis."""
    cost: float
    deviation: float
    """Standard deviation of the errors, from their median."""


@dataclass(frozen=True, eq=False)
class NewtonEquations(Equations):
    """Equations whose solution is the pose that is sought, once they have become true."""

    covariance: Array
    """(6, 6) of the pose's step; infinite where the picture doesn't tell it."""
    explained: float
    """Share of the picture's variance that the map explains."""

    @property
    def uncertain(self) -> float:
        """Root mean square of the pixels' standard deviations due to the pose's. [px]"""
        if not np.isfinite(self.covariance).all():
            return math.inf
        return math.sqrt(max(float(np.trace(self.flow @ self.covariance)), 0.0))


@dataclass(frozen=True, eq=False)
class _Errors:
    """The map's pixels that a moved camera's picture has, and by how much the two differ."""

    inside: NDArray[np.bool_]
    points: Pixels
    """(3, n) in the moved camera's frame. [m]"""
    colours: Pixels
    """(n, 3) of the map."""
    real: Pixels
    """(n, 10) of the picture: as _Level.values."""
    counts: Pixels
    """(n,) how much each pixel counts."""
    values: Pixels
    """(n, 3) errors."""
    deviation: float
    weight: float
    """Sum over all channels of all pixels."""

    def mean(self, values: Pixels) -> float:
        """Of values (n, 3) of pixels, as they count."""
        return float(np.sum(self.counts @ values, dtype=np.float64)) / self.weight


class MapPixels:
    """The pixels of a drawing that show the map: points, colours and gradients."""

    def __init__(self, level: _Level, drawn: dict[str, Any]) -> None:
        self._level, camera, size = level, level.camera, level.size
        colours = _means(drawn["colour"][..., :3], size)
        alphas = _means(drawn["colour"][..., 3], size)
        depths = _blocks(drawn["depth"][..., 0], size)[:, size // 2, :, size // 2]
        self._shown = np.isfinite(depths) & (alphas >= LEAST_ALPHA)
        self._places = down, across = np.array(np.nonzero(self._shown))
        z = depths[self._shown]
        x = (across + 0.5 - camera.cx) / camera.fx * z
        y = (down + 0.5 - camera.cy) / camera.fy * z
        self._points = np.stack([x, y, z]).astype(np.float32)
        self._alphas, self._colours = alphas[self._shown], colours[self._shown]
        self._gradients = tuple(each[self._shown] for each in _gradients(colours))

    def __len__(self) -> int:
        return len(self._alphas)

    def equations(self, move: Array, exposure: Array, deviation: float = 0.0) -> Equations | None:
        """Gauss-Newton's equations for a camera moved by `move` (4, 4), for Cauchy's weights.

        exposure: (3, 2) gain and bias of each channel. deviation: standard deviation of the errors,
        0 to take it from their median. None for too little map in the camera's picture.
        """
        errors = self._errors(move, exposure, deviation)
        if errors is None:
            return None
        squares = (errors.values / np.float32(CAUCHY * errors.deviation)) ** 2
        weights = errors.counts[:, None] / (1 + squares)
        by_pose = _flows(self._level.camera, errors.points)
        hessian, gradient, contrast = np.zeros((12, 12)), np.zeros(12), 0.0
        rows = np.ones((8, len(weights)), np.float32)
        for channel in range(3):
            slopes = [
                (ours + theirs) / 2
                for ours, theirs in zip(*self._slopes(errors, exposure, channel), strict=True)
            ]
            rows[:6] = -(by_pose[0] * slopes[0] + by_pose[1] * slopes[1])
            rows[6] = errors.colours[:, channel]
            weighted = rows * weights[:, channel]
            places = _places(channel)
            hessian[np.ix_(places, places)] += weighted @ rows.T
            gradient[places] += weighted @ errors.values[:, channel]
            contrast += float(weights[:, channel] @ (slopes[0] ** 2 + slopes[1] ** 2)) / 2
        return Equations(
            hessian=hessian / errors.weight,
            gradient=gradient / errors.weight,
            flow=_mean_flow(by_pose, errors),
            contrast=contrast / errors.weight + 1e-12,
            cost=errors.mean(np.log1p(squares)),
            deviation=errors.deviation,
        )

    def newton_equations(self, exposure: Array) -> NewtonEquations | None:
        """Newton's equations for the camera where it is, for Tukey's biweight.

        exposure: as in equations(). None for too little map in the camera's picture.
        """
        errors = self._errors(np.eye(4), exposure)
        if errors is None:
            return None
        counts = errors.counts
        squares = (errors.values / np.float32(BIWEIGHT * errors.deviation)) ** 2
        near = np.maximum(1 - squares, 0)
        shares, curving = near**2, near * (1 - 5 * squares)
        by_pose = _flows(self._level.camera, errors.points)
        bread, meat, contrast = np.zeros((12, 12)), np.zeros((12, 12)), 0.0
        tiles = _tiles(self._places)
        by_tile = np.zeros((12, tiles.max() + 1))
        ours, theirs = np.ones((2, 8, len(counts)), np.float32)
        for channel in range(3):
            of_map, of_picture = self._slopes(errors, exposure, channel)
            ours[:6] = -(by_pose[0] * of_map[0] + by_pose[1] * of_map[1])
            theirs[:6] = -(by_pose[0] * of_picture[0] + by_pose[1] * of_picture[1])
            ours[6] = theirs[6] = errors.colours[:, channel]
            weights = shares[:, channel] * counts
            places = _places(channel)
            bread[np.ix_(places, places)] += (ours * (curving[:, channel] * counts)) @ theirs.T
            meat[np.ix_(places, places)] += (ours * weights) @ ours.T
            influences = ours * (weights * errors.values[:, channel])
            for place, influence in zip(places, influences, strict=True):
                by_tile[place] += np.bincount(tiles, influence, by_tile.shape[1])
            contrast += float(weights @ (of_map[0] ** 2 + of_map[1] ** 2)) / 2
        real, full = errors.real[:, :3], errors.mean(shares)
        noise = (errors.mean((shares * errors.values) ** 2) + ROUNDING) / full
        spread = real - (counts @ real) / counts.sum()
        left = errors.mean(shares * errors.values**2)
        return NewtonEquations(
            hessian=bread / errors.weight,
            gradient=by_tile.sum(axis=1) / errors.weight,
            flow=_mean_flow(by_pose, errors),
            contrast=contrast / errors.weight + 1e-12,
            cost=errors.mean((1 - near**3) / 3),
            deviation=errors.deviation,
            covariance=_covariance(bread, meat, by_tile, noise),
            explained=1 - left / max(errors.mean(shares * spread**2), ROUNDING),
        )

    def _errors(self, move: Array, exposure: Array, deviation: float = 0.0) -> _Errors | None:
        level = self._level
        camera = level.camera
        back = np.linalg.inv(move).astype(np.float32)
        points = back[:3, :3] @ self._points + back[:3, 3:]
        if (move != np.eye(4)).any():
            with np.errstate(all="ignore"):
                u = camera.fx * points[0] / points[2] + (camera.cx - 0.5)
                v = camera.fy * points[1] / points[2] + (camera.cy - 0.5)
                inside = (u >= 0) & (v >= 0) & (u <= camera.width - 1) & (v <= camera.height - 1)
            inside &= points[2] > 0.01 * self._points[2]
            if inside.sum() < max(LEAST_COMMON * len(self), LEAST_POINTS):
                return None
            points = points[:, inside]
            real = _between(level.values, u[inside], v[inside])
        else:
            inside, real = np.ones(len(self), bool), level.values[self._shown]
        counts = real[:, -1] * self._alphas[inside]
        weight = 3 * float(counts.sum(dtype=np.float64))
        if weight < 3 * LEAST_POINTS * LEAST_ALPHA:
            return None
        colours = self._colours[inside]
        values = colours * exposure[:, 0].astype(np.float32) - real[:, :3]
        values += exposure[:, 1].astype(np.float32)
        median = float(np.median(np.abs(values[counts > 0])))
        deviation = deviation or max(1.4826 * median, LEAST_DEVIATION)
        return _Errors(inside, points, colours, real, counts, values, deviation, weight)

    def _slopes(
        self, errors: _Errors, exposure: Array, channel: int
    ) -> tuple[list[Pixels], list[Pixels]]:
        """The map's gradients of a channel along x and y as the camera would have them, and the
        picture's.
        """
        gain = np.float32(exposure[channel, 0])
        return (
            [gain * gradients[errors.inside, channel] for gradients in self._gradients],
            [errors.real[:, 3 + channel], errors.real[:, 6 + channel]],
        )


def _places(channel: int) -> list[int]:
    """Among a step's 12 numbers, those that a channel's pixels depend on."""
    return [*range(6), 6 + 2 * channel, 7 + 2 * channel]


def _tiles(places: NDArray[np.intp]) -> NDArray[np.intp]:
    """(n,) numbers, from 0, of the tiles of pixels at rows and columns (2, n)."""
    side = max(math.isqrt(places.shape[1] // TILES), 1)
    row, column = places // side
    return np.asarray(row * (column.max() + 1) + column)


def _covariance(bread: Array, meat: Array, by_tile: Array, noise: float) -> Array:
    """(6, 6) of a pose's step, from sums over all pixels.

    bread, meat: (12, 12). by_tile: (12, tiles) gradients. noise: variance of the errors, were they
    independent from pixel to pixel; the least that counts.
    """
    used = by_tile[:, by_tile.any(axis=0)]
    unknown, count = used.shape
    with np.errstate(all="ignore"):
        inverse = np.linalg.pinv(bread + np.diag(np.full(unknown, RIDGE)))[:6]
        unit = inverse @ meat @ inverse.T
        unit = (unit + unit.T) / 2  # symmetric to the bit
        steps = inverse @ used  # that each tile asks for; their sum is the step
        squares = float(np.sum(steps * (np.linalg.pinv(unit, hermitian=True) @ steps)))
    if count <= unknown or not np.isfinite(squares):
        return np.diag(np.full(6, np.inf))
    return np.asarray(unit * max(squares / 6 * count / (count - unknown), noise))


def _mean_flow(by_pose: tuple[Pixels, Pixels], errors: _Errors) -> Array:
    flow = sum(((each * errors.counts) @ each.T).astype(np.float64) for each in by_pose)
    return np.asarray(flow / (errors.weight / 3))


def _flows(camera: Camera, points: Pixels) -> tuple[Pixels, Pixels]:
    """Derivatives of x, and of y [px], of points (3, n) by a step as in motion(): (6, n) each."""
    x, y, z = points
    a, b = np.float32(camera.fx) / z, np.float32(camera.fy) / z
    u, v, none = x / z, y / z, np.zeros_like(z)
    return (
        np.stack([-a, none, a * u, a * u * y, -a * (z + u * x), a * y]),
        np.stack([none, -b, b * v, b * (z + v * y), -b * v * x, -b * x]),
    )


# --- The search -----------------------------------------------------------------------------------


class _Search:
    """The pose as it is refined from level to level."""

    def __init__(
        self, renderer: CpuRenderer, camera: Camera, most_uncertain: float, drawings: int
    ) -> None:
        self._renderer, self._camera, self._most_uncertain = renderer, camera, most_uncertain
        self._pose = camera.camera_to_world
        self._exposure = np.tile([1.0, 0.0], (3, 1))
        self._drawings = drawings
        self._last: NewtonEquations | None = None  # of the finest level
        self._problem = ""

    def refine(self, level: _Level) -> None:
        """Moves the pose until the level's pixels stand still, or have been drawn often enough."""
        for _ in range(FINEST_DRAWINGS if level.finest else DRAWINGS):
            pixels = self._draw(level)
            if len(pixels) < LEAST_POINTS:
                self._problem = f"the map shows {len(pixels)} pixels, at least {LEAST_POINTS} count"
                return
            moved = self._step(pixels) if level.finest else self._search(level, pixels)
            if moved is None:
                self._problem = "the map and the picture have too little in common"
                return
            self._problem = ""
            if moved < (self._still() if level.finest else STILL):
                return
        if level.finest:
            self._problem = f"after {self._drawings} drawings, pixels still move by {moved:.2f}"

    def _draw(self, level: _Level) -> MapPixels:
        camera = replace(self._camera, world_to_camera=self._world_to_camera())
        self._drawings += 1
        return MapPixels(level, self._renderer.draw(posed(camera), mean_depth=True))

    def _step(self, pixels: MapPixels) -> float | None:
        """Takes one step, after which the map must be drawn again; returns the pixels' motion. [px]

        Once that is short, the minimum is near.
        """
        self._last = pixels.newton_equations(self._exposure)
        if self._last is None:
            return None
        step, moved = _solved(self._last, NEWTON_DAMPING)
        self._pose = self._pose @ motion(step[:6])
        self._exposure = self._exposure + step[6:].reshape(3, 2)
        return moved

    def _search(self, level: _Level, pixels: MapPixels) -> float | None:
        """Takes steps that reduce the errors; returns the pixels' motion by all of them. [px]"""
        move, exposure, damping = np.eye(4), self._exposure, DAMPING
        now = start = pixels.equations(move, exposure)
        if now is None or start is None:
            return None
        for _ in range(STEPS):
            step, moved = _solved(now, damping)
            further = move @ motion(step[:6]), exposure + step[6:].reshape(3, 2)
            then = pixels.equations(*further, now.deviation)
            if then is None or then.cost > now.cost:
                damping = 8 * max(damping, 10 * LEAST_DAMPING)
            else:
                (move, exposure), now = further, then
                damping = max(damping / 4, LEAST_DAMPING)
            if moved < FINEST_STILL or damping > MOST_DAMPING:
                break
        self._pose, self._exposure = self._pose @ move, exposure
        return _length(start, np.concatenate([move[:3, 3], _turn(move)]))

    def result(self) -> Alignment:
        """The result on the finest level."""
        found, covariance = self._last, np.diag(np.full(6, np.inf))
        problem = self._problem
        if found and not problem:
            covariance = self._turned(found.covariance)
            gains = self._exposure[:, 0]
            if not gains.max() <= MOST_TINT * gains.min():
                red, green, blue = gains
                problem = f"no exposure has gains of {red:.2f}, {green:.2f} and {blue:.2f}"
            elif found.explained < LEAST_EXPLAINED:
                problem = f"the map explains {found.explained:.2f} of the picture's variance"
            elif not found.uncertain <= self._most_uncertain:
                problem = f"the picture tells where pixels are to {found.uncertain:.1f} px only"
        gain, bias = self._exposure.T.copy()
        return Alignment(
            self._world_to_camera(),
            covariance,
            problem,
            self._drawings,
            found.deviation if found else math.inf,
            found.explained if found else 0.0,
            gain,
            bias,
        )

    def _world_to_camera(self) -> Array:
        return np.asarray(np.linalg.inv(self._pose), np.float64)

    def _turned(self, covariance: Array) -> Array:
        """A step's covariance (6, 6) about the map's axes."""
        if not np.isfinite(covariance).all():
            return covariance
        turned = np.kron(np.eye(2), self._pose[:3, :3])
        return turned @ covariance @ turned.T

    def _still(self) -> float:
        """Motion of pixels, below which the pose stands still on the finest level. [px]"""
        uncertain = min(self._last.uncertain if self._last else 0.0, self._most_uncertain)
        return max(STILL_SHARE * uncertain, FINEST_STILL)


def _solved(equations: Equations, damping: float) -> tuple[Array, float]:
    """A step (12,) of pose and exposure, LONGEST_STEP at most, and the pixels' motion. [px]"""
    hessian = equations.hessian.copy()
    hessian[:6, :6] += damping * equations.contrast * equations.flow
    hessian[range(12), range(12)] += [*[0.0] * 6, *[RIDGE] * 6]
    step = np.asarray(-np.linalg.lstsq(hessian, equations.gradient, rcond=None)[0], np.float64)
    moved = _length(equations, step[:6])
    if moved > LONGEST_STEP:
        step, moved = step * (LONGEST_STEP / moved), LONGEST_STEP
    return step, moved


def _length(equations: Equations, step: Array) -> float:
    return math.sqrt(max(float(step @ equations.flow @ step), 0.0))


def _turn(move: Array) -> Array:
    """(3,) rotation vector of a motion, of less than half a turn."""
    *axis, cosine = from_matrices(move[:3, :3]).tolist()
    sine = float(np.linalg.norm(axis))
    angle = 2 * math.atan2(sine, cosine)
    angle -= 2 * math.pi * (angle > math.pi)
    return np.array(axis) * (angle / sine if sine > 0 else 2.0)
