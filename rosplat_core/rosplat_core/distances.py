"""How far points are from a map's surfaces, and which way leads away from them.

How it works.
1. Occupied voxels (voxel_map.hpp) each know the mean place and normal of the surface within them.
2. Each voxel around them gets the nearest occupied one, by an exact Euclidean distance transform
   (Maurer et al. 2003, SciPy's), and from its own centre the distance to that one's surface: to its
   plane, as far as that reaches within the voxel.
3. Hollows that are closed on all sides count as inside, if asked for: distances there are below 0.
4. Between the voxels' centres, distances are interpolated along x, y and z. The gradient is that of
   the interpolation.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rosplat_core.formats.bounds import naming_the_file
from rosplat_core.occupancy import LIGHT, RESOLUTION, OccupancyMap, depth_of, hollows, occupied_by
from rosplat_core.program.files import replacing
from rosplat_core.rigid import rigid
from rosplat_core.splats import InputError, Splats

MARGIN = 1.0  # around the occupied voxels, within which distances are known [m]
MOST_VOXELS = 1 << 25  # in a field: 1.5 GB as it is made

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class DistanceField:
    """Distances at the centres of voxels, in a frame whose axes they lie along."""

    distances: NDArray[np.float32]
    """(x, y, z) [m], below 0 inside of what is filled."""
    origin: Array
    """(3,) centre of voxel (0, 0, 0) [m]."""
    resolution: float
    """Edge of a voxel [m]."""
    map_pose: Array = field(default_factory=lambda: np.eye(4))
    """(4, 4) of the map in the field's frame [m]."""

    @classmethod
    def of(
        cls,
        splats: Splats,
        pose: ArrayLike | None = None,
        *,
        resolution: float = RESOLUTION,
        margin: float = MARGIN,
        filled: bool = False,
    ) -> DistanceField:
        """The field of a map. pose: (4, 4) of the map in the field's frame [m].

        margin: width of the part around the surfaces that has distances [m]. filled: closed hollows
        are inside. Raises InputError for a map without surfaces, or too large for the resolution,
        and for a resolution or a margin that makes no sense.
        """
        pose = rigid(np.eye(4) if pose is None else pose, "pose")
        voxels = occupied_by(splats, pose, resolution)
        return replace(cls.of_voxels(voxels, resolution, margin, filled=filled), map_pose=pose)

    @classmethod
    def of_voxels(
        cls,
        voxels: OccupancyMap,
        resolution: float,
        margin: float = MARGIN,
        *,
        heights: tuple[float, float] | None = None,
        light: float = LIGHT,
        filled: bool = False,
    ) -> DistanceField:
        """As of(), of voxels of that resolution.

        heights: between which z distances are wanted [m]. light: least share of the light that an
        occupied voxel takes away.
        """
        if not 0 <= margin < np.inf:
            raise InputError(f"margin is {margin:g} m, expected 0 or more")
        surface = voxels.surface(depth_of(light))
        cells = surface["cells"].astype(np.int64)
        points, normals = (surface[name].astype(np.float64) for name in ("positions", "normals"))
        if heights:
            low, high = heights
            near = (points[:, 2] >= low - margin) & (points[:, 2] <= high + margin)
            cells, points, normals = cells[near], points[near], normals[near]
        if not len(cells):
            raise InputError("the map has no surface that distances could be measured to")
        rim = int(np.ceil(margin / resolution))
        least, most = cells.min(axis=0) - rim, cells.max(axis=0) + rim
        shape = most - least + 1
        if shape.prod() > MOST_VOXELS:
            raise InputError(
                f"distances of {shape.prod():,} voxels, at most {MOST_VOXELS:,} are held: choose "
                f"a coarser resolution than {resolution:g} m"
            )
        origin = (least + 0.5) * resolution
        inside = hollows(cells) if filled else cells[:0]
        distances = _measured(
            tuple(shape), cells - least, (points - origin) / resolution, normals, inside - least
        )
        return cls((distances * resolution).astype(np.float32), origin, resolution)

    def holds(self, points: Array) -> NDArray[np.bool_]:
        """Whether points (n, 3) [m] are within the field, where distances are known."""
        last = np.array(self.distances.shape) - 1
        place = (points - self.origin) / self.resolution
        return np.asarray(((place >= 0) & (place <= last)).all(axis=1))

    def at(self, points: ArrayLike) -> tuple[Array, Array]:
        """Distances (n,) [m] of points (n, 3) [m] and their gradients (n, 3), away from surfaces.

        Beyond the field, a point has the distance and gradient of the nearest place in it, and the
        way there on top. Raises ValueError for points that are not finite or not (n, 3).
        """
        points = np.asarray(points, np.float64)
        if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
            raise ValueError(f"points: expected finite (n, 3), got {points.shape}")
        last = np.array(self.distances.shape) - 1
        place = (points - self.origin) / self.resolution
        within = place.clip(0, last)
        base = np.minimum(within.astype(np.int64), np.maximum(last - 1, 0))
        share = within - base
        values = np.zeros(len(points))
        gradients = np.zeros((len(points), 3))
        for corner in np.ndindex(2, 2, 2):
            index = np.minimum(base + corner, last)
            value = self.distances[tuple(index.T)].astype(np.float64)
            weights = np.where(corner, share, 1 - share)
            values += value * weights.prod(axis=1)
            for axis in range(3):
                others = np.delete(weights, axis, axis=1).prod(axis=1)
                gradients[:, axis] += value * others * (1 if corner[axis] else -1)
        beyond = np.linalg.norm(place - within, axis=1)
        return values + beyond * self.resolution, gradients / self.resolution

    def slice_at(self, height: float) -> tuple[Array, Array]:
        """Points (n, 3) at a height, one above each column of voxels, and their distances. [m]"""
        x, y, _ = (np.arange(n) * self.resolution for n in self.distances.shape)
        points = np.stack(np.meshgrid(x, y, [0.0], indexing="ij"), axis=-1).reshape(-1, 3)
        points += [self.origin[0], self.origin[1], height]
        return points, self.at(points)[0]

    def save(self, path: str | Path) -> None:
        """Writes a NumPy file (.npz) of the attributes by their names. Raises InputError."""
        with (
            naming_the_file(Path(path)),
            replacing(Path(path)) as part,
            part.open("wb") as file,
        ):
            np.savez_compressed(
                file,
                distances=self.distances,
                origin=self.origin,
                resolution=np.float64(self.resolution),
                map_pose=self.map_pose,
            )


