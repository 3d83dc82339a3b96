"""Voxels, surfaces, distances and grids as messages."""

from __future__ import annotations

import numpy as np
from geometry_msgs.msg import Point, Pose
from nav_msgs.msg import MapMetaData, OccupancyGrid
from numpy.typing import NDArray
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header

from rosplat_core.occupancy import Grid
from rosplat_ros.messages import as_array
from rosplat_tools.clouds import cloud

_VOXEL = ("x", "y", "z")
_SURFACE = (*_VOXEL, "normal_x", "normal_y", "normal_z", "rgb")  # as PCL names them


def grid_message(header: Header, grid: Grid, z: float) -> OccupancyGrid:
    """A grid as nav2's static layer takes it, at the height z [m] that rviz2 draws it at."""
    height, width = grid.cells.shape
    x, y = grid.origin
    info = MapMetaData(
        map_load_time=header.stamp,
        resolution=grid.resolution,
        width=width,
        height=height,
        origin=Pose(position=Point(x=x, y=y, z=z)),
    )
    return OccupancyGrid(header=header, info=info, data=as_array("b", grid.cells))


def voxels_message(header: Header, cells: NDArray[np.int32], resolution: float) -> PointCloud2:
    """The middles of voxels (n, 3)."""
    return _cloud(header, _VOXEL, (cells + 0.5) * resolution)


def surface_message(
    header: Header,
    positions: NDArray[np.float32],
    normals: NDArray[np.float32],
    colors: NDArray[np.float32],
) -> PointCloud2:
    """Points (n, 3) [m] with normals and colours, 0 to 1."""
    r, g, b = np.rint(255 * colors).astype(np.uint32).T
    rgb = (r << 16 | g << 8 | b).view(np.float32)
    return _cloud(header, _SURFACE, np.column_stack([positions, normals, rgb]))


def distances_message(
    header: Header, points: NDArray[np.float64], distances: NDArray[np.float64]
) -> PointCloud2:
    """Points (n, 3) and distances (n,). [m]"""
    return _cloud(header, (*_VOXEL, "distance"), np.column_stack([points, distances]))


def _cloud(header: Header, names: tuple[str, ...], rows: NDArray[np.floating]) -> PointCloud2:
    layout = np.dtype([(name, "f4") for name in names])
    return cloud(header, np.ascontiguousarray(rows, np.float32).view(layout).ravel())
