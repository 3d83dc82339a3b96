"""From where to look at a scene first: a level camera whose picture shows much of it, sharply.

1. The scene is turned upright, its middle is moved to 0 and its radius made 1. Few splats stand for
   all: each is kept with a probability in proportion to its area, and grows to make up for those
   that are not, so pictures of them have about the scene's coverage.
2. Cameras to try stand around the scene, where it just fits the picture, amid it around its middle,
   and within, at free places, facing all around, each as far back as there is room. Where the
   cameras are known that took the scene, they alone are tried.
3. Those that have many resolved splats before them are drawn: lightness and warmth of the colours,
   the size of the splats, and depth. Blur, and what is close to the camera, make a picture worth
   less.
4. A scene that surrounds its free places, such as a room, is shown from within, and so is one of
   which no camera around it shows much. There, a picture is worth its contrast, its depth, and how
   much of it differs from its neighbours, in colour or because another plane begins: a bare wall
   has neither. An empty part makes it worth little. A hollow object isn't a room: its middle sees
   all of it, and no floor, or it is a blur from within.
5. Another scene is shown whole, above all its top. A picture is worth the share of the scene's
   splats that it shows: not hidden by others, and no smaller than a pixel. Trainers put splats
   where photographs have detail, so the share is that of the detail that is seen.
6. The best camera is moved about a little while that helps. A narrower picture of a whole scene is
   taken from farther away.
"""

from __future__ import annotations

import logging
import math
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rosplat_core import harmonics
from rosplat_core.cameras import Camera, check_cameras, load_cameras, look_at
from rosplat_core.formats.ply_file import PlyFile
from rosplat_core.payload import PACKED, decode
from rosplat_core.quaternions import from_matrices, product
from rosplat_core.rendering import CpuRenderer, posed
from rosplat_core.splats import InputError, PackedSplats, Splats, check_splats, unit
from rosplat_core.upright import NEARBY, find_up, level, photographed, shell

_log = logging.getLogger(__name__)

CAMERA_FILES = ("cameras.json", "transforms.json")
KEPT = 16_000  # splats that stand for a scene
READ = 300_000  # most splats that these are chosen from
POINTS = 1500  # splats by which cameras are chosen that are drawn
WIDTH, HEIGHT = 128, 72  # of pictures [px]
FOCAL = 0.5 * HEIGHT / math.tan(math.radians(22.5))  # as in rviz2: 45 degrees from top to bottom
SHOWN_HEIGHT = 720  # of the picture that a user sees [px]
ELEVATIONS = (8, 16, 26, 40)  # of cameras around a scene [deg]
AZIMUTHS = 12
RINGS = (1.2, 2.0, 3.2)  # distances of nearer ones, in median distances of splats from the middle
GRID = 6  # free places are looked for on so many lines each way
CLEARANCE = 0.1  # from a free place to the nearest splats, in the scene's radii
BACK, STEPS_BACK = 0.06, 12  # length and number of steps that a camera goes back from there
PITCHES = (-6, -13)  # of cameras within [deg]
DRAWN = {"around": 16, "amid": 12, "within": 48, "taken": 40}  # how many cameras are drawn of each
FURTHER = 240  # within, of a scene that is shown from there
RESOLVED = 10  # standard deviation of a splat at which it counts half [px of SHOWN_HEIGHT]
BLUR = 0.12  # sharpness within a hollow object
BLURRED = 40  # that from which a near splat is blurred
CLEAR = 0.8  # share of a hollow object that its middle sees
FLOOR, LEAST_FLOOR = 0.02, 0.08  # thickness of a floor, in the scene's radii; its share of a room
CLOSE = 0.15  # distance within which things are too close, in the scene's radii
MOST_BENT = 0.1  # that counts, of 1 / depth
BARE = 0.005  # difference between parts of a bare wall
TILE = 4  # edge of parts of a picture that are compared [px]
MIDDLE = slice(6, -6)  # columns of these that a window as wide as high shows, too
SURROUNDED = 0.9  # least part of pictures from within that is covered, for the scene to surround it
HIDDEN = 0.2  # share of a scene that is shown from within if no camera around it shows more
MARGIN = 0.9  # part of a picture that a whole object may fill
NARROWER = (0.5, 1.0, 1.5)  # widths of pictures, in their heights, that it is fitted to as well
SIZES = (1e-6, 10)  # of splats that can be told, in the scene's radii
LIGHTNESS, WARMTH = (0.3, 0.6, 0.1), (0.5, 0, -0.5)  # of colours
NEAR = 1e-3  # depth from which splats are drawn, in distances of the target
STEPS = 3  # in which the best camera is moved
PATIENCE = 5.0  # after so long, the best camera so far is taken [s]
LEAST = 16  # cameras that are drawn all the same
LOOKS = 240  # from within, that are drawn to find those that a scene surrounds


