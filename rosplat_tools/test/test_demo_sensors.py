"""The robot of the demo: what it measures is how it moves, on the topics and in the maths."""

import math
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import pairwise

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseStamped
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, Image, Imu

from rosplat_core.splats import Splats
from rosplat_msgs.srv import RenderView
from rosplat_ros.map_publisher import MapPublisher
from rosplat_testing import PATIENCE
from rosplat_tools.emulation.demo_sensors import Beat
from rosplat_tools.emulation.flight import CAMERA_OFFSET, GRAVITY, Flight

FLIGHT = Flight(np.array([1.0, -2.0, 0.5]), 3.0, 1.2, 6.0)
KEEP_ALL = QoSProfile(depth=2000)


@contextmanager
def sensors(
    node: Node, *parameters: str, arguments: tuple[str, ...] = ()
) -> Iterator[subprocess.Popen[str]]:
    """The program in the test's namespace; must end quietly by SIGINT."""
    settings = [word for parameter in parameters for word in ("-p", parameter)]
    program = "from rosplat_tools.commands import demo_sensors; demo_sensors()"
    command = [sys.executable, "-c", program, "--ros-args"]
    process = subprocess.Popen(
        [*command, "-r", f"__ns:={node.get_namespace()}", *settings, *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    try:
        yield process
        assert process.poll() is None
        process.send_signal(signal.SIGINT)
        said, _ = process.communicate(timeout=PATIENCE)
        assert process.returncode == 0
        assert "Traceback" not in said
    finally:
        process.kill()
        process.communicate()


@pytest.fixture
def spin_some(node: Node) -> Iterator[Callable[[], None]]:
    """Runs a callback or two of the test's node."""
    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    yield lambda: executor.spin_once(0.1)
    executor.shutdown()


def until(
    spin_some: Callable[[], None], done: Callable[[], bool], seconds: float = PATIENCE
) -> None:
    deadline = time.monotonic() + seconds
    while not done():
        assert time.monotonic() < deadline, "nothing came"
        spin_some()


def publish_map(node: Node) -> None:
    """A cube that is flown around at some 2 m."""
    corners = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3), axis=-1).reshape(-1, 3)
    n = len(corners)
    splats = Splats(
        positions=corners, orientations=np.tile([0, 0, 0, 1], (n, 1)),
        scales=np.full((n, 3), 0.1), opacities=np.ones(n), sh=np.zeros((n, 1, 3)),
    )  # fmt: skip
    MapPublisher(node).replace(splats)


