"""A flat of furnished rooms without a ceiling: from within one, walls hide most of the others.

Nine rooms of 4 x 4 m under hanging lamps, whose light and shadows are in the splats' colours; the
furniture is up to the seed. z is up, units are metres, the middle of the floor is the origin.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rosplat_core.generated.surfaces import (
    GOLDEN,
    Array,
    Noise,
    Numbers,
    Part,
    Patch,
    constant,
    highlight,
    surface,
    unit,
)

ROOMS = 3  # along x, and along y
SIZE = 4.0  # of a room, from the middle of a wall to that of the opposite one
WALL, WALL_HEIGHT = 0.14, 2.5
DOOR_WIDTH, DOOR_HEIGHT = 0.9, 2.05
DOOR_ASIDE = -1.2  # from the middle of walls along y: only their doors lie in a row
LAMP, LAMP_HEIGHT = 0.16, 2.2
LAMPLIGHT = np.array([1.0, 0.9, 0.74])
DAYLIGHT = np.array([0.36, 0.4, 0.46])  # from above and everywhere


@dataclass(frozen=True)
class _Material:
    """How a surface looks."""

    color: tuple[float, float, float]
    pattern: Callable[[Array, Noise], Array] = lambda points, noise: 0.06 * noise.at(points)
    """By how much the colour is lighter (n,) at points (n, 3)."""
    gloss: float = 0.05
    density: float = 1.0
    """Factor on the splats per area."""


def _planks(points: Array, noise: Noise) -> Array:
    row = np.floor(points[:, 1] / 0.16)
    column = np.floor((points[:, 0] + 0.37 * row) / 1.1)
    gap = (np.abs(points[:, 1] / 0.16 - row - 0.5) > 0.47).astype(float)
    tone = np.sin(12.9 * row + 78.2 * column)
    grain = noise.at(points * [0.6, 6.0, 6.0])
    return 0.12 * tone + 0.12 * grain - 0.45 * gap


def _wood(points: Array, noise: Noise) -> Array:
    return 0.22 * noise.at(points * [4.0, 0.7, 4.0])


def _wallpaper(points: Array, noise: Noise) -> Array:
    stripes = np.sign(np.sin(2 * np.pi * (points[:, 0] + points[:, 1]) / 0.25))
    return 0.035 * stripes * (points[:, 2] > 0.9) - 0.18 * (points[:, 2] < 0.09)


def _checks(points: Array, noise: Noise) -> Array:
    shade: Array = 0.3 * np.sign(np.sin(points[:, 0] * 21) * np.sin(points[:, 1] * 21))
    return shade


def _weave(points: Array, noise: Noise) -> Array:
    x, y, z = (points * 2 * np.pi / 0.018).T
    shade: Array = 0.1 * np.sin(x) * np.sin(y) * np.cos(z) + 0.1 * noise.at(points * 2)
    return shade


FLOOR = _Material((0.58, 0.40, 0.25), _planks, 0.22)
WALLS = _Material((0.84, 0.80, 0.72), _wallpaper)
WOOD = _Material((0.46, 0.29, 0.17), _wood, 0.14, 1.5)
WHITE = _Material((0.82, 0.82, 0.80), gloss=0.2, density=1.2)
CLOTHS = tuple(
    _Material(color, _weave, 0.02, 1.5)
    for color in ((0.20, 0.34, 0.42), (0.56, 0.22, 0.16), (0.38, 0.42, 0.24), (0.66, 0.52, 0.30))
)
RUGS = tuple(
    _Material(color, _checks, 0.01, 1.5) for color in ((0.42, 0.12, 0.12), (0.16, 0.2, 0.36))
)
BOOKS = tuple(
    _Material(color, density=2.0)
    for color in ((0.5, 0.12, 0.1), (0.12, 0.24, 0.4), (0.7, 0.6, 0.4), (0.14, 0.32, 0.2))
)


@dataclass(frozen=True)
class _Box:
    low: tuple[float, float, float]
    high: tuple[float, float, float]
    material: _Material


class Rooms:
    """Each method of parts() makes one thing: its splats of the given numbers, out of a total."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng
        self._noise = Noise(rng)
        self._walls = rng.uniform(-0.13, 0.1, (ROOMS**2, 3))  # by which each room's colour differs
        walls = list(_walls())
        furniture = [
            [_moved(box, room) for box in FURNITURE[kind](rng)]
            for room, kind in enumerate(rng.permutation(np.arange(ROOMS**2) % len(FURNITURE)))
        ]
        self._in_room = [  # by room, the boxes (k, 2, 3) that may cast shadows of its lamp
            np.array([(box.low, box.high) for box in boxes]) for boxes in furniture
        ]
        self._boxes = [_floor(), *walls, *(box for boxes in furniture for box in boxes)]
        self._faces = _Faces.of(self._boxes)

    def parts(self) -> list[Part]:
        """Each thing's share of the splats, and the method that makes it."""
        return [(0.98, self.boxes), (0.02, self.lamps)]

    def sides(self) -> tuple[Array, Array]:
        """Least and greatest corners (n, 3) of all rectangles that splats lie on. [m]"""
        faces = self._faces
        return faces.corners, faces.corners + faces.first + faces.second

    def corners(self) -> Array:
        """(n, 2, 3) least and greatest corners of all boxes: floor, walls and furniture. [m]"""
        return np.array([(box.low, box.high) for box in self._boxes])

    def lamp_centres(self) -> Array:
        """(rooms, 3) centres of the globes of radius LAMP. [m]"""
        return np.column_stack([_middles(), np.full(ROOMS**2, LAMP_HEIGHT)])

    def boxes(self, numbers: Numbers, total: int) -> Patch:
        """Floor, walls and furniture: the sides of boxes, as dense as the material asks."""
        faces = self._faces
        ends = np.round(np.cumsum(faces.weights / faces.weights.sum()) * total).astype(int)
        face = np.searchsorted(ends, numbers, side="right")
        counts = np.diff(ends, prepend=0)
        number = numbers - (ends - counts)[face]
        # A lattice for any number of points (Roberts 2018): steps of the plastic ratio's powers.
        u, v = (0.5 + number[:, None] * [0.7548776662466927, 0.5698402909980532]).T % 1
        points = faces.corners[face] + (u * faces.first[face].T + v * faces.second[face].T).T
        normals, tangents = faces.normals[face], unit(faces.first[face])
        materials = [box.material for box in self._boxes]
        albedo, gloss = np.empty_like(points), np.empty(len(points))
        box = faces.box[face]
        by_box = np.argsort(box, kind="stable")
        for chosen in np.split(by_box, np.flatnonzero(np.diff(box[by_box])) + 1):
            material = materials[box[chosen[0]]]
            shade = material.pattern(points[chosen], self._noise)
            albedo[chosen] = material.color * (1 + shade[:, None])
            gloss[chosen] = material.gloss
            if material is WALLS:
                albedo[chosen] += self._walls[_room(points[chosen] + 0.2 * normals[chosen])]
        spacing = np.sqrt(faces.areas[face] / counts[face])
        return surface(
            points, tangents, normals, spacing, self._lit(points, normals, albedo, gloss), 1.2
        )

    def lamps(self, numbers: Numbers, total: int) -> Patch:
        """A globe in the middle of each room."""
        room = numbers % ROOMS**2
        number, each = numbers // ROOMS**2, -(-total // ROOMS**2)
        z = 1 - 2 * (number + 0.5) / each
        angle = 2 * np.pi * GOLDEN * number
        ring = np.sqrt(1 - z**2)
        normals = np.column_stack([ring * np.cos(angle), ring * np.sin(angle), z])
        points = self.lamp_centres()[room] + LAMP * normals
        along = unit(np.column_stack([-np.sin(angle), np.cos(angle), 0 * z]))
        color = np.clip(1.05 - 0.25 * np.abs(z), 0, 1)[:, None] * LAMPLIGHT
        spacing = LAMP * np.sqrt(4 * np.pi / each)
        return surface(points, along, normals, spacing, constant(color), 1.0)

    def _lit(self, points: Array, normals: Array, albedo: Array, gloss: Array) -> Array:
        """(n, 16, 3) harmonics of surfaces under the lamps and a little light from above."""
        room = _room(points + 0.1 * normals)
        lamps = np.column_stack([_middles()[room], np.full(len(room), LAMP_HEIGHT)])
        # Light comes from anywhere on the lamp, so that shadows have soft edges.
        away = lamps + LAMP * self._rng.normal(size=lamps.shape) / 2 - points
        distance = np.linalg.norm(away, axis=1)
        light = away / distance[:, None]
        seen = np.ones(len(room))
        for number, boxes in enumerate(self._in_room):
            here = room == number
            seen[here] = ~_hidden(points[here] + 2e-3 * normals[here], away[here], boxes)
        lamp = seen * np.clip((normals * light).sum(axis=1), 0, 1) * 2.6 / (1 + distance**2 / 2)
        corner = np.abs(points[:, :2] - lamps[:, :2]).max(axis=1) - SIZE / 2 + WALL / 2
        above = (0.7 + 0.3 * normals[:, 2]) * (1 - 0.35 * np.exp(np.minimum(corner, 0) / 0.2))
        color = albedo * (lamp[:, None] * LAMPLIGHT + above[:, None] * DAYLIGHT)
        shine = (gloss * seen)[:, None] * LAMPLIGHT
        return constant(color) + highlight(normals, light, shine, 9.0)


