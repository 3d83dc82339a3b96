"""The program align, and compare with align, in processes of their own: poses are found again."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ament_index_python.packages import get_package_share_directory
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped
from rcl_interfaces.srv import GetParameters
from rclpy.node import Node
from rclpy.task import Future
from rclpy.time import Time
from sensor_msgs.msg import CameraInfo, Image

from rosplat_core.alignment import motion
from rosplat_core.cameras import Camera, look_at, save_cameras
from rosplat_core.generated import generate
from rosplat_core.lens_pictures import take_picture
from rosplat_core.lens_warps import Warp
from rosplat_core.lenses import Lens
from rosplat_core.quaternions import from_matrices
from rosplat_core.rendering import CpuRenderer
from rosplat_msgs.msg import Comparison
from rosplat_msgs.srv import Align
from rosplat_ros.images import from_image, to_bytes, to_image
from rosplat_ros.map_publisher import MapPublisher
from rosplat_ros.poses import to_matrix, to_pose
from rosplat_ros.program.processes import Processes
from rosplat_testing import PATIENCE, Listener
from rosplat_testing.studio import Log, Studio, transform
from rosplat_tools.cameras.calibrations import of_lens

SEED = 2
SPLATS = generate(5000, seed=SEED)
LENS = Lens.of_view(160, 120, 1.0)
BARREL = Lens(160, 120, 150.0, 150.0, 80.0, 60.0, "plumb_bob", (-0.2, 0.03, 1e-3, 0, 0))
EYE = look_at((5, 1, 2.0), (0, 0, 0.5))
# By how much starts are off: metres and radians.
OFF = motion([0.08, -0.05, 0.06, 0.02, -0.02, 0.03])


def start_of(world_to_camera: np.ndarray) -> np.ndarray:
    """(4, 4) world to camera, off."""
    return np.linalg.inv(np.linalg.inv(world_to_camera) @ OFF)


def picture(lens: Lens, pose: np.ndarray) -> Image:
    colour = take_picture(CpuRenderer(SPLATS), Warp(lens), pose).colour
    return to_image(to_bytes(0.8 * colour + 0.05), "rgb8")


def apart(found: np.ndarray, world_to_camera: np.ndarray) -> tuple[float, float]:
    """Metres and degrees between a pose and a camera's."""
    between = world_to_camera @ found
    sine = np.linalg.norm(from_matrices(between[:3, :3])[:3])
    return float(np.linalg.norm(between[:3, 3])), float(np.degrees(2 * np.arcsin(sine)))


class Aligner:
    """What align publishes and serves for a camera's topics."""

    def __init__(self, node: Node, listener: Listener, start: Callable[..., Any]) -> None:
        self.node, self.listener, self._start = node, listener, start
        self.studio = Studio(node, listener, "")
        self.aligned: list[PoseWithCovarianceStamped] = []
        self._images = node.create_publisher(Image, "image_raw", 10)
        self._infos = node.create_publisher(CameraInfo, "camera_info", 10)
        self.info: CameraInfo | None = None
        self._client = node.create_client(Align, "align/align")

    def hear(self) -> None:
        self.node.create_subscription(PoseWithCovarianceStamped, "aligned", self.aligned.append, 10)

    def start(self, **parameters: object) -> Log:
        log = Log(self._start("align", poses="topic", **parameters))
        for publisher in (self._images, self._infos):
            self.listener.wait(publisher.get_subscription_count)
        assert self._client.wait_for_service(PATIENCE)
        return log

    def calibrate(self, lens: Lens) -> None:
        self.info = of_lens(lens)

    def _send_info(self) -> None:
        """As drivers do, again and again: align may not hear the first."""
        if self.info:
            self._infos.publish(self.info)

    def show(self, image: Image, seconds: int) -> None:
        self._send_info()
        image.header.stamp.sec = seconds
        self._images.publish(image)

    def until(self, log: Log, said: str, image: Image, seconds: int) -> None:
        while not log.has(said):
            self.show(image, seconds)
            self.listener.spin_once()

    def call(
        self, world_to_camera: np.ndarray, image: Image | None = None, frame: str = ""
    ) -> Align.Response:
        future = self.request(world_to_camera, image, frame)
        self.listener.wait(future.done)
        return future.result()

    def request(
        self, world_to_camera: np.ndarray, image: Image | None = None, frame: str = ""
    ) -> Future:
        self._send_info()
        request = Align.Request(image=image or Image())
        request.start.header.frame_id = frame
        request.start.pose = to_pose(np.linalg.inv(world_to_camera))
        return self._client.call_async(request)

    def call_until(self, said: str, *request: Any) -> Align.Response:
        """What else was sent comes when it does."""
        while (response := self.call(*request)).problem != said and not (
            said and said in response.problem
        ):
            assert not response.converged and not response.pose.header.frame_id
        return response