class SimulatedClock:
    """Goes on when all until then is measured: so nothing is late, however busy the machine is."""

    parameters = ("use_sim_time:=true",)
    arguments = ("-r", "/clock:=clock")

    def __init__(self, node: Node, spin_some: Callable[[], None], measured: list[Imu]) -> None:
        self._clock = node.create_publisher(Clock, "clock", KEEP_ALL)
        self._spin_some = spin_some
        self._measured = measured
        self._ticks = 50_000

    def step(self) -> None:
        self._spin_some()
        if not self._measured or self._measured[-1].header.stamp == self._now():
            self._ticks += 1
        self._clock.publish(Clock(clock=self._now()))

    def _now(self) -> Time:
        return Time(sec=self._ticks // 50, nanosec=self._ticks % 50 * 20_000_000)


def seconds(stamp: object, start: object) -> float:
    return stamp.sec - start.sec + (stamp.nanosec - start.nanosec) * 1e-9


def rotation(q: object) -> np.ndarray:
    """(3, 3) of a quaternion message, by Rodrigues' formula."""
    x, y, z, w = q.x, q.y, q.z, q.w
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + 2 * w * cross + 2 * cross @ cross


def vector(v: object) -> np.ndarray:
    return np.array([v.x, v.y, v.z])


def turned(by: np.ndarray) -> np.ndarray:
    """(3, 3) of a rotation vector. [rad]"""
    half = np.linalg.norm(by) / 2
    x, y, z = by * (math.sin(half) / (2 * half))
    return rotation(type("Q", (), {"x": x, "y": y, "z": z, "w": math.cos(half)}))


# --- The maths ------------------------------------------------------------------------------------


def test_the_derivatives_are_the_path_s() -> None:
    step = 1e-4
    for now in np.linspace(0, FLIGHT.period, 41):
        before, motion, after = (FLIGHT.at(now + shift) for shift in (-step, 0, step))
        acceleration = (before.position - 2 * motion.position + after.position) / step**2
        np.testing.assert_allclose(motion.acceleration, acceleration, atol=1e-5)
        spin = motion.attitude.rotation.T @ (
            (after.attitude.rotation - before.attitude.rotation) / (2 * step)
        )
        np.testing.assert_allclose(
            motion.angular_velocity, [spin[2, 1], spin[0, 2], spin[1, 0]], atol=1e-6
        )


def test_the_path_is_closed_and_the_attitude_one_in_both_notations() -> None:
    for now in (0.0, 1.3, 4.9):
        motion, later = FLIGHT.at(now), FLIGHT.at(now + 3 * FLIGHT.period)
        np.testing.assert_allclose(motion.position, later.position, atol=1e-9)
        x, y, z, w = motion.attitude.quaternion
        np.testing.assert_allclose(
            rotation(type("Q", (), {"x": x, "y": y, "z": z, "w": w})), motion.attitude.rotation
        )


def test_the_camera_keeps_the_centre_in_its_picture() -> None:
    for now in np.linspace(0, FLIGHT.period, 50):
        camera = FLIGHT.camera(FLIGHT.at(now), 320, 240)
        x, y, z = (camera.world_to_camera @ [*FLIGHT.centre, 1])[:3]
        assert 0 < camera.fx * x / z + camera.cx < 320
        assert 0 < camera.fy * y / z + camera.cy < 240
        assert camera.world_to_camera[1, 2] < -0.7  # the picture's top is up


def test_a_flight_is_laid_around_the_middle_of_a_map() -> None:
    rng = np.random.default_rng(0)
    positions = rng.uniform([9, 19, 29], [11, 21, 31], (5000, 3))
    flight = Flight.around(np.concatenate([positions, [[1e6, 0, 0]]]), 10.0)
    np.testing.assert_allclose(flight.centre, [10, 20, 30], atol=0.05)
    assert 1.5 < flight.radius < 3


def test_moments_are_multiples_of_the_period_whenever_the_clock_is_read() -> None:
    beat = Beat(10**8)
    assert beat.due(1_234_567_890) == [1_200_000_000]
    assert beat.due(1_290_000_000) == []
    assert beat.due(1_510_000_000) == [1_300_000_000, 1_400_000_000, 1_500_000_000]
    assert beat.due(90_000_000_000) == [90_000_000_000]  # a leap
    assert beat.due(2_050_000_000) == [2_000_000_000]  # a bag begins again


# --- The node -------------------------------------------------------------------------------------


def test_the_imu_integrates_to_the_camera_s_poses(
    node: Node, spin_some: Callable[[], None]
) -> None:
    """Orientation from the angular velocity, place from the specific force and gravity."""
    measured: list[Imu] = []
    poses: list[PoseStamped] = []
    node.create_subscription(Imu, "imu/data", measured.append, KEEP_ALL)
    node.create_subscription(PoseStamped, "camera/pose", poses.append, KEEP_ALL)
    quiet = ("acceleration_noise:=0.0", "angular_velocity_noise:=0.0")
    clock = SimulatedClock(node, spin_some, measured)
    publish_map(node)
    settings = ("period:=5.0", *quiet, *clock.parameters)
    with sensors(node, *settings, arguments=clock.arguments):
        until(clock.step, lambda: len(measured) > 600 and len(poses) > 30)
    start = measured[0].header.stamp
    times = np.array([seconds(imu.header.stamp, start) for imu in measured])
    np.testing.assert_allclose(np.diff(times), 1 / 200, atol=1e-9)

    attitudes = np.array([rotation(imu.orientation) for imu in measured])
    attitude = attitudes[0]
    for one, other in pairwise(measured):
        rate = (vector(one.angular_velocity) + vector(other.angular_velocity)) / 2
        attitude = attitude @ turned(rate / 200)
    np.testing.assert_allclose(attitude, attitudes[-1], atol=1e-4)

    forces = np.array([vector(imu.linear_acceleration) for imu in measured])
    accelerations = np.einsum("nij,nj->ni", attitudes, forces) + GRAVITY
    middle = (accelerations[1:] + accelerations[:-1]) / 400
    velocities = np.concatenate([np.zeros((1, 3)), np.cumsum(middle, axis=0)])
    places = np.cumsum((velocities[1:] + velocities[:-1]) / 400, axis=0)
    places = np.concatenate([np.zeros((1, 3)), places])

    at = {round(now * 200): index for index, now in enumerate(times)}
    moments, seen, expected = [], [], []
    for pose in poses:
        index = at.get(round(seconds(pose.header.stamp, start) * 200))
        if index is not None:
            moments.append(times[index])
            seen.append(vector(pose.pose.position) - CAMERA_OFFSET * attitudes[index][:, 0])
            expected.append(places[index])
    # All that integration doesn't know: where it began, and how fast.
    unknown = np.stack([np.ones(len(moments)), moments], axis=1)
    drift = np.array(seen) - np.array(expected)
    residual = drift - unknown @ np.linalg.lstsq(unknown, drift, rcond=None)[0]
    assert len(moments) > 25
    assert np.ptp(np.array(seen), axis=0).min() > 0.1
    np.testing.assert_allclose(residual, 0, atol=2e-3)


def test_noise_is_as_large_as_its_covariance_says(
    node: Node, spin_some: Callable[[], None]
) -> None:
    measured: list[Imu] = []
    node.create_subscription(Imu, "imu/data", measured.append, KEEP_ALL)
    publish_map(node)
    with sensors(node, "period:=3600.0", "acceleration_noise:=0.2"):
        until(spin_some, lambda: len(measured) > 400)
    forces = np.array([vector(imu.linear_acceleration) for imu in measured])
    assert np.diff(forces, axis=0).std() / math.sqrt(2) == pytest.approx(0.2, rel=0.2)
    assert measured[0].linear_acceleration_covariance[0] == pytest.approx(0.04)
    assert (measured[0].orientation_covariance.reshape(3, 3).diagonal() > 0).all()


def test_each_picture_is_asked_for_once_and_shown_with_its_camera(
    node: Node, spin_some: Callable[[], None]
) -> None:
    asked: list[RenderView.Request] = []
    pictures: list[Image] = []
    infos: list[CameraInfo] = []

    def render(request: RenderView.Request, response: RenderView.Response) -> RenderView.Response:
        asked.append(request)
        if len(asked) == 3:
            response.message = "not now"
            return response
        pixels = np.full((request.camera.height, request.camera.width, 4), 0.5, np.float32)
        response.success = True
        response.color = Image(height=pixels.shape[0], width=pixels.shape[1], encoding="32FC4")
        response.color.data.frombytes(pixels.tobytes())
        return response

    node.create_service(RenderView, "gaussians/render", render)
    node.create_subscription(Image, "camera/image_raw", pictures.append, KEEP_ALL)
    node.create_subscription(CameraInfo, "camera/camera_info", infos.append, KEEP_ALL)
    publish_map(node)
    with sensors(node, "image_width:=64", "image_height:=48"):
        until(spin_some, lambda: len(asked) > 10 and len(pictures) > 10)
        until(spin_some, lambda: len(infos) >= len(pictures))
    stamps = [(image.header.stamp.sec, image.header.stamp.nanosec) for image in pictures]
    assert len(set(stamps)) == len(stamps)
    cameras = {
        (request.camera.header.stamp.sec, request.camera.header.stamp.nanosec): number
        for number, request in enumerate(asked)
    }
    assert len(cameras) == len(asked)
    drawn = [(cameras[s], p) for s, p in zip(stamps, pictures, strict=True)]
    assert 2 not in dict(drawn)  # which was refused
    for _, image in drawn:
        assert (image.width, image.height, image.step) == (64, 48, 192)
        assert (image.encoding, image.header.frame_id) == ("rgb8", "demo_camera_optical")
        values = np.frombuffer(image.data, np.uint8)
        # Half of it over half the background.
        expected = 255 * (0.5 + 0.5 * np.array([32, 34, 38]) / 255)
        assert np.abs(values.reshape(-1, 3) - expected).max() < 1
    for info, image in zip(infos, pictures, strict=False):
        assert info.header == image.header
        assert info.k[2] == pytest.approx(asked[0].camera.cx - 0.5)


def test_without_a_renderer_the_map_is_circled(
    node: Node, spin_some: Callable[[], None], random_splats: Callable[..., Splats]
) -> None:
    poses: list[PoseStamped] = []
    node.create_subscription(PoseStamped, "camera/pose", poses.append, KEEP_ALL)
    splats = random_splats(5000, 0)
    far = Splats(**(vars(splats) | {"origin": np.array([100.0, 50.0, 3.0])}))
    # A map that never gets whole is flown around after a while.
    MapPublisher(node, frame_id="odom").replace(far, expected_slots=6000)
    with sensors(node, "period:=2.0"):
        until(spin_some, lambda: len(poses) > 25)
    assert {pose.header.frame_id for pose in poses} == {"odom"}
    places = np.array([vector(pose.pose.position) for pose in poses])
    np.testing.assert_allclose(places[:, :2].mean(axis=0), [100, 50], atol=2)


def test_all_is_stamped_by_a_simulated_clock(node: Node, spin_some: Callable[[], None]) -> None:
    measured: list[Imu] = []
    node.create_subscription(Imu, "imu/data", measured.append, KEEP_ALL)
    clock = SimulatedClock(node, spin_some, measured)
    publish_map(node)
    with sensors(node, *clock.parameters, arguments=clock.arguments):
        until(clock.step, lambda: len(measured) > 100)
    stamps = [(imu.header.stamp.sec, imu.header.stamp.nanosec) for imu in measured]
    assert all(1000 <= sec < 2000 and nanosec % 5_000_000 == 0 for sec, nanosec in stamps)
    assert stamps == sorted(stamps)


@pytest.mark.parametrize(
    ("name", "value"), [("period", -1.0), ("use_sim_time", 7), ("image_width", "wide")]
)
def test_a_parameter_that_makes_no_sense_is_one_line(
    refusal: Callable[..., str], name: str, value: object
) -> None:
    assert name in refusal("demo_sensors", **{name: value})