@dataclass(frozen=True)
class _Faces:
    """The sides of boxes, except those that lie on the ground, (n, ...) each."""

    corners: Array
    first: Array
    """The first edge from the corner; second: the other one. [m]"""
    second: Array
    normals: Array
    box: NDArray[np.intp]
    areas: Array
    weights: Array

    @classmethod
    def of(cls, boxes: list[_Box]) -> _Faces:
        rows = []
        for index, box in enumerate(boxes):
            low, size = np.array(box.low), np.subtract(box.high, box.low)
            for axis in range(3):
                first, second = np.diag(size)[(axis + 1) % 3], np.diag(size)[(axis + 2) % 3]
                area = float(np.linalg.norm(first) * np.linalg.norm(second))
                for side in (0, 1):
                    normal = np.eye(3)[axis] * (2 * side - 1)
                    if normal[2] < 0 and box.low[2] <= 0:
                        continue
                    corner = low + side * np.diag(size)[axis]
                    weight = area * box.material.density
                    rows.append((corner, first, second, normal, index, area, weight))
        return cls(*map(np.array, zip(*rows, strict=True)))


def middle(column: int, row: int) -> tuple[float, float]:
    """x and y of a room's middle; columns go along x, rows along y, from 0. [m]"""
    return SIZE * (column - (ROOMS - 1) / 2), SIZE * (row - (ROOMS - 1) / 2)


