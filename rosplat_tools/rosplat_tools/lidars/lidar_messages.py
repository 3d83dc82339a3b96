"""Scans as messages, and the parameters of a lidar."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node
from sensor_msgs.msg import LaserScan, PointCloud2
from std_msgs.msg import Header

from rosplat_core.splats import InputError
from rosplat_ros.messages import as_array
from rosplat_ros.program.parameters import declare
from rosplat_ros.qos import PICTURES, overridable
from rosplat_tools.clouds import cloud
from rosplat_tools.lidars.scanning import Lidar, Pattern, Scan

# As drivers of Velodyne and Ouster lay a point out.
_POINT = np.dtype(
    [
        *((name, "<f4") for name in ("x", "y", "z", "intensity")),
        ("ring", "<u2"),
        ("time", "<f4"),
    ]
)


def declare_lidar(node: Node, prefix: str = "") -> tuple[Lidar, float]:
    """Declares a lidar's parameters; returns it and how often it turns. [Hz]

    Raises InputError for parameters that make no sense.
    """

    def of(name: str, *rest: Any) -> Any:
        return declare(node, prefix + name, *rest)

    rings = of("rings", 16, "Rays above one another.", 1, 256)
    columns = of("columns", 1024, "Rays beside one another.", 1, 8192)
    lowest = of("lowest", -15.0, "Lowest ring. [deg]", -90.0, 90.0)
    highest = of("highest", 15.0, "Highest ring. [deg]", -90.0, 90.0)
    width = of(
        "width", 360.0, "Angle that columns span around x; less than 360: a solid-state lidar. "
        "[deg]", 1.0, 360.0,
    )  # fmt: skip
    nearest = of("nearest", 0.1, "Least range. [m]", 0.01, 1e3)
    farthest = of("farthest", 100.0, "Greatest range. [m]", 0.1, 1e4)
    rate = of("rate", 10.0, "Scans in a second. [Hz]", 0.1, 100.0)
    if lowest > highest or nearest >= farthest:
        raise InputError(
            f"parameters {prefix}lowest, highest, nearest, farthest: {lowest:g}, {highest:g}, "
            f"{nearest:g}, {farthest:g} are no ranges"
        )
    angles = [math.radians(angle) for angle in (lowest, highest, width)]
    return Lidar(Pattern.of(rings, columns, *angles), nearest, farthest), rate


class ScanTopics:
    """The topics of a lidar: `points` and `scan`."""

    def __init__(self, node: Node, lidar: Lidar, rate: float) -> None:
        """rate: scans in a second [Hz]."""
        self._lidar, self._period = lidar, 1 / rate
        self._points = node.create_publisher(PointCloud2, "points", **overridable(PICTURES))
        self._scan = node.create_publisher(LaserScan, "scan", **overridable(PICTURES))

    def heard(self) -> bool:
        """Whether somebody hears them."""
        return any(p.get_subscription_count() for p in (self._points, self._scan))

    def publish(self, header: Header, scan: Scan) -> None:
        """Publishes a scan of the lidar."""
        self._points.publish(self._cloud(header, scan))
        self._scan.publish(self._planar(header, scan))

    def _cloud(self, header: Header, scan: Scan) -> PointCloud2:
        """Points that answer, in the lidar's frame; what doesn't is left out.

        A point's time is since the header's stamp, which all columns were drawn at.
        """
        pattern, answers = self._lidar.pattern, np.isfinite(scan.ranges)
        columns, rings = len(pattern.azimuths), len(pattern.elevations)
        rows = np.empty(int(answers.sum()), _POINT)
        points = pattern.rays[answers] * scan.ranges[answers, None]
        rows["x"], rows["y"], rows["z"] = points.T
        rows["intensity"] = scan.intensities[answers]
        rows["ring"] = np.tile(np.arange(rings), columns)[answers]
        times = np.repeat(np.arange(columns) * (self._period / columns), rings)
        rows["time"] = times[answers]
        return cloud(header, rows)

    def _planar(self, header: Header, scan: Scan) -> LaserScan:
        """The ring that is nearest to the plane of x and y; inf: nothing answers."""
        pattern = self._lidar.pattern
        ring = int(np.abs(pattern.elevations).argmin())
        columns = len(pattern.azimuths)
        ranges: NDArray[np.float32] = scan.ranges.reshape(columns, -1)[:, ring]
        ranges = ranges * np.float32(np.cos(pattern.elevations[ring]))
        return LaserScan(
            header=header,
            angle_min=float(pattern.azimuths[0]),
            angle_max=float(pattern.azimuths[-1]),
            angle_increment=float(np.diff(pattern.azimuths[:2])[0]) if columns > 1 else 0.0,
            time_increment=self._period / columns,
            scan_time=self._period,
            range_min=self._lidar.limits[0],
            range_max=self._lidar.limits[1],
            ranges=as_array("f", ranges),
            intensities=as_array("f", scan.intensities.reshape(columns, -1)[:, ring].copy()),
        )