@dataclass(frozen=True, eq=False)
class FirstView:
    """Where a camera is, the point that it looks at, and the scene's vertical, (3,) each. [m]"""

    eye: NDArray[np.float64]
    target: NDArray[np.float64]
    up: NDArray[np.float64]
    width: float = 0.0
    """Of a picture that all of the scene fits, in its heights; 0 for a view from within."""
    inside: bool = False
    """Whether the scene surrounds the camera, as a room does."""

    def eye_for(self, width: float, height: float) -> NDArray[np.float64]:
        """Where the camera is for a window of width x height: farther away for a narrow one. [m]"""
        farther = max(1.0, self.width * height / width)
        return self.target + (self.eye - self.target) * farther

    def camera(self, width: int, height: int) -> Camera:
        """The camera for a picture of width x height [px], with a view 45 degrees high."""
        eye = self.eye_for(width, height)
        distance = float(np.linalg.norm(self.target - eye))
        focal = 0.5 * height / math.tan(math.radians(22.5))
        return Camera(
            0, width, height, focal, focal, width / 2, height / 2,
            look_at(eye, self.target, self.up), near=NEAR * distance, far=max(1e10, distance),
        )  # fmt: skip


def sample(splats: Splats | PackedSplats, most: int = READ) -> Splats:
    """Some splats of a scene, evenly chosen, by which its vertical and first view are found."""
    rows = np.linspace(0, len(splats) - 1, min(len(splats), most)).astype(np.intp)
    if isinstance(splats, Splats):
        return splats[rows]
    packed = splats.rows[rows]
    arrays = decode(packed.view(np.uint8).ravel(), len(rows), splats.sh_degree, PACKED)
    return Splats(**vars(arrays), origin=splats.origin, up=splats.up)


def cameras_beside(scene: str) -> list[Camera]:
    """The cameras that took a scene, if a file of them lies where trainers put it; else none.

    cameras.json (INRIA) or transforms.json (nerfstudio) lies in the scene's folder, or in the
    model's, which has point_cloud/iteration_N/point_cloud.ply. One that can't be read counts as
    none. A PLY that SHARP made of a photograph has its camera in elements of its own.
    """
    path = Path(scene)
    if taken := _taken_by(path):
        return [taken]
    for folder in (path, *path.resolve().parents[:3]):
        for name in CAMERA_FILES:
            if (folder / name).is_file():
                try:
                    return load_cameras(folder / name)
                except InputError as error:
                    _log.warning("cameras are not taken: %s", error)
    return []


def _taken_by(path: Path) -> Camera | None:
    """The camera of SHARP's photograph."""
    if path.suffix.lower() != ".ply" or not path.is_file():
        return None
    try:
        file = PlyFile(path)
        matrix, (fx, _, cx, _, fy, cy, *_), (width, height) = (
            file.rows(name)[:][name] for name in ("extrinsic", "intrinsic", "image_size")
        )
        return Camera(0, int(width), int(height), fx, fy, cx, cy, matrix.reshape(4, 4))
    except (InputError, ValueError, KeyError):  # most have none
        return None