@pytest.fixture
def aligner(node: Node, listener: Listener, start: Callable[..., Any]) -> Aligner:
    return Aligner(node, listener, start)


def test_align_finds_the_poses_of_what_camera_films(
    node: Node, listener: Listener, start: Callable[..., subprocess.Popen[str]], aligner: Aligner
) -> None:
    """The camera is where its topic says; align and compare hear of it from one that is off."""
    MapPublisher(node).replace(SPLATS)
    filming, said = Studio(node, listener), Studio(node, listener, "said")
    metrics: list[Comparison] = []
    node.create_subscription(Comparison, "metrics", metrics.append, 10)
    aligner.hear()
    lens = {"camera.width": 160, "camera.height": 120, "camera.fov": 1.0}
    start("camera", poses="topic", rate=50.0, **lens)
    names = {
        "image_raw": "camera/image_raw", "camera_info": "camera/camera_info", "pose": "said/pose",
    }  # fmt: skip
    start("align", names, poses="topic")
    start("compare", names, poses="topic", align=True)
    listener.wait(lambda: node.count_subscribers("said/pose") == 2)
    listener.wait(lambda: node.count_subscribers("camera/image_raw") == 2)
    for number, angle in enumerate((0.0, 0.7, 1.4)):
        eye = look_at((5 * np.cos(angle), 5 * np.sin(angle), 2.0), (0, 0, 0.5))
        first = second = 1 + 1000 * number
        while not all(
            each and each[-1].header.stamp.sec >= first for each in (aligner.aligned, metrics)
        ):
            said.pose(start_of(eye), second)
            filming.pose(eye, second)
            listener.spin_once()
            second += 1
        found = aligner.aligned[-1]
        metres, degrees = apart(to_matrix(found.pose.pose), eye)
        assert metres < 0.004 and degrees < 0.05
        covariance = np.reshape(found.pose.covariance, (6, 6))
        assert 0 < np.sqrt(covariance.diagonal()).max() < 0.01
        assert found.header.frame_id == "map"
        assert metrics[-1].aligned
        correction = to_matrix(metrics[-1].correction.pose)
        np.testing.assert_allclose(correction, np.linalg.inv(OFF), atol=0.004)


@pytest.mark.parametrize("lens", [LENS, BARREL], ids=["pinhole", "barrel"])
def test_the_service_takes_a_picture_or_the_last_one(
    node: Node, aligner: Aligner, lens: Lens
) -> None:
    MapPublisher(node).replace(SPLATS)
    log = aligner.start()
    aligner.calibrate(lens)
    image = picture(lens, EYE)
    image.header.stamp.sec = 7
    given = aligner.call_until("", start_of(EYE), image, "map")
    metres, degrees = apart(to_matrix(given.pose.pose.pose), EYE)
    assert metres < 0.01 and degrees < 0.1
    assert given.converged and given.pose.header.stamp.sec == 7
    assert given.iterations > 3 and given.explained > 0.9 and given.residual < 0.02
    np.testing.assert_allclose(given.gain, 0.8, atol=0.03)
    assert aligner.call(EYE).problem == "no picture has come on image_raw"
    aligner.show(image, 8)
    last = aligner.call_until("", start_of(EYE))
    assert last.pose.header.stamp.sec == 8
    assert last.pose.pose == given.pose.pose
    assert not log.warnings  # of a service, its caller hears