def _middles() -> Array:
    """(rooms, 2) x and y, row by row."""
    return np.array([middle(column, row) for row in range(ROOMS) for column in range(ROOMS)])


def _room(points: Array) -> NDArray[np.intp]:
    """(n,) the room that points (n, 3) lie in; outside, the nearest."""
    cells = np.clip(np.floor(points[:, :2] / SIZE + ROOMS / 2), 0, ROOMS - 1).astype(np.intp)
    return cells[:, 0] + ROOMS * cells[:, 1]


def _hidden(points: Array, away: Array, boxes: Array) -> NDArray[np.bool_]:
    """(n,) whether one of boxes (k, 2, 3) stands between points (n, 3) and points + away."""
    hidden = np.zeros(len(points), bool)
    # NumPy takes a hundred times as long for extremes of rows of three.
    points, inverse = (
        np.ascontiguousarray(each.T) for each in (points, 1 / np.where(away == 0, 1e-12, away))
    )
    for low, high in boxes[..., None]:
        to_low, to_high = (low - points) * inverse, (high - points) * inverse
        enter = np.minimum(to_low, to_high).max(axis=0)
        leave = np.maximum(to_low, to_high).min(axis=0)
        hidden |= (enter < leave) & (leave > 0) & (enter < 1)
    return hidden