def first_view(
    splats: Splats | PackedSplats, up: ArrayLike | None = None, cameras: Sequence[Camera] = ()
) -> FirstView:
    """The view of a scene to begin with.

    up (3,): its vertical; by default that of the splats, or else by their ground. cameras: that
    took the scene.
    """
    if not isinstance(splats, PackedSplats):
        check_splats(splats)
    check_cameras(cameras)
    cameras = cameras or photographed(sample(splats))
    up = unit(splats.up or find_up(sample(splats), cameras) if up is None else up)
    if not len(splats):
        return FirstView(np.zeros(3), np.array([1.0, 0, 0]), np.array([0, 0, 1.0]))
    stage, began = _Stage(splats, np.array(up)), time.monotonic()
    tried = _taken(stage, cameras) if cameras else _around(stage) + _amid(stage) + _within(stage)
    seen: list[tuple[_Look, _Seen]] = []

    def draw(looks: Sequence[_Look]) -> None:
        for look in looks:
            if time.monotonic() > began + PATIENCE and len(seen) >= LEAST:
                break
            seen.append((look, stage.seen(look)))

    draw(_chosen(stage, tried, DRAWN))
    within = [found for look, found in seen if look.kind == "within"]
    sharp = [found.sharp for found in within if found.surrounds]
    surrounded = len(sharp) > len(within) / 2 and float(np.median(sharp)) > BLUR
    shown = max((found.shown for look, found in seen if look.kind == "around"), default=0.0)
    surrounding = bool(within) and (surrounded or shown < HIDDEN)
    if surrounding:
        left_out = "amid", "around" if surrounded else ""
        seen = [(look, found) for look, found in seen if look.kind not in left_out]
        draw(_chosen(stage, tried, {"within": FURTHER})[DRAWN["within"] :])
    best, found = max(seen, key=lambda pair: pair[1].worth(surrounding))
    step = 1.0
    for _ in range(0 if cameras else STEPS):
        if time.monotonic() > began + PATIENCE:
            break
        tried = [stage.fitted(look) if best.kind == "around" else look for look in best.moved(step)]
        moved = [(look, stage.seen(look)) for look in tried]
        look, better = max(moved, key=lambda pair: pair[1].worth(surrounding))
        if better.worth(surrounding) > found.worth(surrounding):
            best, found = look, better
        else:
            step /= 2
    inside = found.surrounds or (surrounding and best.kind == "within")
    return replace(stage.placed(best), inside=inside)


def views_within(splats: Splats, up: ArrayLike) -> list[FirstView]:
    """Views from free places that a scene surrounds, such as rooms; none of another scene.

    up (3,): the scene's vertical.
    """
    stage = _Stage(splats, np.asarray(up, np.float64))
    looks = _within(stage)
    promising = _chosen(stage, looks, DRAWN)
    if not sum(stage.seen(look).surrounds for look in promising) > len(promising) / 2:
        return []
    some = np.random.default_rng(0).permutation(len(looks))[:LOOKS]
    return [stage.placed(looks[i]) for i in some if stage.seen(looks[i]).surrounds]


@dataclass(frozen=True, eq=False)
class _Look:
    """A camera on the stage."""

    kind: str
    eye: NDArray[np.float64]
    target: NDArray[np.float64]
    width: float = 0.0
    """As FirstView's."""

    @property
    def away(self) -> NDArray[np.float64]:
        """From the target to the camera."""
        return self.eye - self.target

    @cached_property
    def view(self) -> NDArray[np.float64]:
        """Its rotation (3, 3) from the stage, z up, to the optical frame."""
        x, y, z = (self.target - self.eye) / np.linalg.norm(self.target - self.eye)
        flat = max(math.hypot(x, y), 1e-9)
        right, ahead = (y / flat, -x / flat), (x / flat, y / flat)
        return np.array(
            [
                [*right, 0],
                [ahead[0] * z, ahead[1] * z, -flat],
                [ahead[0] * flat, ahead[1] * flat, z],
            ]
        )

    def moved(self, step: float) -> list[_Look]:
        """The camera turned to both sides; one outside moved around its target, up and down."""
        away = self.away
        looks = []
        for angle in (-0.2 * step, 0.2 * step):
            turn = np.array(
                [[math.cos(angle), -math.sin(angle), 0], [math.sin(angle), math.cos(angle), 0],
                 [0, 0, 1]]
            )  # fmt: skip
            if self.kind != "around":
                looks.append(replace(self, target=self.eye - turn @ away))
                continue
            lift = np.array([0, 0, angle / 2 * math.hypot(away[0], away[1])])
            looks.append(replace(self, eye=self.target + turn @ away))
            looks.append(replace(self, eye=self.eye + lift))
        return looks


