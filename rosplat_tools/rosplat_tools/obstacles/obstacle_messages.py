"""Grids and points as messages."""

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


def points_message(
    header: Header, fields: tuple[str, ...], rows: NDArray[np.floating]
) -> PointCloud2:
    """A cloud of points, whose rows (n, m) are floats of m fields."""
    layout = np.dtype([(name, "f4") for name in fields])
    return cloud(header, np.ascontiguousarray(rows, np.float32).view(layout).ravel())
