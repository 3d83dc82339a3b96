"""From where to look at a scene first: a level camera whose picture shows much of it, sharply.

1. The scene is turned upright, its middle is moved to 0 and its radius made 1. Few splats stand for
   all: each is kept with a probability in proportion to its area, and grows to make up for those
   that are not, so pictures of them have the scene's coverage.
2. Cameras to try stand around the scene, at distances where it fits the picture, nearer ones
   around its middle, and within, at free places, facing all around. Where the cameras are known
   that took the scene, they alone are tried.
3. Those that have many resolved splats before them are drawn. A camera's picture is worth the share
   of the scene's splats that it shows: not hidden by others, and no smaller than a pixel. Trainers
   put splats where photographs have detail, so the share is that of the detail that is seen. Near
   splats that are blurred over much of the picture make it worth less.
4. A scene that surrounds its free places, such as a room, is shown from within: there, a picture's
   empty part makes it worth little, and depth more. Another one is shown whole, above all its top.
5. The best camera is moved about a little while that helps. One outside moves, without turning, to
   where the scene fits its picture and is in the middle of it; a narrower picture than that is
   taken from farther away.
"""

from __future__ import annotations

import logging
import math
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from rosplat_core import harmonics
from rosplat_core.cameras import Camera, load_cameras, look_at
from rosplat_core.payload import PACKED, decode
from rosplat_core.quaternions import from_matrices, product, to_matrices
from rosplat_core.rendering import Contributions, CpuRenderer, posed
from rosplat_core.splats import InputError, PackedSplats, Splats
from rosplat_core.upright import find_up

_log = logging.getLogger(__name__)

