"""The obstacles of a map for a robot: voxels, and a grid of cells seen from above.

A voxel is occupied where its splats take away enough of the light that crosses it. `OccupancyMap`
keeps the voxels while the map changes; voxel_map.hpp has the definition.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rosplat_core import _core
from rosplat_core.program.files import replacing
from rosplat_core.quaternions import from_matrices
from rosplat_core.rendering import insert_all
from rosplat_core.splats import InputError, Splats

OccupancyMap = _core.OccupancyMap

UNKNOWN, FREE, OCCUPIED = -1, 0, 100  # as nav_msgs/OccupancyGrid has them
MOST_ACROSS = 4096  # voxels along an axis
RESOLUTION = 0.05  # of voxels, where nothing else is asked for [m]
LIGHT = 0.5  # least share that an occupied voxel takes away, likewise
SIZE = 100.0  # of the cube around the origin that has voxels, likewise [m]
MOST_FILLED = 1 << 28  # voxels of the box around a map whose hollows are filled
START_REACH = 0.3  # most distance from the start to a free cell near it [m]

# map_server's grey values of these, and its thresholds: cells between the two are unknown.
_GREY = {UNKNOWN: 205, FREE: 254, OCCUPIED: 0}
_OCCUPIED_ABOVE, _FREE_BELOW = 0.65, 0.196


@dataclass(frozen=True, eq=False)
class Grid:
    """Cells seen from above."""

    cells: NDArray[np.int8]
    """(rows along y, columns along x) UNKNOWN, FREE or OCCUPIED."""
    origin: tuple[float, float]
    """x and y of the corner of cell (0, 0). [m]"""
    resolution: float
    """Width of a cell. [m]"""


def depth_of(absorbed: float) -> float:
    """The optical depth that takes away a share of the light, 0 to less than 1 (Beer-Lambert)."""
    return -math.log1p(-absorbed)


def voxels_across(size: float, resolution: float) -> int:
    """Voxels along each axis of a cube of a size [m], even.

    Raises InputError above MOST_ACROSS, and for a resolution that no voxel has.
    """
    if not 0 < resolution < math.inf:
        raise InputError(f"resolution is {resolution:g} m, expected more than 0")
    across = 2 * math.ceil(size / resolution / 2)
    if across > MOST_ACROSS:
        raise InputError(
            f"size {size:g} m at resolution {resolution:g} m: {across:,} voxels along an axis, at "
            f"most {MOST_ACROSS:,} are held"
        )
    return max(2, across)


def occupied_by(
    splats: Splats, pose: NDArray[np.float64], resolution: float = RESOLUTION
) -> OccupancyMap:
    """The voxels of a map, within SIZE. pose: (4, 4) of the map in their frame [m].

    Raises InputError for more voxels than are held.
    """
    voxels = OccupancyMap(resolution, voxels_across(SIZE, resolution))
    voxels.place(pose[:3, 3].tolist(), from_matrices(pose[:3, :3]).tolist())
    insert_all(voxels, splats)
    if voxels.full:
        raise InputError(f"more than {voxels.most:,} voxels: choose a coarser resolution")
    return voxels


def hollows(cells: NDArray[np.int64]) -> NDArray[np.int64]:
    """Voxels (m, 3) that occupied ones (n, 3) enclose on all sides. Raises InputError."""
    from scipy.ndimage import binary_fill_holes  # takes its time

    least = cells.min(axis=0)
    shape = cells.max(axis=0) - least + 1
    if shape.prod() > MOST_FILLED:
        raise InputError("the map is too wide to be filled: choose a coarser resolution")
    occupied = np.zeros(shape, bool)
    occupied[tuple((cells - least).T)] = True
    return np.asarray(np.argwhere(binary_fill_holes(occupied) & ~occupied) + least)


def grid_of(
    cells: NDArray[np.int32],
    resolution: float,
    band: tuple[float, float],
    level: float = 0.0,
    start: tuple[float, float] = (0.0, 0.0),
) -> Grid:
    """The grid of cells for a robot that stands on a level and is as high as a band over it.

    cells: occupied voxels (n, 3), z up. resolution: width of a voxel [m]. band: least and greatest
    height over the level [m]. level: height [m]. start: x and y where the robot is or was [m].

    Occupied: a voxel is occupied whose centre is in the band. Floor: not occupied, but a voxel is
    whose centre is less than the band's lower end above or below the level. Free: floor that the
    robot reaches from its start over floor, cell by cell across their sides. (The camera that saw
    the floor saw that nothing hides it.) All else is unknown. As floors have holes, the robot
    begins on the largest area of floor within START_REACH, or a cell; without one, nothing is free.
    The grid covers the occupied voxels of floor and band; without any it is one unknown cell.
    """
    from scipy.ndimage import label  # takes its time

    low, high = band
    height = (cells[:, 2] + 0.5) * resolution - level
    in_band = (height >= low) & (height < high)
    in_floor = (height >= -low) & (height < low)
    columns = cells[in_band | in_floor, :2].astype(np.int64)
    if not len(columns):
        corner = tuple((np.floor(np.divide(start, resolution)) * resolution).tolist())
        return Grid(np.full((1, 1), UNKNOWN, np.int8), corner, resolution)
    least, most = columns.min(axis=0), columns.max(axis=0)
    shape = tuple((most - least + 1)[::-1].tolist())
    obstacle, floor = np.zeros(shape, bool), np.zeros(shape, bool)
    for mask, chosen in ((obstacle, in_band), (floor, in_floor)):
        x, y = (cells[chosen, :2] - least).T
        mask[y, x] = True
    grid = np.full(shape, UNKNOWN, np.int8)
    areas, _ = label(floor & ~obstacle)
    y, x = np.nonzero(areas)
    middles = (np.column_stack([x, y]) + least + 0.5) * resolution
    reach = max(START_REACH, resolution)
    near = areas[y, x][np.hypot(*(middles - start).T) <= reach]
    if len(near):
        sizes = np.bincount(areas.ravel())
        grid[areas == near[sizes[near].argmax()]] = FREE
    grid[obstacle] = OCCUPIED
    return Grid(grid, tuple((least * resolution).tolist()), resolution)


def towards(
    positions: NDArray[np.float32], normals: NDArray[np.float32], viewpoint: NDArray[np.float64]
) -> NDArray[np.float32]:
    """Normals (n, 3) of points (n, 3), turned so that they face a viewpoint (3,)."""
    away = ((viewpoint - positions) * normals).sum(axis=1) < 0
    return np.where(away[:, None], -normals, normals).astype(np.float32)


def save_grid(path: Path, grid: Grid) -> None:
    """Writes a grid as map_server reads it: path, which ends in .yaml, and a .pgm beside it.

    Raises InputError for another ending, OSError where a file can't be written.
    """
    if path.suffix != ".yaml":
        raise InputError(f"{path}: expected a name that ends in .yaml")
    picture = path.with_suffix(".pgm")
    height, width = grid.cells.shape
    grey = np.full(grid.cells.shape, _GREY[UNKNOWN], np.uint8)
    for value, shade in _GREY.items():
        grey[grid.cells == value] = shade
    x, y = grid.origin
    text = (
        f"image: {json.dumps(picture.name, ensure_ascii=False)}\n"
        f"mode: trinary\nresolution: {grid.resolution:.9g}\n"
        f"origin: [{x:.9g}, {y:.9g}, 0]\nnegate: 0\noccupied_thresh: {_OCCUPIED_ABOVE}\n"
        f"free_thresh: {_FREE_BELOW}\n"
    )
    # Neither is replaced before both are written. The first row is the farthest along y.
    with replacing(picture) as pixels, replacing(path) as described:
        pixels.write_bytes(b"P5\n%d %d\n255\n" % (width, height) + grey[::-1].tobytes())
        described.write_text(text, encoding="utf-8")