def test_a_long_call_holds_up_no_other_callback(node: Node, aligner: Aligner) -> None:
    large = Lens.of_view(640, 480, 1.0)
    MapPublisher(node).replace(SPLATS)
    aligner.start()
    aligner.calibrate(large)
    aligner.show(picture(large, EYE), 8)
    aligner.call_until("", EYE)
    call = aligner.request(start_of(EYE))
    for _ in range(3):  # the first may come before the call
        aligner.listener.call(GetParameters, "align/get_parameters", names=["near"])
    assert not call.done()
    aligner.listener.wait(call.done)
    assert call.result().converged


def test_calls_beyond_two_are_refused_at_once(node: Node, aligner: Aligner) -> None:
    MapPublisher(node).replace(SPLATS)
    aligner.start()
    aligner.calibrate(LENS)
    image = picture(LENS, EYE)
    aligner.call_until("", EYE, image)
    calls = [aligner.request(start_of(EYE), image) for _ in range(8)]
    aligner.listener.wait(lambda: all(call.done() for call in calls))
    answers = [call.result() for call in calls]
    assert 2 <= sum(answer.converged for answer in answers) < 8
    assert {answer.problem for answer in answers} == {
        "", "busy with 2 calls: call again once one is answered",
    }  # fmt: skip


def test_a_picture_is_found_without_a_start(node: Node, aligner: Aligner, tmp_path: Path) -> None:
    views = [look_at((5 * np.cos(a), 5 * np.sin(a), 2.0), (0, 0, 0.5)) for a in (0.0, 0.3, 2.0)]
    cameras = [Camera(0, 160, 120, 146.0, 146.0, 80.0, 60.0, view) for view in views]
    save_cameras(tmp_path / "cameras.json", cameras)
    MapPublisher(node).replace(SPLATS)
    aligner.start(places=str(tmp_path / "cameras.json"))
    aligner.calibrate(LENS)
    image = picture(LENS, EYE)
    aligner.call_until("", EYE, image)

    def found(image: Image) -> Align.Response:
        future = aligner._client.call_async(Align.Request(image=image, anywhere=True))
        aligner.listener.wait(future.done)
        return future.result()

    metres, degrees = apart(to_matrix(found(image).pose.pose.pose), EYE)
    assert metres < 0.01 and degrees < 0.1
    mirrored = found(to_image(np.ascontiguousarray(from_image(image)[:, ::-1]), "rgb8"))
    assert mirrored.problem == "none of 3 places shows what the picture does"


def test_places_are_those_of_a_file(node: Node, aligner: Aligner) -> None:
    MapPublisher(node).replace(SPLATS)
    aligner.start()
    aligner.calibrate(LENS)
    image = picture(LENS, EYE)
    aligner.call_until("", EYE, image)
    future = aligner._client.call_async(Align.Request(image=image, anywhere=True))
    aligner.listener.wait(future.done)
    assert future.result().problem == "the parameter places names no file"


def test_the_launch_file_refines_the_poses_of_tf(
    node: Node, aligner: Aligner, tmp_path: Path
) -> None:
    """The map's publisher and the node are started by `ros2 launch`; TF is a robot's."""
    tf2_ros = pytest.importorskip("tf2_ros")
    launch = Path(get_package_share_directory("rosplat_tools")) / "launch" / "align.launch.py"
    inside = tmp_path / "inside.launch.yaml"
    inside.write_text(f"""launch:
- group:
  - push_ros_namespace: {{namespace: "{node.get_namespace()}"}}
  - include:
      file: {launch}
      arg:
      - {{name: scene, value: "procedural:{len(SPLATS)}:{SEED}"}}
      - {{name: image, value: robot/image}}
      - {{name: camera_info, value: robot/info}}
      - {{name: broadcast, value: refined}}
""")
    start = transform("map", "optical", np.linalg.inv(start_of(EYE)))
    robot = tf2_ros.StaticTransformBroadcaster(node)
    robot.sendTransform(start)
    known = tf2_ros.Buffer(node=node)
    tf2_ros.TransformListener(known, node)
    images = node.create_publisher(Image, "robot/image", 10)
    infos = node.create_publisher(CameraInfo, "robot/info", 10)
    image = picture(LENS, EYE)
    image.header.frame_id = "optical"
    seconds = 0
    with Processes(tmp_path) as processes:
        processes.start("launch", ["ros2", "launch", str(inside)])
        while not known.can_transform("map", "refined", Time()):
            processes.check()
            seconds += 1
            image.header.stamp.sec = seconds
            infos.publish(of_lens(LENS))
            images.publish(image)
            aligner.listener.spin_once()
        found = known.lookup_transform("map", "refined", Time())
    place = found.transform.translation
    np.testing.assert_allclose([place.x, place.y, place.z], np.linalg.inv(EYE)[:3, 3], atol=0.004)


