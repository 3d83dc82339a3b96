"""Obstacles in a map: a grid that nav2 takes, voxels, a coloured surface with normals, distances.

Publishes, while somebody listens, `gaussians/occupancy` (nav_msgs/OccupancyGrid), and
`gaussians/voxels`, `gaussians/surface` and, at the middle of the band, `gaussians/distances`
(sensor_msgs/PointCloud2). The service `gaussians/measure` answers distances at points, `~/save`
writes the grid for map_server.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from nav_msgs.msg import OccupancyGrid
from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.publisher import Publisher
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header

from rosplat_core.distances import DistanceField
from rosplat_core.log_text import counted, shown
from rosplat_core.occupancy import (
    FREE,
    OCCUPIED,
    Grid,
    OccupancyMap,
    depth_of,
    grid_of,
    save_grid,
    towards,
    voxels_across,
)
from rosplat_core.program.output import told
from rosplat_core.quaternions import from_matrices
from rosplat_core.splats import InputError
from rosplat_msgs.srv import MeasureDistances, SaveMap
from rosplat_ros.diagnostics import Diagnostics, Report
from rosplat_ros.held_map import MapSubscriber
from rosplat_ros.messages import as_array, is_frame
from rosplat_ros.program.files_below import check_below
from rosplat_ros.program.parameters import declare, declare_path
from rosplat_ros.program.running import run_node
from rosplat_ros.program.said_once import SaidOnce
from rosplat_ros.qos import LATCHED, overridable
from rosplat_tools.cameras.pose_history import PoseError
from rosplat_tools.frames import Frames
from rosplat_tools.obstacles.obstacle_messages import grid_message, points_message

POLL = 0.2  # longest time between two looks at ROS and at TF [s]
STILL = 1e-3  # how far a frame may turn before the voxels are built anew [rad]
VOXEL = ("x", "y", "z")  # fields of clouds, as PCL names them
SURFACE = (*VOXEL, "normal_x", "normal_y", "normal_z", "rgb")
DISTANCE = (*VOXEL, "distance")
MOST_POINTS = 1 << 20  # that are measured at once
SHRUNK = 0.9  # a map of too many voxels is tried again with at most this share of its splats


class Occupancy(Node):
    """Publishes what of the map on `gaussians` stands in a robot's way.

    Callbacks hand batches over and save; publish() keeps the voxels equal to the map.
    """

    def __init__(self) -> None:
        super().__init__("occupancy")
        resolution: float = declare(
            self, "resolution", 0.05, "Edge of a voxel, and width of a cell. [m]", 0.005, 10.0
        )
        size: float = declare(
            self, "size", 100.0, "Edge of the mapped cube, around the frame's origin. [m]",
            0.1, 1e5,
        )  # fmt: skip
        threshold: float = declare(
            self, "threshold", 0.5, "Share of the light that an occupied voxel takes away.",
            0.01, 0.99,
        )  # fmt: skip
        self._band = _numbers(
            "band", declare(self, "band", [0.1, 1.8], "Least and greatest height of what a robot "
            "runs into. What is closer to height 0 than the least is floor. [m]"),
        )  # fmt: skip
        if not 0 < self._band[0] < self._band[1]:
            raise InputError(f"parameter band: expected 0 < least < most, got {list(self._band)}")
        self._start = _numbers(
            "start", declare(self, "start", [0.0, 0.0], "x and y of a place where the robot is "
            "or was. Free is what it reaches from there. [m]"),
        )  # fmt: skip
        self._frame: str = declare(
            self, "frame_id", "", "Frame of what is published, with z up; empty: the map's."
        )
        self._band_frame: str = declare(
            self, "band_frame", "", "Frame that the band's heights are measured from, a robot's "
            "base say; empty: that of what is published.",
        )  # fmt: skip
        self._period: float = declare(
            self, "period", 0.5, "Least time between two messages. [s]", 0.05, 60.0
        )
        self._save_root = declare_path(
            self, "save_root", "", "Folder below which ~/save may write; empty: nowhere."
        )
        self._resolution, self._light = resolution, threshold
        self._least_depth = depth_of(threshold)
        self._voxels = OccupancyMap(resolution, voxels_across(size, resolution))
        try:
            self._frames = Frames(self) if self._frame or self._band_frame else None
        except InputError as error:
            raise InputError(f"frames other than the map's need TF: {error}") from error
        self._map_in_grid: NDArray[np.float64] = np.eye(4)
        self._level = 0.0  # height of the band's 0 in the published frame [m]
        self._places = 0  # how often the voxels were placed
        self._splats_when_full = 0  # splats of a map of too many voxels, else 0
        warn = self.get_logger().warning
        self._problem, self._left_out = SaidOnce(warn), SaidOnce(warn)
        self._not_free = ""  # why no cell of the grid is free
        self._no_distances = ""  # why there are none
        self._field: tuple[object, DistanceField] | None = None  # of the map as it was then
        self._lock = threading.Lock()  # of the map and of what is made of it
        self._map = MapSubscriber(self, self._voxels, most_sh_degree=0)
        topic = self._map.topic  # remapping it remaps the others
        outputs: list[tuple[str, type, Callable[[Header], Any]]] = [
            ("occupancy", OccupancyGrid, self._grid_message),
            ("voxels", PointCloud2, self._voxels_message),
            ("surface", PointCloud2, self._surface_message),
            ("distances", PointCloud2, self._distances_message),
        ]
        self._outputs = [
            _Output(self.create_publisher(kind, f"{topic}/{name}", **overridable(LATCHED)), make)
            for name, kind, make in outputs
        ]
        self.create_service(MeasureDistances, f"{topic}/measure", self._on_measure)
        self.create_service(SaveMap, "~/save", self._on_save)
        self._report = self._reported()
        Diagnostics(self, topic, lambda: self._report)
        self.get_logger().info(
            f"waiting for a map on {topic}: voxels of {resolution:g} m within {size:g} m"
        )

    # --- What is published ------------------------------------------------------------------------

    def publish(self) -> None:
        """Publishes until ROS ends."""
        due = 0.0
        while self.context.ok():
            self._map.came.wait(min(POLL, max(due - time.monotonic(), 0.0)))
            self._map.came.clear()
            with self._lock:
                self._map.apply_waiting()
                if (now := time.monotonic()) >= due:
                    due = now + self._period
                    self._publish()
                    self._report = self._reported()

    def _publish(self) -> None:
        if problem := self._find_problem():
            self._problem.say(f"nothing is published: {problem}")
            return
        header = Header(
            stamp=self._map.header.stamp, frame_id=self._frame or self._map.header.frame_id
        )
        version = (self._map.edits, self._places, self._level)
        for output in self._outputs:
            output.update(header, version)
        if left_out := self._voxels.too_large + self._voxels.beyond:
            self._left_out.say(
                f"left out: {counted(self._voxels.beyond, 'splat', 'splats')} beyond `size`, "
                f"{left_out - self._voxels.beyond:,} that are hundreds of voxels wide"
            )
        self._problem.say(self._not_free or self._no_distances)

    def _find_problem(self) -> str:
        """Why the voxels don't show the whole map at its pose of now; empty if they do."""
        if problem := self._map.problem():
            return problem
        try:
            self._follow_frames()
        except PoseError as error:
            return str(error)
        if not self._make_fit():
            return (
                f"the map takes more than {self._voxels.most:,} voxels, choose a coarser "
                "`resolution` or a smaller `size`"
            )
        return ""

    def _make_fit(self) -> bool:
        """Tries a map that was too large again once many of its splats are gone, not after each
        edit: each try takes up to a minute. Returns whether the map's voxels fit.
        """
        splats = self._map.books.splats
        if self._voxels.full and splats <= SHRUNK * self._splats_when_full:
            self._place(self._map_in_grid)
            self._splats_when_full = splats
        if not self._voxels.full:
            self._splats_when_full = 0
        elif not self._splats_when_full:
            self._splats_when_full = splats
        return not self._voxels.full

    def _reported(self) -> Report:
        figures = {
            **self._map.figures(),
            "Splats left out": self._voxels.too_large + self._voxels.beyond,
            "Voxels": self._voxels.voxels,
            "Subscribers": sum(output.subscribers for output in self._outputs),
        }
        problem = self._problem.now
        return Report(problem or "obstacles are published", figures, warns=bool(problem))

    def _follow_frames(self) -> None:
        map_frame = self._map.header.frame_id
        frame = self._frame or map_frame
        here, level = np.eye(4), 0.0
        if self._frames and not is_frame(frame, map_frame):
            here = self._frames.pose(map_frame, frame)[1]
        if self._frames and not is_frame(self._band_frame, frame):
            level = float(self._frames.pose(self._band_frame, frame)[1][2, 3])
        moved = np.abs(here - self._map_in_grid)
        if moved[:3, :3].max() > STILL or moved[:3, 3].max() > self._resolution / 10:
            self._place(here)
        if abs(level - self._level) > self._resolution / 2:
            self._level = level

    def _place(self, map_in_grid: NDArray[np.float64]) -> None:
        position, rotation = map_in_grid[:3, 3], map_in_grid[:3, :3]
        self._voxels.place(position.tolist(), from_matrices(rotation).tolist())
        self._map_in_grid = map_in_grid
        self._places += 1

    def _grid(self) -> Grid:
        cells, _ = self._voxels.find(self._least_depth)
        grid = grid_of(cells, self._resolution, self._band, self._level, self._start)
        x, y = self._start
        low, high = self._level - self._band[0], self._level + self._band[0]
        self._not_free = (
            ""
            if (grid.cells == FREE).any()
            else f"no cell is free: at the start, ({x:g}, {y:g}), there is no floor at heights "
            f"{low:g} to {high:g} m"
        )
        return grid

    def _grid_message(self, header: Header) -> OccupancyGrid:
        return grid_message(header, self._grid(), self._level + self._band[0])  # above the floor

    def _voxels_message(self, header: Header) -> PointCloud2:
        cells, _ = self._voxels.find(self._least_depth)
        return points_message(header, VOXEL, (cells + 0.5) * self._resolution)

    def _surface_message(self, header: Header) -> PointCloud2:
        surface = self._voxels.surface(self._least_depth)
        positions = surface["positions"]
        normals = towards(positions, surface["normals"], np.array([*self._start, self._middle()]))
        r, g, b = np.rint(255 * surface["colors"]).astype(np.uint32).T
        rgb = (r << 16 | g << 8 | b).view(np.float32)
        return points_message(header, SURFACE, np.column_stack([positions, normals, rgb]))

    def _distances_message(self, header: Header) -> PointCloud2:
        height = self._middle()
        try:
            field = DistanceField.of_voxels(
                self._voxels, self._resolution, heights=(height, height), light=self._light
            )
        except InputError as error:
            self._no_distances = str(error)
            return points_message(header, DISTANCE, np.zeros((0, 4)))
        self._no_distances = ""
        return points_message(header, DISTANCE, np.column_stack(field.slice_at(height)))

    def _middle(self) -> float:
        """Height of the band's middle in the published frame. [m]"""
        return self._level + sum(self._band) / 2

    # --- What is measured -------------------------------------------------------------------------

    def _on_measure(
        self, request: MeasureDistances.Request, response: MeasureDistances.Response
    ) -> MeasureDistances.Response:
        with self._lock:
            self._map.apply_waiting()
            try:
                distances, gradients = self._measure(request)
            except Exception as error:  # no request may end the node
                response.message = shown(told(error), 500)
                return response
        response.distances, response.gradients = as_array("f", distances), as_array("f", gradients)
        response.success = True
        return response

    def _measure(
        self, request: MeasureDistances.Request
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Distances (n,) [m] and gradients (n, 3) at a request's points. Raises InputError."""
        points = _points(np.asarray(request.points))
        if problem := self._find_problem():
            raise InputError(problem)
        pose = self._pose_of(request.frame_id)
        points = points @ pose[:3, :3].T + pose[:3, 3]
        field = self._whole_field()
        distances, gradients = field.at(points)
        gradients = gradients @ pose[:3, :3]
        unknown = ~field.holds(points)
        distances[unknown], gradients[unknown] = np.nan, np.nan
        return distances.astype(np.float32), gradients.astype(np.float32)

    def _pose_of(self, frame: str) -> NDArray[np.float64]:
        """(4, 4) of a frame in that of what is published [m]. Raises InputError."""
        published = self._frame or self._map.header.frame_id
        if is_frame(frame, published):
            return np.eye(4)
        try:
            self._frames = self._frames or Frames(self)
            return self._frames.pose(frame, published)[1]
        except (InputError, PoseError) as error:
            raise InputError(f"points in '{shown(frame)}': {error}") from error

    def _whole_field(self) -> DistanceField:
        """The distances around all of the map as it is now. Raises InputError."""
        version = (self._map.edits, self._places)
        if self._field is None or self._field[0] != version:
            self._field = None  # of two, each takes up to 134 MB
            field = DistanceField.of_voxels(self._voxels, self._resolution, light=self._light)
            self._field = version, field
        return self._field[1]

    # --- What is written --------------------------------------------------------------------------

    def _on_save(self, request: SaveMap.Request, response: SaveMap.Response) -> SaveMap.Response:
        try:
            check_below("save_root", self._save_root, request.path)
            path = Path(request.path)
            for file in (path, path.with_suffix(".pgm")):
                if file.exists() and not request.overwrite:
                    raise InputError(f"{file}: exists already; set overwrite to replace it")
            with self._lock:
                self._map.apply_waiting()
                if problem := self._find_problem():
                    raise InputError(problem)
                grid, response.splats = self._grid(), self._voxels.splats
            path.parent.mkdir(exist_ok=True)
            save_grid(path, grid)
            rows, columns = grid.cells.shape
            occupied, free = ((grid.cells == value).sum() for value in (OCCUPIED, FREE))
            response.message = (
                f"{request.path}: {columns} x {rows} cells, {occupied:,} occupied, {free:,} free"
            )
            response.success = True
        except Exception as error:  # no request may end the node
            response.message = shown(told(error), 500)
        return response


class _Output:
    """A topic. Its message is made anew if it has subscribers and the map has changed."""

    def __init__(self, publisher: Publisher, make: Callable[[Header], Any]) -> None:
        self._publisher, self._make = publisher, make
        self._published: object = None

    @property
    def subscribers(self) -> int:
        """Number of subscribers."""
        return int(self._publisher.get_subscription_count())

    def update(self, header: Header, version: object) -> None:
        if version != self._published and self.subscribers:
            self._publisher.publish(self._make(header))
            self._published = version


def _points(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points (n, 3) of a request. Raises InputError."""
    if values.size % 3 or values.size > 3 * MOST_POINTS:
        raise InputError(
            f"points: expected x, y, z of each, of at most {MOST_POINTS:,}, got {values.size:,} "
            "numbers"
        )
    points = values.reshape(-1, 3)
    if not (finite := np.isfinite(points).all(axis=1)).all():
        raise InputError(f"points: number {int(finite.argmin())}, counted from 0, is not finite")
    return points


def _numbers(name: str, values: Any) -> tuple[float, float]:
    """A parameter of two numbers. Raises InputError."""
    if len(values) != 2 or not all(map(math.isfinite, values)):
        raise InputError(f"parameter {name}: expected two numbers, got {list(values)}")
    return values[0], values[1]


def main() -> None:
    run_node("occupancy", Occupancy, Occupancy.publish)
