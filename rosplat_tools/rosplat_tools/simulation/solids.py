"""A map's surfaces as boxes that bodies of a simulator run into.

How it works.
1. The occupied voxels of the map (voxel_map.hpp): those whose splats take half of the light.
2. Voxels become boxes: neighbours along one axis join to runs, equal runs beside each other along
   the next to plates, equal plates along the last to boxes. Of all orders of axes, the one counts
   that leaves the fewest boxes. No voxel is lost and none is in two boxes.
3. A box's side that mostly faces empty voxels moves to where the splats' surface is in its voxels,
   on the mean, and SKIN beyond. Sides between boxes stay, so that there are no gaps.

What splats don't show is not solid, unless closed hollows are filled. docs/experiments.md has what
boxes were measured against.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rosplat_core.log_text import shown
from rosplat_core.occupancy import LIGHT, RESOLUTION, depth_of, hollows, occupied_by
from rosplat_core.program.files import write_text
from rosplat_core.quaternions import from_matrices
from rosplat_core.splats import InputError, Splats
from rosplat_tools.simulation.physics import load_mujoco

SKIN = 0.2  # by which a box reaches beyond its surface: thin ones stop fast bodies [voxels]
ROOM = 0.25, 0.4  # radius and height of the room that a robot needs [m]
HIGHEST = 0.5  # ground that a robot may stand on, above the map's own [m]
KERB = 0.03  # of ground that counts as level [m]
FAR, STEP = 5.0, 0.1  # how far from a wished place another is tried, and how densely [m]
MOST_BOXES = 200_000  # beyond which a step takes long, and compiling minutes
BODY = "map_solids"
DENSITY = 300.0  # of objects, which are mostly hollow [kg/m3]
_CONTACT = {  # MuJoCo's defaults, whatever those of the robot's file are
    "contype": 1, "conaffinity": 1, "condim": 3, "friction": (1.0, 0.005, 0.0001),
    "margin": 0.0, "gap": 0.0, "priority": 0, "solmix": 1.0,
    "solref": (0.02, 1.0), "solimp": (0.9, 0.95, 0.001, 0.5, 2.0),
}  # fmt: skip
GROUP = 3  # of geometries that collide, and that no camera shows, as MuJoCo has it

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Boxes:
    """Boxes (n, 3) with sides along the axes. [m]"""

    low: Array
    high: Array

    def __len__(self) -> int:
        """How many there are."""
        return len(self.low)


def solids(
    splats: Splats, pose: Array, resolution: float = RESOLUTION, *, filled: bool = False
) -> Boxes:
    """The solid parts of a map, in the frame that `pose` (4, 4) [m] is in, with z up.

    resolution: edge of a voxel [m]. filled: what surfaces enclose on all sides is solid, too.
    Raises InputError for more than this takes.
    """
    voxels = occupied_by(splats, pose, resolution)
    surface = voxels.surface(depth_of(LIGHT))
    cells, positions = surface["cells"].astype(np.int64), surface["positions"].astype(np.float64)
    if filled and len(cells):
        inside = hollows(cells)
        cells = np.concatenate([cells, inside])
        positions = np.concatenate([positions, (inside + 0.5) * resolution])
    boxes = _fitted(cells, positions / resolution, *_fewest(cells))
    if len(boxes) > MOST_BOXES:
        raise InputError(f"{len(boxes):,} boxes: choose a coarser resolution than {resolution:g} m")
    return Boxes(boxes.low * resolution, boxes.high * resolution)


_Joined = tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.intp]]


def _fewest(cells: NDArray[np.int64]) -> _Joined:
    joined = (_joined(cells, axes) for axes in permutations(range(3)))
    return min(joined, key=lambda boxes: len(boxes[0]))


def _joined(cells: NDArray[np.int64], axes: tuple[int, ...]) -> _Joined:
    """Boxes of voxels (n, 3): corners (k, 3), the first inside and the first beyond, and (n,) which
    box a voxel is in."""
    low, high, of = cells, cells + 1, np.arange(len(cells))
    for axis in axes:
        others = [i for i in range(3) if i != axis]
        keys = np.column_stack([low[:, others], high[:, others]])
        order = np.lexsort((low[:, axis], *keys.T))
        low, high, keys = low[order], high[order], keys[order]
        follows = np.zeros(len(low), bool)
        follows[1:] = (keys[1:] == keys[:-1]).all(axis=1) & (low[1:, axis] == high[:-1, axis])
        number = np.empty(len(low), np.intp)
        number[order] = np.cumsum(~follows) - 1
        of = number[of]
        first = np.flatnonzero(~follows)
        last = np.append(first[1:], len(low))[: len(first)] - 1
        low, high = low[first], high[last]
    return low, high, of


def _fitted(
    cells: NDArray[np.int64],
    positions: Array,
    low: NDArray[np.int64],
    high: NDArray[np.int64],
    of: NDArray[np.intp],
) -> Boxes:
    """Boxes of _joined(), their open sides at the surface. positions (n, 3), result: in voxels."""
    fitted = {-1: low.astype(np.float64), 1: high.astype(np.float64)}
    keys = np.sort(_key(cells))
    for axis in range(3):
        for side, ends in ((-1, low[:, axis]), (1, high[:, axis] - 1)):
            rim = np.flatnonzero(cells[:, axis] == ends[of])
            beyond = cells[rim]
            beyond[:, axis] += side
            wanted = _key(beyond)
            found = keys[np.searchsorted(keys, wanted).clip(max=len(keys) - 1)] == wanted
            counts = np.bincount(of[rim], minlength=len(low))
            covered = np.bincount(of[rim], found, minlength=len(low))
            means = np.bincount(of[rim], positions[rim, axis], minlength=len(low)) / counts
            is_open = covered < counts / 2
            fitted[side][is_open, axis] = means[is_open] + side * SKIN
    return Boxes(fitted[-1], fitted[1])


def _key(cells: NDArray[np.int64]) -> NDArray[np.int64]:
    """One number for each voxel (n, 3)."""
    across = 1 << 20
    x, y, z = cells.T + across // 2
    return np.asarray((z * across + y) * across + x)


def free_place(boxes: Boxes, wished: tuple[float, float]) -> tuple[float, float, float] | None:
    """x, y and height of the ground where a robot has room, as near to a place as there is one. [m]

    None where there is none within FAR. Ground is a box that is not above HIGHEST, with nothing
    else around it over the height of ROOM.
    """
    steps = np.arange(-FAR, FAR + STEP / 2, STEP)
    offsets = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    distances = np.hypot(*offsets.T)
    for index in np.argsort(distances, kind="stable"):
        if distances[index] > FAR:
            return None
        x, y = (wished + offsets[index]).tolist()
        nearest = np.clip((x, y), boxes.low[:, :2], boxes.high[:, :2])
        near = np.hypot(*(nearest - (x, y)).T) <= ROOM[0]
        low, high = boxes.low[near, 2], boxes.high[near, 2]
        for ground in np.sort(high[high <= HIGHEST])[::-1]:
            if not ((low < ground + ROOM[1]) & (high > ground + KERB)).any():
                return x, y, float(ground)
    return None


def check_name(spec: Any, name: str) -> None:
    """Raises InputError for an object named like a body of a MuJoCo spec."""
    if name == BODY or spec.body(name) is not None:
        raise InputError(f"object {shown(name)}: the robot has a body of this name")


def add_solids(spec: Any, boxes: Boxes, pose: Array) -> None:
    """Adds boxes to a MuJoCo spec, in a body without a joint; pose (4, 4): of their frame [m]."""
    _add_boxes(spec.worldbody.add_body(name=BODY, pos=pose[:3, 3], quat=_quaternion(pose)), boxes)


def add_object(spec: Any, name: str, boxes: Boxes, pose: Array) -> Array:
    """Adds boxes to a MuJoCo spec as a body that moves freely, its frame in their middle.

    pose: (4, 4) of the boxes' frame [m]. Returns the body's pose (4, 4), where it begins. Raises
    InputError for the name of a body that there is.
    """
    check_name(spec, name)
    middle = np.eye(4)
    middle[:3, 3] = (boxes.low.min(axis=0) + boxes.high.max(axis=0)) / 2
    begins = pose @ middle
    place = np.concatenate([begins[:3, 3], _quaternion(begins)])
    body = spec.worldbody.add_body(name=name, pos=place[:3], quat=place[3:])
    body.add_freejoint()
    moved = Boxes(boxes.low - middle[:3, 3], boxes.high - middle[:3, 3])
    _add_boxes(body, moved, density=DENSITY)
    for key in spec.keys:
        if len(key.qpos):
            key.qpos = np.concatenate([key.qpos, place])
    return begins


def _add_boxes(body: Any, boxes: Boxes, **further: float) -> None:
    kind = load_mujoco().mjtGeom.mjGEOM_BOX
    for centre, half in zip(*_centred(boxes), strict=True):
        body.add_geom(type=kind, pos=centre, size=half, group=GROUP, **_CONTACT, **further)


def save_solids(path: str | Path, boxes: Boxes, pose: Array, scene: str) -> None:
    """Writes boxes as MJCF, to be included or attached, or simulated as it is.

    pose: (4, 4) of the scene's own coordinates among them [m], which a site named map has. Raises
    InputError.
    """
    lines = [
        '<mujoco model="map">',
        f"  <!-- Solid parts of {_comment(scene)}: z is up, lengths are in metres. -->",
        "  <default>",
        f'    <default class="{BODY}"><geom type="box" group="{GROUP}" contype="1" '
        'conaffinity="1" condim="3"/></default>',
        "  </default>",
        "  <worldbody>",
        f'    <body name="{BODY}" childclass="{BODY}">',
        f'      <site name="map" group="{GROUP}" pos="{_numbers(pose[:3, 3])}" '
        f'quat="{_numbers(_quaternion(pose))}"/>',
    ]
    for centre, half in zip(*_centred(boxes), strict=True):
        lines.append(f'      <geom pos="{_numbers(centre)}" size="{_numbers(half)}"/>')
    lines += ["    </body>", "  </worldbody>", "</mujoco>", ""]
    try:
        write_text(Path(path), "\n".join(lines))
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}") from error


def _quaternion(pose: Array) -> Array:
    """w, x, y, z, as MuJoCo has them."""
    return np.roll(from_matrices(pose[:3, :3]), 1)


def _centred(boxes: Boxes) -> tuple[Array, Array]:
    return (boxes.low + boxes.high) / 2, (boxes.high - boxes.low) / 2


def _numbers(values: Array) -> str:
    return " ".join(f"{value:.6g}" for value in values)


def _comment(text: str) -> str:
    """What may stand in a comment of XML."""
    return text.replace("--", "- -").replace("\n", " ")