def test_what_cannot_be_aligned_is_said_and_passes(node: Node, aligner: Aligner) -> None:
    status: list[str] = []
    node.create_subscription(
        DiagnosticArray, "/diagnostics",
        lambda array: status.extend(
            each.message for each in array.status if "align: " in each.name
        ), 10,
    )  # fmt: skip
    aligner.hear()
    log = aligner.start()
    image = picture(LENS, EYE)
    aligner.until(log, "no map has come yet", image, 1)
    MapPublisher(node).replace(SPLATS)
    aligner.studio.pose(start_of(EYE), 10)
    aligner.studio.pose(start_of(EYE), 20)
    aligner.until(log, "no CameraInfo has come on camera_info", image, 11)
    aligner.until(log, "after all poses that are known", image, 25)
    zeros = CameraInfo(width=160, height=120, distortion_model="plumb_bob")
    aligner.info = zeros
    aligner.until(log, "camera_info is refused: k: focal lengths are 0.0, 0.0", image, 12)
    aligner.calibrate(Lens.of_view(320, 240, 1.0))
    aligner.until(log, "a picture is 160 x 120, camera_info says 320 x 240", image, 12)
    aligner.calibrate(LENS)
    odd = to_image(from_image(image), "rgb8")
    odd.encoding = "yuv422"
    aligner.until(log, "encoding is 'yuv422', known are rgb8", odd, 13)
    flat = to_image(np.full((120, 160, 3), 90, np.uint8), "rgb8")
    assert aligner.call(EYE, flat).problem
    aligner.until(log, aligner.call(start_of(EYE), flat).problem[:12], flat, 14)
    assert not aligner.aligned
    assert "'odom', the map is in 'map'" in aligner.call(EYE, image, "odom").problem
    assert aligner.call(EYE, odd).problem.startswith("encoding is 'yuv422'")
    while not aligner.aligned:
        aligner.show(image, 15)
        aligner.listener.spin_once()
    metres, degrees = apart(to_matrix(aligner.aligned[-1].pose.pose), EYE)
    assert metres < 0.004 and degrees < 0.05
    aligner.listener.wait(lambda: "pictures come" in status)
    assert not any("Traceback" in line for line in log.lines)


def test_tf_has_the_pose_where_a_parameter_asks_for_it(node: Node, aligner: Aligner) -> None:
    messages = pytest.importorskip("tf2_msgs.msg")
    heard: list[Any] = []
    node.create_subscription(messages.TFMessage, "/tf", heard.append, 100)
    MapPublisher(node).replace(SPLATS)
    aligner.start(broadcast="camera_aligned")
    aligner.calibrate(LENS)
    aligner.studio.pose(start_of(EYE))

    def ours() -> list[Any]:
        transforms = [each for message in heard for each in message.transforms]
        return [each for each in transforms if each.child_frame_id == "camera_aligned"]

    while not ours():
        aligner.show(picture(LENS, EYE), 3)
        aligner.listener.spin_once()
    moved = ours()[-1]
    place = moved.transform.translation
    np.testing.assert_allclose([place.x, place.y, place.z], np.linalg.inv(EYE)[:3, 3], atol=0.004)
    assert (moved.header.frame_id, moved.header.stamp.sec) == ("map", 3)