CAMERA_FILES = ("cameras.json", "transforms.json")
KEPT = 16_000  # splats that stand for a scene
READ = 300_000  # most splats that these are chosen from
POINTS = 1500  # splats by which cameras are chosen that are drawn
WIDTH, HEIGHT = 128, 72  # of pictures [px]
FOCAL = 0.5 * HEIGHT / math.tan(math.radians(22.5))  # as in rviz2: 45 degrees from top to bottom
SHOWN_HEIGHT = 720  # of the picture that a user sees [px]
ELEVATIONS = (8, 16, 26)  # of cameras around a scene [deg]
AZIMUTHS = 12
RINGS = (1.2, 2.0, 3.2)  # distances of nearer ones, in median distances of splats from the middle
GRID = 6  # free places are looked for on so many lines each way
CLEARANCE = 0.1  # from a free place to the nearest splats, in the scene's radii
DRAWN = {"around": 8, "near": 12, "within": 20, "taken": 40}  # how many cameras are drawn of each
BLURRED = 40  # standard deviation from which a near splat is blurred [px of SHOWN_HEIGHT]
SURROUNDED = 0.9  # least part of pictures from within that is covered, for the scene to surround it
NEARBY = 3  # distance within which a scene's extent is measured, in median ones
MARGIN = 0.9  # part of a picture that a whole object may fill
NARROWER = (0.5, 1.0, 1.5)  # widths of pictures, in their heights, that it is fitted to as well
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
            look_at(eye, self.target, self.up), near=1e-3 * distance, far=max(1e10, distance),
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
    none.
    """
    path = Path(scene)
    for folder in (path, *path.resolve().parents[:3]):
        for name in CAMERA_FILES:
            if (folder / name).is_file():
                try:
                    return load_cameras(folder / name)
                except InputError as error:
                    _log.warning("cameras are not taken: %s", error)
    return []


def first_view(
    splats: Splats, up: ArrayLike | None = None, cameras: Sequence[Camera] = ()
) -> FirstView:
    """The view of a scene to begin with.

    up (3,): its vertical; by default that of the splats, or else by their ground. cameras: that
    took the scene.
    """
    if up is None:
        up = splats.up or find_up(sample(splats), cameras)
    if not len(splats):
        return FirstView(np.zeros(3), np.array([1.0, 0, 0]), np.array([0, 0, 1.0]))
    stage, began = _Stage(sample(splats), np.asarray(up, np.float64)), time.monotonic()
    tried = _taken(stage, cameras) if cameras else _around(stage) + _near(stage) + _within(stage)
    seen = []
    for look in _chosen(stage, tried):
        seen.append((look, stage.seen(look)))
        if time.monotonic() > began + PATIENCE and len(seen) >= LEAST:
            break
    within = [found for look, found in seen if look.kind == "within"]
    surrounding = sum(found.surrounds for found in within) > len(within) / 2 > 0
    best, found = max(seen, key=lambda pair: pair[1].worth(surrounding))
    step = 1.0
    for _ in range(0 if cameras else STEPS):
        if time.monotonic() > began + PATIENCE:
            break
        moved = [(look, stage.seen(look)) for look in best.moved(step)]
        look, better = max(moved, key=lambda pair: pair[1].worth(surrounding))
        if better.worth(surrounding) > found.worth(surrounding):
            best, found = look, better
        else:
            step /= 2
    if cameras or found.within:
        return stage.placed(best)
    return stage.placed(*stage.fitted(best))


def views_within(splats: Splats, up: ArrayLike) -> list[FirstView]:
    """Views from free places that a scene surrounds, such as rooms; none of another scene.

    up (3,): the scene's vertical.
    """
    stage = _Stage(sample(splats), np.asarray(up, np.float64))
    looks = _within(stage)
    promising = _chosen(stage, looks)
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
        """The camera moved ahead and back, around its target, up and down, and turned."""
        away = self.eye - self.target
        looks = [replace(self, eye=self.target + away * factor) for factor in (0.8, 1.2)]
        flat = math.hypot(away[0], away[1])
        for angle in (-0.2 * step, 0.2 * step):
            turn = np.array(
                [[math.cos(angle), -math.sin(angle), 0], [math.sin(angle), math.cos(angle), 0],
                 [0, 0, 1]]
            )  # fmt: skip
            looks.append(replace(self, eye=self.target + turn @ away))
            looks.append(replace(self, target=self.eye - turn @ away))
            lift = np.array([0, 0, angle * flat])
            looks.append(replace(self, eye=self.eye + lift / 2))
            looks.append(replace(self, eye=self.eye + lift / 2, target=self.target + lift / 2))
        return looks


@dataclass(frozen=True)
class _Seen:
    """What a picture shows of the scene, 0 to 1; how much of the picture is covered and blurred.

    depth: mean of what is shown, in the scene's radii, 1 at most. cut: what falls outside the
    picture counts as so much. contrast: standard deviation of its colours.
    """

    shown: float
    covered: float
    blurred: float
    depth: float
    cut: float
    contrast: float
    within: bool
    """Whether the camera is among the splats."""

    @property
    def surrounds(self) -> bool:
        """Whether the scene fills the picture, and hardly with what is too near."""
        return self.covered > SURROUNDED and self.blurred < 0.2

    def worth(self, surrounding: bool) -> float:
        """surrounding: whether the scene does that."""
        sharp = self.shown * (1 - self.blurred) ** 2 * math.sqrt(self.contrast)
        if surrounding:
            return sharp * float(self.covered**20) * self.depth * self.within
        return sharp * self.covered * math.exp(-min(self.cut, 1.5))


class _Stage:
    """A scene upright, its middle at 0, its radius 1; and what stands for it in pictures."""

    def __init__(self, splats: Splats, up: NDArray[np.float64]) -> None:
        random = np.random.default_rng(0)
        self._origin = splats.origin
        self._up = up / np.linalg.norm(up)
        side = np.cross(self._up, np.eye(3)[np.abs(self._up).argmin()])
        side /= np.linalg.norm(side)
        self._rotation = np.array([side, np.cross(self._up, side), self._up])
        rows, chances = _standing(splats, random)
        positions = splats.positions[rows].astype(np.float64) @ self._rotation.T
        scales = np.maximum(splats.scales[rows].astype(np.float64), 0)
        self._weights = 1 / chances / np.sum(1 / chances)
        solid = splats.opacities[rows] > min(0.1, float(splats.opacities[rows].max()))
        solid |= ~solid.any()
        counted = random.choice(
            np.flatnonzero(solid), 20_000, p=self._weights[solid] / self._weights[solid].sum()
        )
        self._middle = np.median(positions[counted], axis=0)
        away = np.linalg.norm(positions[counted] - self._middle, axis=1)
        near = counted[away <= NEARBY * np.median(away)]  # without a sky, for example
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
        grown = scales / self._radius / np.sqrt(chances)[:, None]
        self._sizes = np.sort(scales, axis=1)[:, 1:].prod(axis=1) ** 0.5 / self._radius
        longest = scales.argmax(axis=1)
        axes = to_matrices(splats.orientations[rows])[np.arange(len(rows)), :, longest]
        self._spans = axes @ self._rotation.T * (scales.max(axis=1) / self._radius)[:, None]
        self._areas = 2 * math.pi * splats.opacities[rows] * np.sort(grown, axis=1)[:, 1:].prod(1)
        self._sampled = random.choice(len(rows), POINTS, p=self._weights)
        self.solid = self.positions[splats.opacities[rows] > 0.3]
        points = self.positions[self._sampled]
        self._probes = points.T.copy()
        # All of the scene but what lies far out.
        inside = ((points >= self._lowest) & (points <= self._highest)).all(axis=1)
        self.whole = points[inside]
        self._reach = self._sizes[self._sampled][inside]
        self._colours = (0.5 + harmonics.C0 * splats.sh[rows, 0].astype(np.float64)).clip(0, 1)
        self._renderer = CpuRenderer(
            Splats(
                positions=self.positions.astype(np.float32),
                orientations=product(
                    from_matrices(self._rotation), splats.orientations[rows]
                ).astype(np.float32),
                scales=grown.astype(np.float32),
                opacities=splats.opacities[rows],
                sh=np.zeros((len(rows), 1, 3), np.float32),
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
        view = look_at(look.eye, look.target)
        camera = Camera(0, WIDTH, HEIGHT, FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2, view)
        sums = Contributions()
        self._renderer.contribute(posed(camera), sums)
        filled = np.zeros(len(self.positions))
        filled[: len(sums.weight)] = sums.weight
        rays = self.positions - look.eye
        z = np.maximum(rays @ look.view[2], 1e-3)
        visible = np.minimum(1, filled / np.maximum(0.5 * self._areas * (FOCAL / z) ** 2, 1e-9))
        shown = visible * self._weights * np.minimum(1, _pixels(self._sizes, z))
        rays /= np.linalg.norm(rays, axis=1, keepdims=True) + 1e-12
        along = np.sum(self._spans * rays, axis=1, keepdims=True) * rays
        spans = np.linalg.norm(self._spans - along, axis=1)
        blurred = filled[(_pixels(spans, z) > BLURRED) & (z < 0.75 * self.core)].sum()
        pixels = WIDTH * HEIGHT
        return _Seen(
            float(shown.sum()),
            min(1.0, float(filled.sum()) / pixels),
            float(blurred) / pixels,
            float(filled @ np.minimum(z, 1)) / max(float(filled.sum()), 1e-9),
            self._cut(look),
            self._contrast(filled),
            bool(((look.eye > self._lowest) & (look.eye < self._highest)).all()),
        )

    def _contrast(self, filled: NDArray[np.float64]) -> float:
        """Standard deviation of a picture's colours, from 0.02."""
        weights = filled / max(float(filled.sum()), 1e-9)
        mean = weights @ self._colours
        return math.sqrt(max(float(np.sum(weights @ (self._colours - mean) ** 2)), 4e-4))

    def _cut(self, look: _Look) -> float:
        """What falls outside a picture, or to its margin: above it counts most, beside it least."""
        x, y, z = look.view @ (self.whole - look.eye).T
        z = MARGIN * np.maximum(z, 1e-6)
        above, below = -y * FOCAL > z * HEIGHT / 2, y * FOCAL > z * HEIGHT / 2
        beside = np.abs(x) * FOCAL > z * WIDTH / 2
        return float(100 * np.mean(above) + 10 * np.mean(below) + 2 * np.mean(beside))

    def fitted(self, look: _Look) -> tuple[_Look, float]:
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
        return replace(look, eye=eye, target=eye + distance * look.view[2]), width

    def placed(self, look: _Look, width: float = 0.0) -> FirstView:
        """A camera of the stage in the scene's own coordinates."""
        eye, target = (
            (point * self._radius + self._middle) @ self._rotation + self._origin
            for point in (look.eye, look.target)
        )
        return FirstView(eye, target, self._up, width)

    def staged(self, camera: Camera, distance: float) -> _Look:
        """A scene's camera on the stage, without its roll."""
        eye = (self._rotation @ (camera.position - self._origin) - self._middle) / self._radius
        return _Look("taken", eye, eye + distance * self._rotation @ camera.world_to_camera[2, :3])


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
    points = stage.whole
    middle = (points.min(axis=0) + points.max(axis=0)) / 2 if len(points) else np.zeros(3)
    points = points - middle
    looks = []
    for outward in _directions():
        x, y, z = look_at(outward, np.zeros(3))[:3, :3] @ points.T
        across = np.maximum(np.abs(x) * FOCAL / (0.42 * WIDTH), np.abs(y) * FOCAL / (0.44 * HEIGHT))
        distance = max(float(np.quantile(across - z, 0.99)), 0.1) if len(points) else 3.0
        looks.append(_Look("around", middle + distance * outward, middle))
    return looks


def _near(stage: _Stage) -> list[_Look]:
    """Cameras around the middle of the splats, as one walks around an object."""
    return [
        _Look("near", ring * stage.core * outward, np.zeros(3))
        for ring in RINGS
        for outward in _directions()
    ]


def _within(stage: _Stage) -> list[_Look]:
    """Cameras at free places within, facing all around."""
    if len(stage.solid) < 5:
        return []
    lines = np.linspace(0.1, 0.9, GRID)
    shares = np.stack(np.meshgrid(lines, lines, [0.4, 0.6], indexing="ij"), -1).reshape(-1, 3)
    places = stage.low + (stage.high - stage.low) * shares
    distances, _ = cKDTree(stage.solid).query(places, k=5)
    return [
        _Look("within", place, place + _outward(math.radians(pitch), math.radians(turn)) * 0.7)
        for place in places[distances[:, -1] > CLEARANCE]
        for turn in range(0, 360, 30)
        for pitch in (-6,)
    ]


def _chosen(stage: _Stage, tried: Sequence[_Look]) -> list[_Look]:
    """The looks to draw: of each kind in turn the most promising, those from other places first."""
    ranks: list[tuple[int, _Look]] = []
    for kind, count in DRAWN.items():
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