def _floor() -> _Box:
    half = ROOMS * SIZE / 2 + WALL / 2
    return _Box((-half, -half, -0.1), (half, half, 0.0), FLOOR)


def _walls() -> list[_Box]:
    """The walls between all rooms and around them, with a door to each neighbour."""
    half = ROOMS * SIZE / 2
    boxes = []
    for along in (0, 1):
        for line in range(ROOMS + 1):
            for cell in range(ROOMS):
                start = SIZE * cell - half
                end = start + SIZE
                door = (start + end) / 2 + (DOOR_ASIDE if along else (-0.45, 0.0, 0.45)[line % 3])
                pieces = [(start - WALL / 2, end + WALL / 2, 0.0)]
                if 0 < line < ROOMS:
                    left, right = door - DOOR_WIDTH / 2, door + DOOR_WIDTH / 2
                    pieces = [
                        (start - WALL / 2, left, 0.0),
                        (right, end + WALL / 2, 0.0),
                        (left, right, DOOR_HEIGHT),
                    ]
                across = SIZE * line - half
                for low, high, bottom in pieces:
                    ends = [(low, across - WALL / 2), (high, across + WALL / 2)]
                    (x0, y0), (x1, y1) = ends if along == 0 else [(y, x) for x, y in ends]
                    boxes.append(_Box((x0, y0, bottom), (x1, y1, WALL_HEIGHT), WALLS))
    return boxes


def _moved(box: _Box, room: int) -> _Box:
    x, y = _middles()[room]
    low, high = np.add(box.low, (x, y, 0)), np.add(box.high, (x, y, 0))
    return _Box(tuple(low.tolist()), tuple(high.tolist()), box.material)


# --- Furniture: boxes around a room's middle, at the walls and clear of the doors -----------------


def _table(x: float, y: float, width: float, depth: float, height: float) -> list[_Box]:
    legs = [
        _Box((a, b, 0.0), (a + 0.06, b + 0.06, height - 0.04), WOOD)
        for a in (x, x + width - 0.06)
        for b in (y, y + depth - 0.06)
    ]
    top = _Box(
        (x - 0.03, y - 0.03, height - 0.04), (x + width + 0.03, y + depth + 0.03, height), WOOD
    )
    return [*legs, top]


def _chair(x: float, y: float, back: float) -> list[_Box]:
    """back: where the chair's back is along y, 0 or 0.4. [m]"""
    rest = _Box((x, y + back, 0.45), (x + 0.44, y + back + 0.04, 0.95), WOOD)
    return [*_table(x, y, 0.44, 0.44, 0.45), rest]


def _shelf(rng: np.random.Generator, x: float, y: float) -> list[_Box]:
    """A book case of 1.2 m along the wall at y."""
    sides = [_Box((x + at, y - 0.3, 0), (x + at + 0.03, y, 2.0), WOOD) for at in (0.0, 1.17)]
    back = [_Box((x, y - 0.02, 0), (x + 1.2, y, 2.0), WOOD)]
    boards = [
        _Box((x, y - 0.3, z), (x + 1.2, y, z + 0.03), WOOD)
        for z in (0.04, 0.45, 0.85, 1.25, 1.65, 1.97)
    ]
    books = []
    for z in (0.07, 0.48, 0.88, 1.28):
        at = x + 0.04
        while at < x + rng.uniform(0.7, 1.12):
            thick, tall = rng.uniform(0.02, 0.06), rng.uniform(0.2, 0.33)
            material = BOOKS[rng.integers(len(BOOKS))]
            books.append(_Box((at, y - 0.25, z), (at + thick, y - 0.04, z + tall), material))
            at += thick + 0.004
    return [*sides, *back, *boards, *books]


