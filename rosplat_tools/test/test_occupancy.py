"""The node that publishes obstacles: across processes, what it hears, its parameters, its end."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from nav_msgs.msg import OccupancyGrid
from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import PointCloud2

from rosplat_core.generated.rooms import DOOR_ASIDE, DOOR_WIDTH, ROOMS, SIZE, WALL
from rosplat_core.maps import Arrival
from rosplat_core.occupancy import OccupancyMap, grid_of
from rosplat_core.splats import Splats
from rosplat_msgs.msg import GaussianArray
from rosplat_msgs.srv import MeasureDistances, PullMap, SaveMap
from rosplat_ros.held_map import HeldMap
from rosplat_ros.map_publisher import MapPublisher
from rosplat_ros.program.running import spinning
from rosplat_ros.program.said_once import Throttled
from rosplat_ros.qos import MAP
from rosplat_testing import PATIENCE
from rosplat_testing.studio import Log, transform
from rosplat_tools.cameras.pose_history import PoseError
from rosplat_tools.obstacles import occupancy

Start = Callable[..., subprocess.Popen[str]]
COUNT = 60_000
ROOM = f"rooms:{COUNT}:1"
RESOLUTION = 0.1
START = "[-1.2,-1.2]"
# As nav2's static layer subscribes.
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Heard:
    """The last message of a topic in the node's namespace."""

    def __init__(self, node: Node, kind: type, name: str) -> None:
        self.message: Any = None
        self.count = 0
        node.create_subscription(kind, name, self._take, LATCHED)

    def _take(self, message: Any) -> None:
        self.message, self.count = message, self.count + 1

    def cells(self) -> NDArray[np.int8]:
        info = self.message.info
        return np.array(self.message.data, np.int8).reshape(info.height, info.width)

    def at(self, x: float, y: float) -> int:
        """The value of the cell at a place, -1 beyond the grid."""
        info = self.message.info
        column = int(np.floor((x - info.origin.position.x) / info.resolution))
        row = int(np.floor((y - info.origin.position.y) / info.resolution))
        inside = 0 <= row < info.height and 0 <= column < info.width
        return int(self.cells()[row, column]) if inside else -1


class Said:
    """What the node says of itself on /diagnostics."""

    def __init__(self, node: Node) -> None:
        self.message, self.values = "", dict[str, str]()
        self.levels: list[bytes] = []  # each that differs from the one before
        self._name = f"{node.get_namespace()}/occupancy: {node.get_namespace()}/gaussians"
        node.create_subscription(DiagnosticArray, "/diagnostics", self._take, 10)

    def _take(self, array: DiagnosticArray) -> None:
        for status in array.status:
            if status.name == self._name.lstrip("/"):
                self.message = status.message
                self.values = {value.key: value.value for value in status.values}
                if self.levels[-1:] != [status.level]:
                    self.levels.append(status.level)