@dataclass(frozen=True)
class _Seen:
    """What a picture shows of the scene, 0 to 1, and how."""

    shown: float
    """The share of the scene."""
    covered: float
    """The part of the picture that isn't empty."""
    enclosed: float
    """The part that the scene itself covers, without what lies far out, such as a sky."""
    spoilt: float
    """The part that is close, or near and blurred."""
    sharp: float
    contrast: float
    """Standard deviation of the colours in the middle, from 0.02."""
    variety: float
    """Mean difference between neighbouring parts."""
    spread: float
    """Their geometric mean in the middle: small where much of that is bare."""
    depth: float
    """Mean of what is shown, in the scene's radii, 1 at most."""
    vista: float
    """Depth beyond which a twentieth of the picture is, as above."""
    cut: float
    """What falls outside the picture counts as so much."""
    level: float
    """Cosine of the angle that the camera looks up or down."""

    @property
    def surrounds(self) -> bool:
        """Whether the scene fills the picture, and mostly with what is not too near."""
        return self.enclosed > SURROUNDED and self.spoilt < 0.5

    def worth(self, surrounding: bool) -> float:
        """surrounding: whether the scene does that."""
        clear = self.sharp**3 * (1 - self.spoilt) ** 4
        if surrounding:
            lively = math.sqrt(self.contrast) * self.spread**2 * self.depth * self.vista
            return lively * clear * float(self.enclosed**10)
        whole = self.shown * math.exp(-self.cut) * self.level**2
        return whole * clear * self.variety * math.sqrt(self.covered)