def _living_room(rng: np.random.Generator) -> list[_Box]:
    cloth = CLOTHS[rng.integers(len(CLOTHS))]
    seat = [
        _Box((-1.85, 0.0, 0.08), (-0.95, 1.8, 0.42), cloth),
        _Box((-1.85, 0.0, 0.42), (-1.62, 1.8, 0.85), cloth),
        _Box((-1.85, -0.18, 0.08), (-0.95, 0.0, 0.6), cloth),
        _Box((-1.85, 1.8, 0.08), (-0.95, 1.9, 0.6), cloth),
    ]
    rug = _Box((-0.8, 0.0, 0.0), (0.7, 1.7, 0.012), RUGS[rng.integers(len(RUGS))])
    return [*seat, rug, *_table(-0.4, 0.5, 0.6, 0.9, 0.42), *_shelf(rng, 0.65, 1.9)]


def _bedroom(rng: np.random.Generator) -> list[_Box]:
    cloth = CLOTHS[rng.integers(len(CLOTHS))]
    return [
        _Box((-1.88, -0.05, 0.0), (-1.8, 1.6, 1.0), WOOD),
        _Box((-1.8, 0.0, 0.12), (0.15, 1.55, 0.34), WOOD),
        _Box((-1.78, 0.02, 0.34), (0.12, 1.53, 0.52), WHITE),
        _Box((-1.2, -0.02, 0.3), (0.16, 1.57, 0.56), cloth),
        _Box((-1.75, 0.15, 0.52), (-1.32, 0.7, 0.62), WHITE),
        _Box((-1.75, 0.85, 0.52), (-1.32, 1.4, 0.62), WHITE),
        _Box((0.8, 1.3, 0.0), (1.9, 1.9, 2.05), WOOD),
        _Box((1.348, 1.296, 0.05), (1.352, 1.3, 2.0), WHITE),
        *_table(-1.85, 1.62, 0.4, 0.28, 0.5),
    ]


def _kitchen(rng: np.random.Generator) -> list[_Box]:
    doors = [
        _Box((1.26, y + 0.02, 0.12), (1.3, y + 0.48, 0.84), CLOTHS[3])
        for y in (-0.2, 0.3, 0.8, 1.3)
    ]
    counter = [
        _Box((1.3, -0.2, 0.0), (1.9, 1.8, 0.86), WHITE),
        _Box((1.25, -0.22, 0.86), (1.9, 1.82, 0.9), WOOD),
        _Box((1.55, -0.2, 1.45), (1.9, 1.8, 2.1), WHITE),
        _Box((1.45, 0.4, 0.9), (1.75, 0.75, 1.1), BOOKS[1]),
    ]
    chairs = [*_chair(-1.35, -0.35, 0.0), *_chair(-0.75, -0.35, 0.0), *_chair(-1.35, 1.2, 0.4),
              *_chair(-0.75, 1.2, 0.4)]  # fmt: skip
    return [*doors, *counter, *_table(-1.5, 0.15, 1.4, 0.95, 0.75), *chairs]


def _study(rng: np.random.Generator) -> list[_Box]:
    screen = [
        _Box((0.75, 1.55, 1.0), (1.45, 1.59, 1.4), BOOKS[1]),
        _Box((1.05, 1.56, 0.75), (1.15, 1.62, 1.0), WHITE),
    ]
    desk = _table(0.5, 1.1, 1.3, 0.7, 0.75)
    rug = _Box((-1.7, -0.2, 0.0), (-0.2, 1.2, 0.012), RUGS[rng.integers(len(RUGS))])
    return [*desk, *screen, *_chair(0.9, 0.6, 0.0), *_shelf(rng, -1.9, 1.9), rug]


FURNITURE = (_living_room, _bedroom, _kitchen, _study)