def _measured(
    shape: tuple[int, ...], cells: NDArray[np.int64], points: Array, normals: Array,
    inside: NDArray[np.int64],
) -> Array:  # fmt: skip
    """Distances by voxel, in voxels. points: of the cells' surfaces, from the centre of voxel 0."""
    from scipy import ndimage  # takes its time

    number = np.full(shape, -1, np.int32)
    number[tuple(cells.T)] = np.arange(len(cells))
    nearest = ndimage.distance_transform_edt(
        number < 0, return_distances=False, return_indices=True
    )
    of = number[tuple(nearest)]
    along = np.zeros(shape)
    square = np.zeros(shape)
    for axis, centres in enumerate(np.indices(shape, sparse=True)):
        away = centres - points[of, axis]
        along += away * normals[of, axis]
        square += away**2
    aside = np.sqrt(np.maximum(square - along**2, 0))
    distances = np.hypot(along, np.maximum(aside - np.sqrt(0.5), 0))
    if len(inside):
        filled = np.zeros(shape, bool)
        filled[tuple(inside.T)] = True
        # A voxel of the surface is inside where its centre lies on the side of what is filled.
        inner = ndimage.uniform_filter(filled.astype(np.float32), 3, mode="constant")
        slopes = np.stack([s[tuple(cells.T)] for s in np.gradient(inner)], axis=-1)
        inward = np.sign((slopes * normals).sum(axis=1)) * along[tuple(cells.T)] > 0
        filled[tuple(cells[inward].T)] = True
        distances = np.where(filled, -distances, distances)
    return np.asarray(distances)