class _Stage:
    """A scene upright, its middle at 0, its radius 1; and what stands for it in pictures."""

    def __init__(self, scene: Splats | PackedSplats, up: NDArray[np.float64]) -> None:
        from scipy.spatial import cKDTree  # takes its time

        splats = sample(scene)
        random = np.random.default_rng(0)
        self._origin = splats.origin
        self._up = up / np.linalg.norm(up)
        self._rotation = np.array([*level(self._up), self._up])
        rows, chances = _standing(splats, random)
        positions = splats.positions[rows].astype(np.float64) @ self._rotation.T
        scales = np.maximum(splats.scales[rows].astype(np.float64), 0)
        self._weights = 1 / chances / np.sum(1 / chances)
        solid = splats.opacities[rows] > min(0.1, float(splats.opacities[rows].max()))
        solid |= ~solid.any()
        counted = random.choice(
            np.flatnonzero(solid), 20_000, p=self._weights[solid] / self._weights[solid].sum()
        )
        sizes = np.sort(scales, axis=1)[:, 1:].prod(axis=1) ** 0.5
        below = ~shell(positions, sizes, counted)
        counted = counted[below[counted]]
        self._middle = np.median(positions[counted], axis=0)
        away = np.linalg.norm(positions[counted] - self._middle, axis=1)
        near = counted[away <= NEARBY * np.median(away)]  # without a sky, for example
        far = counted[away > NEARBY * np.median(away)]
        if len(far) and np.median(sizes[far]) <= np.median(sizes[near]):  # such as a guitar's neck
            near = counted
        lowest, low, high, highest = np.quantile(
            positions[near], [0.002, 0.05, 0.95, 0.998], axis=0
        )
        extent = float(np.linalg.norm(high - low)) / 2
        self._radius = max(extent, 2 * float(np.median(scales.max(axis=1))), 1e-12)
        self.positions = (positions - self._middle) / self._radius
        self.low, self.high, self._lowest, self._highest = (
            (corner - self._middle) / self._radius for corner in (low, high, lowest, highest)
        )
        self.core = max(float(np.median(np.linalg.norm(self.positions[counted], axis=1))), 0.05)
        unread = (len(scene) / len(splats)) ** 0.25  # less than for their area: many overlap
        grown = unread * scales / self._radius / np.sqrt(chances)[:, None]
        self._sizes = sizes / self._radius
        chance = self._weights * below
        self._sampled = random.choice(len(rows), POINTS, p=chance / chance.sum())
        self._solid = cKDTree(self.positions[splats.opacities[rows] > 0.3])
        points = self.positions[self._sampled]
        self._probes = points.T.copy()
        # All of the scene but what lies far out.
        inside = self.holds(points)
        inside |= ~inside.any()
        self.whole = points[inside]
        self._reach = self._sizes[self._sampled][inside]
        colours = (0.5 + harmonics.C0 * splats.sh[rows, 0].astype(np.float64)).clip(0, 1)
        told = np.log(self._sizes.clip(*SIZES) / SIZES[0]) / math.log(SIZES[1] / SIZES[0])
        painted = np.column_stack([colours @ LIGHTNESS, 0.5 + colours @ WARMTH, told])
        self._renderer = CpuRenderer(
            Splats(
                positions=self.positions.astype(np.float32),
                orientations=product(
                    from_matrices(self._rotation), splats.orientations[rows]
                ).astype(np.float32),
                scales=grown.astype(np.float32),
                opacities=splats.opacities[rows],
                sh=((painted - 0.5) / harmonics.C0).astype(np.float32)[:, None],
            )
        )

    def promise(self, look: _Look) -> float:
        """The share of the splats that are before a camera and resolved, hidden or not."""
        x, y, z = look.view @ (self._probes - look.eye[:, None])
        inside = (
            (z > 0.02) & (np.abs(x) * FOCAL < z * WIDTH / 2) & (np.abs(y) * FOCAL < z * HEIGHT / 2)
        )
        pixels = _pixels(self._sizes[self._sampled], z)
        return float(np.mean(inside * np.minimum(1, pixels) * np.minimum(1, 12 / pixels)))

    def seen(self, look: _Look) -> _Seen:
        """What a camera's picture shows."""
        near = NEAR * max(float(np.linalg.norm(look.away)), 1e-6)
        view = look_at(look.eye, look.target)
        middle = WIDTH / 2, HEIGHT / 2
        camera = Camera(0, WIDTH, HEIGHT, FOCAL, FOCAL, *middle, view, near=near)
        drawn = self._renderer.draw(posed(camera), mean_depth=True)
        painted, alpha = drawn["colour"][..., :3], drawn["colour"][..., 3]
        covered = float(alpha.mean())
        depth = np.where(alpha > 0.02, drawn["depth"][..., 0], 0)
        told = painted[..., 2] / np.maximum(alpha, 1e-3)
        pixels = _pixels(SIZES[0] * (SIZES[1] / SIZES[0]) ** told, depth)
        places = depth[..., None] * (_RAYS @ look.view) + look.eye
        here = np.linalg.norm(places, axis=-1) < NEARBY * self.core
        close = (depth < CLOSE) | ((pixels > BLURRED) & (depth < 0.75 * self.core))
        near = painted[..., :2] * here[..., None]
        tiles = near.reshape(HEIGHT // TILE, TILE, WIDTH // TILE, TILE, 2).mean(axis=(1, 3))
        steps = (np.abs(np.diff(tiles, axis=axis)).sum(axis=-1).mean() for axis in (0, 1))
        reach = np.minimum(depth, 1)
        return _Seen(
            shown=self._shown(look, depth),
            covered=covered,
            enclosed=float((alpha * here).mean()),
            spoilt=float((alpha * close).mean()),
            sharp=float((alpha / (1 + pixels / RESOLVED)).mean()) / max(covered, 1e-3),
            contrast=max(0.02, float(tiles[:, MIDDLE].std(axis=(0, 1)).sum())),
            variety=float(sum(steps)),
            spread=_spread(tiles[:, MIDDLE], depth[::TILE, ::TILE][:, MIDDLE]),
            depth=float(reach.mean()),
            vista=float(np.quantile(reach, 0.95)),
            cut=self._cut(look),
            level=float(np.linalg.norm(look.view[2, :2])),
        )

    def _shown(self, look: _Look, depth: NDArray[np.float32]) -> float:
        """The share of the scene's splats that a picture of that depth shows, and resolves."""
        x, y, z = look.view @ (self._probes - look.eye[:, None])
        column, row = (
            (FOCAL * across / np.maximum(z, 1e-6) + side / 2).clip(-1, side)
            for across, side in ((x, WIDTH), (y, HEIGHT))
        )
        inside = (z > 0.02) & (column >= 0) & (column < WIDTH) & (row >= 0) & (row < HEIGHT)
        met = depth[row[inside].astype(np.intp), column[inside].astype(np.intp)]
        pixels = _pixels(self._sizes[self._sampled][inside], z[inside])
        return float(np.sum((z[inside] < 1.1 * met) * np.minimum(1, pixels))) / POINTS

    def holds(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Whether points (..., 3) are among the splats."""
        return np.asarray(((points >= self._lowest) & (points <= self._highest)).all(axis=-1))

    def free(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Whether nothing solid is near points (..., 3); none is free where hardly anything is."""
        nearest, _ = self._solid.query(points, k=5)
        return np.asarray((nearest[..., -1] > CLEARANCE) & (self._solid.n >= 5))

    @cached_property
    def is_hollow(self) -> bool:
        """Whether nothing is within but the middle's view of all of it, and there is no floor."""
        shares = np.linspace(0.3, 0.7, 3)[:, None, None]
        clear = float(self.free(shares * self.whole).all(axis=0).mean())
        floors = np.histogram(self.whole[:, 2], np.arange(-2.6, 2.6, FLOOR))[0] / len(self.whole)
        return clear > CLEAR and float(floors.max(initial=0)) < LEAST_FLOOR

    def _cut(self, look: _Look) -> float:
        """What falls outside a picture, or to its margin: above it counts most, beside it least."""
        x, y, z = look.view @ (self.whole - look.eye).T
        z = MARGIN * np.maximum(z, 1e-6)
        above, below = -y * FOCAL > z * HEIGHT / 2, y * FOCAL > z * HEIGHT / 2
        beside = np.abs(x) * FOCAL > z * WIDTH / 2
        cut = 100 * np.mean(above) + 10 * np.mean(below) + 2 * np.mean(beside)
        return min(float(cut), 1.5)

    def fitted(self, look: _Look) -> _Look:
        """The camera moved to where all of the scene fits its picture, and that picture's width.

        It is as near as it can be without turning, its target amid the depths that it sees.
        """
        x, y, z = look.view @ self.whole.T
        upright = MARGIN * HEIGHT / 2 / FOCAL
        middle, depths = [], []
        for across, slope in ((x, upright * WIDTH / HEIGHT), (y, upright)):
            # All is between two planes through the camera that are that steep.
            right = np.max(across + self._reach - slope * z)
            left = np.max(self._reach - across - slope * z)
            middle.append((right - left) / 2)
            depths.append(-(right + left) / (2 * slope))
        nearest = min(depths)
        distance = float(z.min() + z.max()) / 2 - nearest
        width = 0.0
        for narrow in NARROWER:
            outside = (np.abs(x - middle[0]) + self._reach) / (upright * narrow) - (z - nearest)
            if outside.max() > 0:
                width = max(width, narrow * (1 + float(outside.max()) / distance))
        width = min(width, WIDTH / HEIGHT)
        eye = np.array([*middle, nearest]) @ look.view
        return replace(look, eye=eye, target=eye + distance * look.view[2], width=width)

    def placed(self, look: _Look) -> FirstView:
        """A camera of the stage in the scene's own coordinates."""
        eye, target = (
            (point * self._radius + self._middle) @ self._rotation + self._origin
            for point in (look.eye, look.target)
        )
        return FirstView(eye, target, self._up, look.width)

    def staged(self, camera: Camera, distance: float) -> _Look:
        """A scene's camera on the stage, without its roll."""
        eye = (self._rotation @ (camera.position - self._origin) - self._middle) / self._radius
        return _Look("taken", eye, eye + distance * self._rotation @ camera.world_to_camera[2, :3])


_COLUMNS, _ROWS = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
_RAYS = np.stack(  # of a picture's pixels, of unit depth
    [(_COLUMNS - WIDTH / 2) / FOCAL, (_ROWS - HEIGHT / 2) / FOCAL, np.ones_like(_ROWS)], axis=-1
)


def _spread(tiles: NDArray[np.floating], depth: NDArray[np.float32]) -> float:
    """The geometric mean of what parts of a picture show: other colours than their neighbours, or
    another plane, across which 1 / depth bends."""
    near = 1 / np.maximum(depth, 1e-3)
    told = 0.0
    for axis in (0, 1):
        step = np.delete(np.abs(np.diff(tiles, axis=axis)).sum(axis=-1), 0, axis=axis)
        bends = np.abs(np.diff(near, 2, axis=axis)) / np.delete(near, [0, -1], axis=axis)
        told += float(np.log(BARE + step + np.minimum(bends, MOST_BENT)).mean()) / 2
    return math.exp(told)


def _pixels(sizes: NDArray[np.float64], z: NDArray[np.float64]) -> NDArray[np.float64]:
    """Sizes of splats at depths in the picture that a user sees. [px]"""
    return np.maximum(FOCAL / HEIGHT * SHOWN_HEIGHT * sizes / np.maximum(z, 1e-6), 1e-6)


def _standing(
    splats: Splats, random: np.random.Generator
) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Splats that stand for all: which, and the chance that each was kept with."""
    count = len(splats)
    if count <= KEPT:
        return np.arange(count), np.ones(count)
    scales = np.sort(splats.scales.astype(np.float64), axis=1)
    areas = scales[:, 1] * scales[:, 2] * splats.opacities
    share = KEPT / max(float(areas.sum()), 1e-300)
    for _ in range(20):  # until as many are kept, though no chance is above 1
        chances = np.minimum(1, share * areas)
        if chances.sum() > 0.98 * KEPT or not chances.sum() > 0:
            break
        share *= KEPT / chances.sum()
    chances = np.maximum(chances, 0.3 * KEPT / count)
    kept = np.flatnonzero(random.random(count) < chances)
    return kept, chances[kept]


def _outward(elevation: float, azimuth: float) -> NDArray[np.float64]:
    flat = math.cos(elevation)
    return np.array([flat * math.cos(azimuth), flat * math.sin(azimuth), math.sin(elevation)])


def _directions() -> list[NDArray[np.float64]]:
    return [
        _outward(math.radians(elevation), 2 * math.pi * turn / AZIMUTHS)
        for elevation in ELEVATIONS
        for turn in range(AZIMUTHS)
    ]


def _around(stage: _Stage) -> list[_Look]:
    """Cameras outside, as near as the scene fits their pictures."""
    looks = [_Look("around", outward, np.zeros(3)) for outward in _directions()]
    return [stage.fitted(look) for look in looks]


def _amid(stage: _Stage) -> list[_Look]:
    """Cameras among the splats, around their middle, as one walks around an object."""
    looks = [
        _Look("amid", ring * stage.core * outward, np.zeros(3))
        for ring in RINGS
        for outward in _directions()
    ]
    return [look for look in looks if stage.holds(look.eye) and stage.free(look.eye)]


def _within(stage: _Stage) -> list[_Look]:
    """Cameras at free places within, facing all around, as far back as there is room."""
    if stage.is_hollow:
        return []
    lines = np.linspace(0.1, 0.9, GRID)
    shares = np.stack(np.meshgrid(lines, lines, [0.4, 0.6], indexing="ij"), -1).reshape(-1, 3)
    places = stage.low + (stage.high - stage.low) * shares
    places = places[stage.free(places)]
    looks = []
    for turn in range(0, 360, 30):
        back = -BACK * _outward(0, math.radians(turn))
        lines_back = places[:, None] + np.arange(STEPS_BACK)[:, None] * back
        room = np.minimum.accumulate(stage.free(lines_back) & stage.holds(lines_back), axis=1)
        last = np.maximum(room.sum(axis=1) - 1, 0)
        for eye in lines_back[np.arange(len(places)), last]:
            for pitch in PITCHES:
                ahead = _outward(math.radians(pitch), math.radians(turn))
                looks.append(_Look("within", eye, eye + 0.7 * ahead))
    return looks


def _chosen(stage: _Stage, tried: Sequence[_Look], counts: Mapping[str, int]) -> list[_Look]:
    """The looks to draw: of each kind in turn the most promising, those from other places first."""
    ranks: list[tuple[int, _Look]] = []
    for kind, count in counts.items():
        from_there: Counter[bytes] = Counter()
        rounds: list[tuple[int, int, _Look]] = []
        looks = [look for look in tried if look.kind == kind]
        for look in sorted(looks, key=stage.promise, reverse=True):
            rounds.append((from_there[look.eye.tobytes()], len(rounds), look))
            from_there[look.eye.tobytes()] += 1
        rounds.sort(key=lambda entry: entry[:2])
        ranks += [(rank, look) for rank, (*_, look) in enumerate(rounds[:count])]
    return [look for _, look in sorted(ranks, key=lambda entry: entry[0])]


def _taken(stage: _Stage, cameras: Sequence[Camera]) -> list[_Look]:
    """The cameras that took the scene, or some of many."""
    step = -(-len(cameras) // DRAWN["taken"])
    return [stage.staged(camera, stage.core) for camera in cameras[::step]]