def rows(cloud: PointCloud2) -> NDArray[np.float32]:
    return np.frombuffer(cloud.data, np.float32).reshape(cloud.width, cloud.point_step // 4)


def ended(process: subprocess.Popen[str]) -> str:
    process.send_signal(signal.SIGINT)
    output, _ = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0
    assert "Traceback" not in output
    return output


def test_walls_are_where_they_are(start: Start, node: Node, listener: Any, tmp_path: Path) -> None:
    """A publisher, the node and who listens are three processes."""
    grid = Heard(node, OccupancyGrid, "gaussians/occupancy")
    obstacles = start(
        "occupancy", resolution=RESOLUTION, start=START, save_root=tmp_path, period=0.1
    )
    publisher = start("ply_publisher", path=ROOM, frame_id="flat")
    listener.wait(lambda: grid.message and (grid.cells() == 0).any())
    message = grid.message
    assert message.header.frame_id == "flat"
    assert message.info.resolution == pytest.approx(RESOLUTION)
    assert message.info.origin.position.z == 0.1  # over the floor, where rviz2 shows it
    # Outer walls all along, and what is between them where the robot is.
    half = ROOMS * SIZE / 2
    along = np.arange(-half + 0.5, half - 0.4, 0.5)
    for side in (-half + WALL / 2, half - WALL / 2):  # their inner faces
        found = [max(grid.at(side + d, y) for d in (-0.05, 0.05)) for y in along]
        assert np.mean(np.array(found) == 100) > 0.95
        found = [max(grid.at(x, side + d) for d in (-0.05, 0.05)) for x in along]
        assert np.mean(np.array(found) == 100) > 0.95
    for x in (-4.0, -2.0, 0.0, 2.0, 4.0):  # across three rooms and through the doors in between
        assert grid.at(x, DOOR_ASIDE) == 0
    assert grid.at(half + 1, 0) == -1
    assert ((grid.cells() == 0).sum() + (grid.cells() == 100).sum()) * RESOLUTION**2 > 100  # [m2]

    voxels = Heard(node, PointCloud2, "gaussians/voxels")
    surface = Heard(node, PointCloud2, "gaussians/surface")
    distances = Heard(node, PointCloud2, "gaussians/distances")
    listener.wait(lambda: voxels.message and surface.message and distances.message)
    middles = rows(voxels.message)
    np.testing.assert_allclose(middles / RESOLUTION % 1, 0.5, atol=1e-2)
    assert len(middles) == surface.message.width
    names = [field.name for field in surface.message.fields]
    assert names == ["x", "y", "z", "normal_x", "normal_y", "normal_z", "rgb"]
    points = rows(surface.message)
    assert np.abs(points[:, :3] - middles).max() <= RESOLUTION / 2 + 1e-4
    floor = np.abs(points[:, 2]) < 0.01
    assert floor.sum() > 5000
    assert (points[floor, 5] > 0.8).mean() > 0.9  # up, towards the robot
    names = [field.name for field in distances.message.fields]
    assert names == ["x", "y", "z", "distance"]
    x, y, z, distance = rows(distances.message).T
    np.testing.assert_allclose(z, 0.95)  # the middle of the band
    to_wall = half - WALL / 2 - np.maximum(np.abs(x), np.abs(y))
    near = (to_wall > 0) & (to_wall < 1)
    assert (distance[near] < to_wall[near] + RESOLUTION).mean() > 0.99
    assert distance[np.hypot(x, y - DOOR_ASIDE).argmin()] > DOOR_WIDTH / 2

    answer = listener.call(SaveMap, "occupancy/save", path=str(tmp_path / "flat.yaml"))
    assert answer.success, answer.message
    assert f"{message.info.width} x {message.info.height} cells" in answer.message
    assert (tmp_path / "flat.pgm").stat().st_size > message.info.width * message.info.height
    answer = listener.call(SaveMap, "occupancy/save", path=str(tmp_path / "new" / "flat.yaml"))
    assert answer.success, answer.message  # a new folder
    for path, why in (
        (tmp_path / "flat.yaml", "exists already"),
        (tmp_path / "other.png", "ends in .yaml"),
        (tmp_path / "no" / "ne" / "flat.yaml", f"{tmp_path}/no/ne: No such file"),
        (tmp_path.parent / "flat.yaml", "save_root"),
    ):
        answer = listener.call(SaveMap, "occupancy/save", path=str(path))
        assert not answer.success
        assert why in answer.message
        assert "Errno" not in answer.message
    ended(publisher)
    ended(obstacles)


def wall(x: float, height: float = 1.0) -> Splats:
    """A square metre across x over the floor."""
    y, z = (axis.ravel() for axis in np.mgrid[-0.5:0.5:0.05, 0.0:height:0.05])
    return plane(np.column_stack([np.full(y.size, x), y, z]), axis=0)


def floor() -> Splats:
    x, y = (axis.ravel() for axis in np.mgrid[-2:2:0.05, -2:2:0.05])
    return plane(np.column_stack([x, y, np.full(x.size, 0.01)]), axis=2)


def plane(positions: NDArray[np.float64], axis: int) -> Splats:
    count = len(positions)
    scales = np.full((count, 3), 0.03)
    scales[:, axis] = 0.002
    return Splats(
        positions=positions + 0.003,
        orientations=np.tile([0.0, 0, 0, 1], (count, 1)),
        scales=scales,
        opacities=np.full(count, 0.9),
        sh=np.zeros((count, 1, 3)),
    )


def test_a_planner_measures_distances_and_which_way_is_clear(
    start: Start, node: Node, listener: Any
) -> None:
    """Above a floor and beside a wall, as they are now; what is wrong is named."""
    process = start("occupancy", resolution=RESOLUTION, size=20.0)

    def measured(points: Any, frame_id: str = "") -> Any:
        numbers = np.ravel(points).astype(float).tolist()
        return listener.call(
            MeasureDistances, "gaussians/measure", points=numbers, frame_id=frame_id
        )

    answer = measured([[0, 0, 1]])
    assert (answer.success, list(answer.distances)) == (False, [])
    assert "no map has come yet" in answer.message
    publisher = MapPublisher(node, frame_id="flat")
    publisher.replace(floor())
    points = [[0.0, 0.0, 0.5], [0.8, 0.0, 0.5], [0.0, 0.0, 9.0], [-40.0, 0.0, 0.0]]
    listener.wait(lambda: measured(points).success)
    answer = measured(points, "flat")
    assert answer.message == ""
    assert list(answer.distances[:2]) == pytest.approx([0.49, 0.49], abs=0.01)
    gradients = np.reshape(answer.gradients, (-1, 3))
    np.testing.assert_allclose(gradients[:2], [[0, 0, 1]] * 2, atol=0.05)
    assert np.isnan(answer.distances[2:]).all() and np.isnan(gradients[2:]).all()  # unknown

    walls = 1024 * 8
    publisher.upsert(range(walls, walls + len(wall(1.05))), wall(1.05))
    listener.wait(lambda: measured(points).distances[1] == pytest.approx(0.25, abs=0.01))
    towards_wall = np.reshape(measured(points).gradients, (-1, 3))[1]
    np.testing.assert_allclose(towards_wall, [-1, 0, 0], atol=0.05)

    many = np.zeros(3 * (occupancy.MOST_POINTS + 1))
    for wrong, why in (
        ([0, 0], "points: expected x, y, z of each"),
        (many, "of at most 1,048,576, got 3,145,731 numbers"),
        ([[0, 0, 0], [0, np.inf, 0]], "points: number 1, counted from 0, is not finite"),
    ):
        answer = measured(wrong)
        assert (answer.success, list(answer.distances)) == (False, [])
        assert why in answer.message
    answer = measured(points, "nowhere")
    assert not answer.success and answer.message.startswith("points in 'nowhere': ")
    assert measured([]).success
    publisher.replace(floor()[:0])
    listener.wait(lambda: "no surface" in measured(points).message)
    ended(process)


def test_points_may_be_in_any_frame_that_tf_knows(
    monkeypatch: pytest.MonkeyPatch, node: Node, listener: Any
) -> None:
    base = np.array([[0.0, -1, 0, 0.8], [1, 0, 0, 0], [0, 0, 1, 0.2], [0, 0, 0, 1]])

    class Frames:
        def __init__(self, _: Node) -> None:
            pass

        def pose(self, frame: str, within: str) -> tuple[int, NDArray[np.float64]]:
            if frame != "base":
                raise PoseError(f"no {frame}")
            assert within == "map"
            return 0, base

    monkeypatch.setattr(occupancy, "Frames", Frames)
    publisher = MapPublisher(node)
    with running(node, "resolution:=0.1"):
        publisher.replace(wall(1.05))
        call = partial(listener.call, MeasureDistances, "gaussians/measure")
        asked = {"frame_id": "base", "points": [0.1, 0.0, 0.3]}
        listener.wait(lambda: call(**asked).success)
        answer = call(**asked)
        assert answer.distances[0] == pytest.approx(0.25, abs=0.01)
        np.testing.assert_allclose(answer.gradients, [0, 1, 0], atol=0.05)
        answer = call(frame_id="odom", points=[0.0, 0.0, 0.0])
        assert answer.message == "points in 'odom': no odom"


def test_edits_are_in_the_next_grid(start: Start, node: Node, listener: Any) -> None:
    """Written, moved, emptied and cleared; and nothing is published while nothing changes."""
    grid = Heard(node, OccupancyGrid, "gaussians/occupancy")
    process = start("occupancy", resolution=RESOLUTION, size=20.0, period=0.05)
    publisher = MapPublisher(node)
    publisher.replace(floor())
    listener.wait(lambda: grid.message and grid.at(1.05, 0) == 0)
    walls, door = 1024 * 8, 1024 * 16
    publisher.upsert(range(walls, walls + len(wall(1.05))), wall(1.05), group=1)
    listener.wait(lambda: grid.at(1.05, 0) == 100)
    assert grid.at(-1.05, 0) == 0
    publisher.move({1: np.array([[1.0, 0, 0, -2], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])})
    listener.wait(lambda: grid.at(-0.95, 0) == 100)
    assert grid.at(1.05, 0) == 0
    publisher.upsert(range(door, door + len(wall(0.55))), wall(0.55))
    listener.wait(lambda: grid.at(0.55, 0) == 100)
    publisher.delete(range(door, door + len(wall(0.55))))
    listener.wait(lambda: grid.at(0.55, 0) == 0)
    count = grid.count
    for _ in range(10):
        listener.wait(lambda: True)
        listener._executor.spin_once(0.1)
    assert grid.count == count
    publisher.replace(floor()[:0])
    listener.wait(lambda: grid.cells().tolist() == [[-1]])
    until = time.monotonic() + 1  # the log follows the grid
    listener.wait(lambda: time.monotonic() > until)
    assert "no cell is free: at the start, (0, 0)" in ended(process)


def test_what_is_incomplete_is_not_published_and_recovers(
    start: Start, node: Node, listener: Any
) -> None:
    """A publisher without pulls loses a batch; another batch contradicts itself."""
    grid = Heard(node, OccupancyGrid, "gaussians/occupancy")
    process = start("occupancy", resolution=RESOLUTION, size=20.0, period=0.05)
    raw = node.create_publisher(GaussianArray, "gaussians", MAP)

    def batch(revision: int, operation: int, splats: Splats, first: int) -> GaussianArray:
        return GaussianArray(
            map_id="m", revision=revision, operation=operation, first_slot=first,
            count=len(splats), positions=splats.positions.ravel().tolist(),
            orientations=splats.orientations.ravel().tolist(),
            scales=splats.scales.ravel().tolist(), opacities=splats.opacities.tolist(),
            sh=splats.sh.ravel().tolist(),
        )  # fmt: skip

    raw.publish(batch(1, GaussianArray.REPLACE, floor(), 0))
    listener.wait(lambda: grid.message and grid.at(0, 0) == 0)
    count = grid.count
    broken = batch(2, GaussianArray.UPSERT, wall(1.05), 8192)
    broken.count = 7
    raw.publish(broken)
    raw.publish(batch(4, GaussianArray.UPSERT, wall(1.05), 8192))
    while True:  # until the node has said so
        assert process.stdout
        line = process.stdout.readline()
        assert line
        if "batches are missing" in line:
            break
    assert grid.count == count
    raw.publish(batch(5, GaussianArray.REPLACE, wall(1.05), 0))
    listener.wait(lambda: grid.at(1.05, 0) == 100)
    ended(process)


@pytest.mark.parametrize(
    ("missed", "told"), [(1, "1 batch is missing"), (2, "2 batches are missing")]
)
def test_a_map_says_how_many_batches_it_lacks(missed: int, told: str) -> None:
    books = SimpleNamespace(missed=missed, pulled=False, splats=1)
    held = HeldMap(books, "gaussians", Throttled(None))
    held.edits = 1
    assert held.problem() == f"gaussians: the map isn't complete: 1 splat, {told}"


def test_the_end_of_a_pull_is_no_end_of_a_map_that_still_comes() -> None:
    books = SimpleNamespace(
        missed=0, pulled=False, splats=1, complete=False,
        apply=lambda batch, arrival: {"missed": 0, "dropped": 0},
    )  # fmt: skip
    held = HeldMap(books, "gaussians", Throttled(None))
    held.add(GaussianArray(operation=GaussianArray.REPLACE), Arrival.LAST)
    held.apply_waiting()
    assert held.problem() == "gaussians: the map isn't complete: 1 splat, more is to come"


@contextmanager
def running(node: Node, *parameters: str) -> Iterator[None]:
    """Runs the node that is tested in this process, in the namespace of `node`."""
    words = [word for parameter in parameters for word in ("-p", parameter)]
    rclpy.init(args=["--ros-args", "-r", f"__ns:={node.get_namespace()}", *words])
    try:
        tested = occupancy.Occupancy()
        with ThreadPoolExecutor(1) as pool, spinning(tested):
            pool.submit(tested.publish)  # ends with ROS, which spinning() ends
            yield
    finally:
        rclpy.try_shutdown()


def test_a_grid_that_takes_long_shows_all_batches_that_have_come(
    monkeypatch: pytest.MonkeyPatch, node: Node, listener: Any
) -> None:
    def slow(work: Callable[..., Any], seconds: float) -> Callable[..., Any]:
        def slowly(*given: Any) -> Any:
            time.sleep(seconds)
            return work(*given)

        return slowly

    monkeypatch.setattr(occupancy, "grid_of", slow(grid_of, 0.5))
    monkeypatch.setattr(OccupancyMap, "apply", slow(OccupancyMap.apply, 0.05))
    grid = Heard(node, OccupancyGrid, "gaussians/occupancy")
    publisher = MapPublisher(node)
    with running(node, "resolution:=0.1", "period:=0.05"):
        publisher.replace(floor())
        listener.wait(lambda: grid.message)
        for number in range(20):
            publisher.upsert([8192 + number], wall(1.05)[:1])
            time.sleep(0.03)  # or batches are lost, and pulled
        publisher.upsert(range(8192, 8192 + len(wall(1.05))), wall(1.05))
        before = grid.count
        listener.wait(lambda: grid.at(1.05, 0) == 100)
        assert grid.count <= before + 5


def test_a_map_of_too_many_voxels_is_refused_until_it_is_smaller_or_another(
    monkeypatch: pytest.MonkeyPatch, node: Node, listener: Any
) -> None:
    """The node runs here, with room for fewer voxels: those that it has room for take 2 GB."""
    monkeypatch.setattr(occupancy, "OccupancyMap", partial(OccupancyMap, most=1000))
    grid = Heard(node, OccupancyGrid, "gaussians/occupancy")
    said = Said(node)
    publisher = MapPublisher(node)
    with running(node, "resolution:=0.1"):
        publisher.replace(floor())
        listener.wait(lambda: "more than 1,000 voxels, choose a coarser" in said.message)
        assert said.values["Splats"] == str(len(floor()))
        assert said.values["Voxels"] == "0"
        assert not grid.message
        outside = np.flatnonzero(np.abs(floor().positions[:, :2]).max(axis=1) > 0.5)
        publisher.delete(outside[: len(outside) // 20])  # too few to try again
        listener.wait(lambda: said.values["Splats"] == str(len(floor()) - len(outside) // 20))
        assert "more than 1,000 voxels" in said.message
        publisher.delete(outside)
        listener.wait(lambda: grid.message and grid.at(0.05, 0.05) == 0)
        publisher.upsert(range(len(floor())), floor())
        listener.wait(lambda: "more than 1,000 voxels" in said.message)
        publisher.replace(wall(1.05))
        listener.wait(lambda: grid.message and grid.at(1.05, 0) == 100)
        # A wall has no floor.
        listener.wait(lambda: "no cell is free: at the start, (0, 0)" in said.message)
        assert int(said.values["Voxels"]) > 100
        around = np.abs(floor().positions[:, :2]).max(axis=1) < 0.5
        publisher.replace(floor()[np.flatnonzero(around)])
        listener.wait(lambda: said.message == "obstacles are published")
        assert said.levels[-2:] == [DiagnosticStatus.WARN, DiagnosticStatus.OK]


def test_what_is_pulled_has_no_harmonics(start: Start, node: Node, listener: Any) -> None:
    degrees: list[int] = []

    def answer(request: PullMap.Request, response: PullMap.Response) -> PullMap.Response:
        degrees.append(request.most_sh_degree)
        return response

    node.create_service(PullMap, "gaussians/pull", answer)
    start("occupancy")
    listener.wait(lambda: 0 in degrees)  # the listener asks, too


def test_a_map_is_seen_from_the_frames_that_are_asked_for(
    start: Start, node: Node, listener: Any
) -> None:
    pytest.importorskip("tf2_ros")
    from tf2_ros import TransformBroadcaster

    grid = Heard(node, OccupancyGrid, "gaussians/occupancy")
    log = Log(
        start("occupancy", resolution=RESOLUTION, size=20.0, period=0.05, frame_id="odom",
              band_frame="base")
    )  # fmt: skip
    publisher = MapPublisher(node)
    publisher.replace(floor())
    walls = 1024 * 8
    publisher.upsert(range(walls, walls + len(wall(1.05))), wall(1.05))
    listener.wait(lambda: log.has('nothing is published: "'))
    assert not grid.message
    broadcaster = TransformBroadcaster(node)

    def place(child: str, pose: NDArray[np.float64]) -> None:
        broadcaster.sendTransform(transform("odom", child, pose, place.second))
        place.second += 1

    place.second = 1
    map_in_odom, base = np.eye(4), np.eye(4)
    map_in_odom[:3, :3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    map_in_odom[2, 3] = base[2, 3] = 2.0
    while not (grid.message and grid.at(0, 1.05) == 100):
        place("map", map_in_odom)
        place("base", base)
        listener.spin_once()
    assert grid.message.header.frame_id == "odom"
    assert (grid.at(0, -1.05), grid.at(1.05, 0)) == (0, 0)
    base[2, 3] = 4.0  # up the stairs
    while grid.cells().tolist() != [[-1]]:
        place("base", base)
        listener.spin_once()
    assert grid.message.info.origin.position.z == pytest.approx(4.1)
    base[2, 3] = 2.0
    map_in_odom[:3, :3] = np.eye(3)
    while grid.at(1.05, 0) != 100:
        place("base", base)
        place("map", map_in_odom)
        listener.spin_once()
    assert (grid.at(0, -1.05), grid.at(0, 1.05)) == (0, 0)


@pytest.mark.parametrize(
    ("name", "value", "why"),
    [
        ("resolution", 0.0, "resolution"),
        ("size", 1000.0, "20,000 voxels along an axis"),
        ("threshold", 1.0, "threshold"),
        ("band", "[1.0,0.5]", "expected 0 < least < most"),
        ("band", "[0.1]", "band: expected two numbers"),
        ("start", "[0.0,.nan]", "start: expected two numbers"),
        ("period", 0.0, "period"),
    ],
)
def test_a_parameter_that_makes_no_sense(start: Start, name: str, value: object, why: str) -> None:
    process = start("occupancy", **{name: value})
    output, _ = process.communicate(timeout=PATIENCE)
    assert (process.returncode, len(output.strip().splitlines())) == (1, 1), output
    assert output.startswith("occupancy: ")
    assert why in output


def test_frames_need_tf(start: Start) -> None:
    process = start("occupancy", frame_id="odom")
    if "tf2_ros" in sys.modules or _has_tf():
        assert process.poll() is None
        return
    output, _ = process.communicate(timeout=PATIENCE)
    assert output == ("occupancy: frames other than the map's need TF: tf2_ros is not installed\n")


def _has_tf() -> bool:
    try:
        import tf2_ros  # noqa: F401
    except ImportError:
        return False
    return True
