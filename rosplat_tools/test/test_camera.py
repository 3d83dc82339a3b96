"""The program camera, in a process of its own, against pictures drawn here."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import rclpy
from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header

from rosplat_core.cameras import look_at
from rosplat_core.generated import generate
from rosplat_core.lens_pictures import Shutter, take_picture
from rosplat_core.lens_warps import Warp
from rosplat_core.lenses import Lens
from rosplat_core.rendering import CpuRenderer
from rosplat_ros.images import from_image, to_bytes
from rosplat_ros.map_publisher import MapPublisher
from rosplat_testing import PATIENCE, Listener
from rosplat_testing.studio import Log, Studio, transform
from rosplat_tools.cameras.calibrations import of_lens
from rosplat_tools.cameras.pose_history import SECOND, PoseError, between
from rosplat_tools.cameras.poses import TopicPoses
from rosplat_tools.frames import Frames

SPLATS = generate(3000, seed=2)
EYE = look_at((6.0, 1.0, 2.0), (0.0, 0.0, 0.5))
BESIDE = look_at((0.0, 6.0, 2.0), (0.0, 0.0, 0.5))
LENS = Lens.of_view(160, 120, 1.0)
BARREL = Lens(160, 120, 150.0, 150.0, 80.0, 60.0, "plumb_bob", (-0.2, 0.03, 1e-3, 0, 0))
PINHOLE = {"camera.width": 160, "camera.height": 120, "camera.fov": 1.0}


@pytest.fixture
def studio(node: Node, listener: Listener) -> Studio:
    return Studio(node, listener)


@pytest.fixture
def publisher(node: Node) -> MapPublisher:
    made = MapPublisher(node)
    made.replace(SPLATS)
    return made


def drawn(lens: Lens, world_to_camera: np.ndarray, **wanted: Any) -> Any:
    return take_picture(CpuRenderer(SPLATS), Warp(lens), world_to_camera, **wanted)


def depths_of(image: Image) -> np.ndarray:
    assert image.encoding == "32FC1"
    return np.frombuffer(image.data, np.float32).reshape(image.height, image.width)


@pytest.mark.usefixtures("publisher")
def test_pictures_are_those_of_the_renderer(
    studio: Studio, start: Callable[..., subprocess.Popen[str]]
) -> None:
    for topic in ("image_raw", "depth/image_raw", "normals"):
        studio.hear(topic)
    studio.hear("camera_info", CameraInfo)
    studio.hear("depth/camera_info", CameraInfo)
    start("camera", poses="topic", rate=50.0, **PINHOLE)
    expected = drawn(LENS, EYE, depth="median", normals=True)
    studio.pose(EYE, seconds=7)
    image, depth = studio.next(), None
    studio.listener.wait(lambda: all(studio.heard.values()))
    assert (image.header.stamp.sec, image.header.frame_id) == (7, "camera_optical")
    assert image.encoding == "rgb8"
    np.testing.assert_array_equal(from_image(image), to_bytes(expected.colour))
    depth = depths_of(studio.heard["depth/image_raw"][0])
    np.testing.assert_array_equal(depth, expected.depth)
    assert 3 < np.median(depth[np.isfinite(depth)]) < 9
    normals = np.frombuffer(studio.heard["normals"][0].data, np.float32).reshape(120, 160, 3)
    np.testing.assert_array_equal(normals, expected.normals)
    info = studio.heard["camera_info"][0]
    assert info.header == image.header
    assert (info.k[0], info.k[2]) == (LENS.fx, LENS.cx)
    assert studio.heard["depth/camera_info"][0] == info


@pytest.mark.usefixtures("publisher")
def test_a_rolling_shutter_sees_each_row_from_where_the_camera_is_then(
    studio: Studio, start: Callable[..., subprocess.Popen[str]]
) -> None:
    """The picture has the time of its first row, and poses in between."""
    studio.hear("image_raw")
    process = start("camera", poses="topic", **PINHOLE, **{"camera.readout": 1.0})
    studio.pose(EYE, seconds=7)
    log = Log(process)
    studio.listener.wait(lambda: log.has("before all poses that are known"))
    studio.pose(BESIDE, seconds=8)
    image = studio.next()
    assert image.header.stamp.sec == 7
    eyes = [np.linalg.inv(eye) for eye in (EYE, BESIDE)]
    taken = Shutter(LENS).take(
        CpuRenderer(SPLATS), lambda share: np.linalg.inv(between(eyes[0], eyes[1], share))
    )
    np.testing.assert_array_equal(from_image(image), to_bytes(taken.colour))
    assert (from_image(image) != to_bytes(drawn(LENS, EYE).colour)).any()


@pytest.mark.usefixtures("publisher")
def test_there_are_no_more_pictures_than_the_rate(
    studio: Studio, start: Callable[..., subprocess.Popen[str]]
) -> None:
    studio.hear("image_raw")
    start("camera", poses="topic", rate=0.5, **PINHOLE)
    heard = studio.heard["image_raw"]
    for second, due in ((10, 1), (11, 1), (12, 2), (12, 2), (13, 2), (15, 3), (12, 3), (13, 4)):
        studio.pose(EYE, second)
        studio.listener.wait(lambda due=due: len(heard) >= due)
    stamps = [image.header.stamp.sec for image in heard]
    assert stamps == [10, 12, 15, 13]  # where time begins again, so do pictures


@pytest.mark.usefixtures("publisher")
def test_several_cameras_share_a_map(
    node: Node, listener: Listener, start: Callable[..., subprocess.Popen[str]]
) -> None:
    studios = {name: Studio(node, listener, name) for name in ("left", "right")}
    for studio in studios.values():
        studio.hear("image_raw")
    sizes = {f"{name}.{key[7:]}": value for name in studios for key, value in PINHOLE.items()}
    start("camera", poses="topic", cameras="[left, right]", **sizes)
    for (name, studio), eye in zip(studios.items(), (EYE, BESIDE), strict=True):
        studio.pose(eye)
        image = studio.next()
        assert image.header.frame_id == f"{name}_optical"
        np.testing.assert_array_equal(from_image(image), to_bytes(drawn(LENS, eye).colour))


@pytest.mark.usefixtures("publisher")
def test_a_camera_as_calibrated_by_a_topic_and_what_it_refuses(
    studio: Studio, start: Callable[..., subprocess.Popen[str]]
) -> None:
    studio.hear("image_raw")
    process = start("camera", poses="topic", **{"camera.calibration": "topic"})
    studio.pose(EYE)
    log = Log(process)
    studio.listener.wait(lambda: log.has("no CameraInfo has come on /"))

    def refused() -> bool:
        studio.calibrate(CameraInfo())  # again: the first may come before the camera hears it
        return log.has("the calibration is refused: width is 0, expected")

    studio.listener.wait(refused)
    studio.calibrate(of_lens(Lens(160, 120, 90.0, 90.0, 80.0, 60.0, "plumb_bob", (-0.6,))))
    studio.listener.wait(lambda: log.has("refused: d: the distortion folds: no ray arrives at"))
    assert not studio.heard["image_raw"]
    studio.calibrate(of_lens(BARREL))
    image = studio.next()
    np.testing.assert_array_equal(from_image(image), to_bytes(drawn(BARREL, EYE).colour))
    for said in ("no CameraInfo has come", "width is 0", "the distortion folds"):
        assert sum(said in line for line in log.lines) == 1


@pytest.mark.usefixtures("publisher")
def test_a_camera_outlives_lenses_and_poses_beyond_all_numbers(
    studio: Studio, start: Callable[..., subprocess.Popen[str]]
) -> None:
    studio.hear("image_raw")
    log = Log(start("camera", poses="topic", **{"camera.calibration": "topic"}))
    endless = of_lens(BARREL)
    endless.k[0] = endless.k[4] = 1e300
    far = EYE.copy()
    far[:3, 3] = 1e300

    def says(said: str, info: CameraInfo, pose: np.ndarray) -> bool:
        studio.calibrate(info)  # again: the first may come before the camera hears it
        studio.pose(pose)
        return log.has(said)

    studio.listener.wait(lambda: says("fx is too small or too large", endless, EYE))
    studio.listener.wait(lambda: says("pose.position is not finite, or too", of_lens(BARREL), far))
    studio.pose(EYE)
    image = studio.next()
    np.testing.assert_array_equal(from_image(image), to_bytes(drawn(BARREL, EYE).colour))


def test_nothing_is_published_of_a_map_in_part_or_a_pose_elsewhere(
    node: Node, studio: Studio, start: Callable[..., subprocess.Popen[str]]
) -> None:
    studio.hear("image_raw")
    process = start("camera", poses="topic", **PINHOLE)
    log = Log(process)
    studio.listener.wait(lambda: log.has("no map has come yet"))
    studio.pose(EYE)
    publisher = MapPublisher(node)
    # Both hear it from the beginning, and pull nothing.
    studio.listener.wait(lambda: publisher._wire._publisher.get_subscription_count() == 2)
    half = len(SPLATS) // 2
    publisher.replace(SPLATS[:half], expected_slots=len(SPLATS))
    studio.listener.wait(lambda: log.has("the map isn't complete: 1,500 splats, more is to come"))
    studio.pose(EYE, frame="elsewhere")
    publisher.upsert(range(half, len(SPLATS)), SPLATS[half:])
    studio.listener.wait(lambda: log.has("poses are in 'elsewhere', the map is in 'map'"))
    assert not studio.heard["image_raw"]
    studio.pose(EYE)
    np.testing.assert_array_equal(from_image(studio.next()), to_bytes(drawn(LENS, EYE).colour))
    assert len(log.warnings) == 3


@pytest.mark.parametrize(
    ("parameter", "value", "said"),
    [
        ("poses", "tx", "parameter poses: expected one of tf, topic, got 'tx'"),
        ("depth", "mean", "parameter depth: expected one of median, expected, got 'mean'"),
        ("near", 1e6, "parameters near, far: 1000000.0 is not less than 1000000.0"),
        ("camera.calibration", "/nowhere.yaml", "/nowhere.yaml: No such file or directory"),
        ("cameras", "['a b']", "parameter cameras: expected names"),
        ("cameras", "['é']", "parameter cameras: expected names"),
    ],
)
def test_a_mistake_is_one_line(
    start: Callable[..., subprocess.Popen[str]], parameter: str, value: object, said: str
) -> None:
    process = start("camera", **{"poses": "topic", parameter: value})
    log, _ = process.communicate(timeout=PATIENCE)
    assert process.returncode == 1
    lines = [line for line in log.splitlines() if "[INFO]" not in line]
    assert len(lines) == 1 and lines[0].startswith("camera: ") and said in lines[0]


@pytest.mark.usefixtures("publisher")
def test_a_camera_follows_tf(
    node: Node, studio: Studio, start: Callable[..., subprocess.Popen[str]]
) -> None:
    pytest.importorskip("tf2_ros")
    from tf2_ros import StaticTransformBroadcaster, TransformBroadcaster

    studio.hear("image_raw")
    process = start("camera", rate=50.0, **PINHOLE)
    log = Log(process)
    studio.listener.wait(lambda: log.has("does not exist"))  # TF, before it has come
    body = np.eye(4)
    body[:3, 3] = (0.3, -0.1, 0.2)
    StaticTransformBroadcaster(node).sendTransform(transform("body", "camera_optical", body))
    moving = TransformBroadcaster(node)
    for second, eye in ((5, EYE), (6, BESIDE)):
        count = len(studio.heard["image_raw"])
        while len(studio.heard["image_raw"]) == count:
            pose = np.linalg.inv(eye) @ np.linalg.inv(body)
            moving.sendTransform(transform("map", "body", pose, second))
            studio.listener.spin_once()
        image = studio.heard["image_raw"][-1]
        assert image.header.stamp.sec == second
        difference = from_image(image).astype(int) - to_bytes(drawn(LENS, eye).colour)
        assert np.abs(difference).max() <= 1  # poses are multiplied


@pytest.fixture
def clocked(node: Node) -> Node:
    """A node that follows /clock."""
    return rclpy.create_node(
        "listening", namespace=node.get_namespace(), context=node.context,
        parameter_overrides=[Parameter("use_sim_time", value=True)],
    )  # fmt: skip


def test_poses_of_a_run_end_where_simulated_time_begins_anew(
    node: Node, clocked: Node, studio: Studio
) -> None:
    listener, ticks = Listener(clocked), node.create_publisher(Clock, "/clock", 10)
    poses = TopicPoses(clocked, "camera", lambda: None)

    def found(nanosec: int) -> bool:
        ticks.publish(Clock(clock=Time(sec=500, nanosec=nanosec)))
        studio.pose(EYE, 500, nanosec=nanosec)
        try:
            return poses.pose("", "map")[0] == 500 * SECOND + nanosec
        except PoseError:
            return False

    listener.wait(lambda: found(900_000_000))
    for _ in range(30):
        listener.spin_once()  # takes what is still on its way
    listener.wait(lambda: found(100_000_000))  # so little back that only the clock tells


def test_poses_may_name_their_frame_as_ros_1_did(node: Node, listener: Listener) -> None:
    poses = TopicPoses(node, "camera", lambda: None)
    topic = node.create_publisher(PoseStamped, "camera/pose", 10)

    def found(frame: str) -> bool:
        topic.publish(PoseStamped(header=Header(frame_id=frame, stamp=Time(sec=7))))
        try:
            return poses.pose("", "map")[0] == 7 * SECOND
        except PoseError:
            return False

    listener.wait(lambda: found("/map"))
    listener.wait(lambda: not found("/odom"))


@pytest.mark.usefixtures("publisher")
def test_pictures_begin_again_with_simulated_time(
    node: Node, studio: Studio, start: Callable[..., subprocess.Popen[str]]
) -> None:
    ticks = node.create_publisher(Clock, "/clock", 10)
    studio.hear("image_raw")
    start("camera", poses="topic", rate=50.0, use_sim_time=True, **PINHOLE)
    for nanosec in (900_000_000, 100_000_000):  # so little back that only the clock tells
        count = len(studio.heard["image_raw"])

        def comes(nanosec: int = nanosec, count: int = count) -> bool:
            ticks.publish(Clock(clock=Time(sec=500, nanosec=nanosec)))
            studio.pose(EYE, 500, nanosec=nanosec)
            return len(studio.heard["image_raw"]) > count

        studio.listener.wait(comes)
        assert studio.heard["image_raw"][-1].header.stamp.nanosec == nanosec
        for _ in range(30):
            studio.listener.spin_once()  # while the camera takes what is still on its way


def test_tf_of_a_run_ends_where_simulated_time_begins_anew(node: Node, clocked: Node) -> None:
    tf2_ros = pytest.importorskip("tf2_ros")
    listener, sent = Listener(clocked), tf2_ros.TransformBroadcaster(node)
    frames, ticks = Frames(clocked), node.create_publisher(Clock, "/clock", 10)

    def found(second: int, pose: np.ndarray) -> bool:
        ticks.publish(Clock(clock=Time(sec=second)))
        sent.sendTransform(transform("map", "body", pose, second))
        try:
            return np.allclose(frames.pose("body", "map")[1], pose)
        except PoseError:
            return False

    listener.wait(lambda: found(500, np.linalg.inv(EYE)))
    for _ in range(30):
        listener.spin_once()  # takes what is still on its way
    listener.wait(lambda: found(3, np.linalg.inv(BESIDE)))
