"""One map in several views of a real rviz2: with a camera, an order and a picture each."""

from __future__ import annotations

import math
import time
from typing import TYPE_CHECKING

import numpy as np
import pytest

from rviz_harness import (
    Rviz,
    World,
    blue,
    configuration,
    disc,
    display,
    map_display,
    needs_rviz,
    red,
)

if TYPE_CHECKING:
    from rosplat_core.splats import Splats
    from rosplat_msgs.msg import ViewCamera

pytestmark = needs_rviz

CAMERA = display(
    "Camera",
    "Camera",
    **{"Topic": {"Value": "/camera/image_raw"}, "Image Rendering": "background"},
)
ORBIT = """{Class: rviz_default_plugins/Orbit, Distance: 6, Yaw: 0.9, Pitch: 0.5,
  Focal Point: {X: 0.2, Y: -0.1, Z: 0.3}, Near Clip Distance: 0.01}"""
FPS = """{Class: rviz_default_plugins/FPS, Yaw: 3.5, Pitch: 0.2, Roll: 0.3,
  Position: {X: 3, Y: 1, Z: 1}, Near Clip Distance: 0.01}"""
FOLLOWER = """{Class: rviz_default_plugins/ThirdPersonFollower, Distance: 4, Yaw: 2, Pitch: 1,
  Near Clip Distance: 0.01}"""
FLY = """{Class: rviz_gaussian_plugin/Fly, Yaw: 3.9, Pitch: 0.4, Near Clip Distance: 0.01,
  Position: {X: 2, Y: 2, Z: 1}}"""
TOP_TURNED = "{Class: rviz_default_plugins/TopDownOrtho, Scale: 120, X: 0.4, Y: -0.3, Angle: 0.7}"


class RobotCamera:
    """A camera with a black picture, on a robot under the map that looks up."""

    def __init__(self, world: World, width: int, height: int) -> None:
        from sensor_msgs.msg import CameraInfo, Image

        self._world, self._size = world, (width, height)
        self._info = CameraInfo(width=width, height=height)
        self._info.k = [200.0, 0.0, width / 2, 0.0, 200.0, height / 2, 0.0, 0.0, 1.0]
        self._info.p = [200.0, 0.0, width / 2, 0.0, 0.0, 200.0, height / 2, 0.0, 0.0, 0.0, 1.0, 0.0]
        self._image = Image(width=width, height=height, encoding="rgb8", step=3 * width)
        self._image.data = bytes(3 * width * height)
        self._images = world.node.create_publisher(Image, "/camera/image_raw", 1)
        self._infos = world.node.create_publisher(CameraInfo, "/camera/camera_info", 1)
        # z of the optical frame is up.
        world.place(z=-4.0, frame="optical")
        world.node.create_timer(0.1, self._publish)

    def _publish(self) -> None:
        stamp = self._world.node.get_clock().now().to_msg()
        for message, publisher in [(self._image, self._images), (self._info, self._infos)]:
            message.header.frame_id, message.header.stamp = "optical", stamp
            publisher.publish(message)


class Views:
    """The newest camera of each view of the map, and what a view with it must show."""

    def __init__(self, world: World) -> None:
        from rosplat_msgs.msg import ViewCamera
        from rosplat_msgs.srv import RenderView

        self._world = world
        self.cameras: dict[str, ViewCamera] = {}
        self._heard: dict[str, float] = {}
        world.node.create_subscription(ViewCamera, "gaussians/view", self._receive, 100)
        self._service = world.node.create_client(RenderView, "gaussians/render")
        self._request = RenderView.Request

    def _receive(self, camera: ViewCamera) -> None:
        self.cameras[camera.view_id] = camera
        self._heard[camera.view_id] = time.monotonic()

    def heard(self, seconds: float) -> set[str]:
        """The views that were heard of in the last seconds."""
        since = time.monotonic() - seconds
        return {view for view, when in self._heard.items() if when > since}

    def of_size(self, width: int, height: int) -> ViewCamera:
        """The camera of the view with that many pixels."""
        settled = time.monotonic() + 0.5  # what still waits to be received
        self._world.spin_until(lambda: time.monotonic() > settled)
        (camera,) = [c for c in self.cameras.values() if (c.width, c.height) == (width, height)]
        return camera

    def expected(self, camera: ViewCamera) -> np.ndarray:
        """(height, width, 3) the map before black, 0 to 255, as the render service has it."""
        self._world.spin_until(self._service.service_is_ready)
        future = self._service.call_async(self._request(camera=camera))
        self._world.spin_until(future.done)
        response = future.result()
        assert response.success, response.message
        color = np.frombuffer(response.color.data, np.float32)
        return 255 * color.reshape(camera.height, camera.width, 4)[..., :3].clip(0, 1)


def cloud(seed: int = 0) -> Splats:
    """Splats all over each other, so that no other order makes the same picture."""
    from rosplat_core.splats import Splats

    rng = np.random.default_rng(seed)
    count = 300
    orientations = rng.normal(size=(count, 4))
    return Splats(
        positions=rng.normal(0, 0.5, (count, 3)).astype(np.float32),
        orientations=orientations.astype(np.float32)
        / np.linalg.norm(orientations, axis=1, keepdims=True).astype(np.float32),
        scales=rng.uniform(0.02, 0.2, (count, 3)).astype(np.float32),
        opacities=rng.uniform(0.3, 1, count).astype(np.float32),
        sh=rng.uniform(-1.5, 1.5, (count, 1, 3)).astype(np.float32),
    )


def until_as_expected(rviz: Rviz, views: Views, of: str = "view") -> None:
    """Waits until a view shows the map as its own camera, as published, sees it."""
    width, height = rviz.ask("places")[of][2:]
    expected = views.expected(views.of_size(width, height))
    assert expected.max() > 100

    def alike(picture: np.ndarray) -> bool:
        difference = np.abs(picture - expected)
        return bool(difference.mean() < 0.5 and np.percentile(difference, 99.9) <= 2)

    rviz.until(alike, of)


def bright(picture: np.ndarray) -> bool:
    return bool((picture.max(axis=2) > 150).sum() > 200)


def test_an_offered_view_is_shown_whole_in_a_narrower_window(rviz: Rviz, world: World) -> None:
    """Its camera moves away from the target until what it is of fits in width."""
    from geometry_msgs.msg import Point, Vector3
    from std_msgs.msg import Header

    from rosplat_core.splats import concatenate
    from rosplat_msgs.msg import FirstView
    from rosplat_ros.qos import LATCHED

    world.place()
    offers = world.node.create_publisher(FirstView, "gaussians/first_view", LATCHED)
    offer = FirstView(header=Header(frame_id=world.frame), eye=Point(y=-3.0, z=8.0), width=2.0)
    offer.up = Vector3(z=1.0)
    offers.publish(offer)
    ends = [disc((1, 0, 0), x=-6.0, sigma=0.2), disc((0, 0, 1), x=6.0, sigma=0.2)]
    world.map.replace(concatenate(ends))
    rviz.load(configuration(map_display(**{"Fit View": True}), view=ORBIT))
    rviz.until(lambda s: red(s).any() and blue(s).any())
    _, _, width, height = rviz.ask("places")["view"]
    assert width / height < 2


def test_a_view_from_inside_is_one_that_turns_on_the_spot(rviz: Rviz, world: World) -> None:
    """rviz's Orbit would carry the camera through the walls."""
    from geometry_msgs.msg import Point, Vector3
    from std_msgs.msg import Header

    from rosplat_msgs.msg import FirstView
    from rosplat_ros.qos import LATCHED

    world.place()
    offers = world.node.create_publisher(FirstView, "gaussians/first_view", LATCHED)
    eye = Point(x=-3.0, y=0.5, z=4.5)
    offer = FirstView(header=Header(frame_id=world.frame), eye=eye, inside=True)
    offer.target, offer.up = Point(x=5.0, y=0.5, z=1.5), Vector3(z=1.0)
    offers.publish(offer)
    world.map.replace(disc((1, 0, 0), x=5.0, y=0.5, z=1.5, sigma=0.2))
    rviz.load(configuration(map_display(**{"Fit View": True}), view=ORBIT))
    views = Views(world)
    rviz.until(lambda s: red(s).any())
    world.spin_until(lambda: views.cameras)
    position = next(iter(views.cameras.values())).pose.position
    assert (position.x, position.y, position.z) == pytest.approx((-3.0, 0.5, 4.5), abs=1e-3)
    here = rviz.picture()
    assert red(here)[:, here.shape[1] // 2].any()


def test_view_controllers(rviz: Rviz, world: World) -> None:
    """Perspective and orthographic, each puts the splats where its camera sees them."""
    world.place(x=0.3, yaw=0.5, z=-0.2)
    world.map.replace(cloud())
    for view in [TOP_TURNED, ORBIT, FPS, FOLLOWER, FLY]:
        rviz.load(configuration(map_display(), view=view))
        views = Views(world)
        rviz.until(bright)
        world.spin_until(views.cameras.__len__)
        until_as_expected(rviz, views)


def test_a_camera_display_has_a_view_of_its_own(rviz: Rviz, world: World) -> None:
    world.place()
    rviz.load(configuration(CAMERA, map_display(), view=ORBIT))
    RobotCamera(world, *rviz.ask("places")["Camera"][2:])  # leaves no margins
    world.map.replace(cloud())
    views = Views(world)
    world.spin_until(lambda: len(views.cameras) == 2 and bright(rviz.picture("Camera")))
    until_as_expected(rviz, views)
    until_as_expected(rviz, views, of="Camera")

    rviz.set("Camera", "Visibility", "Map", value=False)
    world.spin_until(lambda: not bright(rviz.picture("Camera")))
    assert bright(rviz.picture())
    rviz.ask("reset", path=["Map"])
    world.spin_until(lambda: bright(rviz.picture()))
    assert not bright(rviz.picture("Camera"))
    rviz.set("Camera", "Visibility", "Map", value=True)
    world.spin_until(lambda: bright(rviz.picture("Camera")))


def test_a_view_that_nobody_sees_keeps_no_sorter_busy(rviz: Rviz, world: World) -> None:
    views = Views(world)
    RobotCamera(world, width=320, height=240)
    world.place()
    rviz.load(configuration(CAMERA, map_display(), view=ORBIT))
    world.map.replace(cloud())
    world.spin_until(lambda: len(views.heard(1.5)) == 2)
    rviz.set("Camera", value=False)
    world.spin_until(lambda: len(views.heard(1.5)) == 1)
    rviz.set("Map", value=False)  # programs, buffers and views that the camera's window drew with
    rviz.set("Map", value=True)
    rviz.set("Camera", value=True)
    world.spin_until(lambda: len(views.heard(1.5)) == 2 and bright(rviz.picture("Camera")))


def test_pictures_for_services_know_the_scale(rviz: Rviz, world: World) -> None:
    """A splat just outside the picture reaches into it ten times as large."""
    world.place()
    views = Views(world)
    rviz.load(configuration(map_display(Scale=10.0)))
    world.map.replace(disc((1, 0, 0), x=6.0, sigma=0.2))
    rviz.until(lambda s: red(s).any())
    world.spin_until(views.cameras.__len__)
    width, height = rviz.ask("places")["view"][2:]
    assert red(views.expected(views.of_size(width, height))).any()


def test_publish_camera_means_the_view_of_rviz(rviz: Rviz, world: World) -> None:
    from geometry_msgs.msg import PoseStamped
    from nav_msgs.msg import Path

    views = Views(world)
    RobotCamera(world, width=320, height=240)

    def near(pose: PoseStamped, x: float) -> bool:
        return abs(pose.pose.position.x - x) < 1e-3

    poses: list[PoseStamped] = []
    paths: list[Path] = []
    world.node.create_subscription(PoseStamped, "gaussians/camera/pose", poses.append, 10)
    world.node.create_subscription(Path, "gaussians/camera/path", paths.append, 10)
    world.place()
    rviz.load(configuration(CAMERA, map_display(**{"Publish Camera": True}), view=FLY))
    world.map.replace(cloud())
    world.spin_until(lambda: len(views.cameras) == 2 and poses and near(poses[-1], 2))
    poses.clear()
    world.spin_until(lambda: len(poses) > 2)
    for pose in poses:
        assert [getattr(pose.pose.position, axis) for axis in "xyz"] == pytest.approx([2, 2, 1])
        assert pose.header.frame_id == world.frame
    rviz.set("Position", "X", value=3.0, root="view")
    world.spin_until(lambda: paths and near(paths[-1].poses[-1], 3))
    assert near(paths[-1].poses[-2], 2)
    count, started = len(paths), time.monotonic()
    for x in np.arange(3.1, 3.7, 0.02).tolist():  # each a camera of its own
        rviz.set("Position", "X", value=x, root="view")
        world.spin_until(
            lambda x=x: any(abs(c.pose.position.x - x) < 1e-3 for c in views.cameras.values())
        )
    world.spin_until(lambda: near(paths[-1].poses[-1], x))
    # A path may be long: five times a second do.
    assert len(paths) - count <= 5 * (time.monotonic() - started) + 2


def test_each_view_says_who_sorted_it_and_asks_until_the_sidecar_did(
    rviz: Rviz, world: World
) -> None:
    """A sidecar that answers the camera alone: the other view is sorted here, and asks on."""
    from rosplat_msgs.msg import SplatOrder, ViewCamera
    from rosplat_ros.qos import ORDER

    orders = world.node.create_publisher(SplatOrder, "gaussians/order", ORDER)
    asked: dict[bool, int] = {}

    def answer(camera: ViewCamera) -> None:
        of_robot = camera.width == 320
        asked[of_robot] = camera.sequence
        if of_robot:
            orders.publish(
                SplatOrder(
                    view_id=camera.view_id, sequence=camera.sequence, map_id=world.map.map_id,
                    revision=world.map.revision, backend="test", slots=[0],
                )
            )  # fmt: skip

    world.node.create_subscription(ViewCamera, "gaussians/view", answer, ORDER)
    RobotCamera(world, width=320, height=240)
    world.place()
    rviz.load(configuration(CAMERA, map_display()))
    world.map.replace(disc((1, 0, 0)))

    def sorted_by(whom: str, view: bool) -> bool:
        texts = [
            text
            for name, (_, text) in rviz.status("Map").items()
            if name.startswith("Order (view") == view and name.startswith("Order")
        ]
        return len(texts) == 1 and f"by {whom}" in texts[0] and "fresh" in texts[0]

    world.spin_until(lambda: sorted_by("processor", False) and sorted_by("sidecar (test)", True))
    before = dict(asked)
    world.spin_until(lambda: asked[False] > before[False] + 2)
    assert asked[True] == before[True]
    assert sorted_by("processor", False) and sorted_by("sidecar (test)", True)
    rviz.set("Camera", value=False)
    world.spin_until(lambda: not any("view" in name for name in rviz.status("Map")))


def test_a_display_that_sorts_itself_asks_no_sidecar(rviz: Rviz, world: World) -> None:
    from geometry_msgs.msg import PoseStamped

    views = Views(world)
    poses: list[PoseStamped] = []
    world.node.create_subscription(PoseStamped, "gaussians/camera/pose", poses.append, 10)
    world.place()
    itself = {"Order Source": "Auto", "Publish Camera": True}
    rviz.load(configuration(map_display(**itself), view=FLY))
    world.map.replace(cloud())
    rviz.until_status("Map", "Order", "Ok", "by processor", "fresh")
    world.spin_until(lambda: poses and world.node.count_publishers("gaussians/view"))
    rviz.set("Position", "X", value=3.0, root="view")
    world.spin_until(lambda: poses[-1].pose.position.x == pytest.approx(3))
    count = len(poses)
    world.spin_until(lambda: len(poses) > count + 2)  # once a second
    # Others may want to know what is seen; 0 asks nobody to sort.
    assert all(camera.sequence == 0 for camera in views.cameras.values())

    rviz.set("Map", "Order Source", value="Sidecar")
    world.spin_until(lambda: any(camera.sequence for camera in views.cameras.values()))
    (camera,) = views.cameras.values()
    assert camera.pose.position.x == pytest.approx(3)
    sorter = rviz.processes.node("rosplat_sorter", "sorter")
    try:
        rviz.until_status("Map", "Order", "Ok", "by sidecar", "fresh")
    finally:
        sorter.terminate()
        sorter.wait()
        rviz.processes.forget(sorter)


def test_each_view_has_its_own_order(rviz: Rviz, world: World) -> None:
    """Blue over red from above, red over blue from below, with a sidecar and without."""
    from rosplat_core.splats import concatenate

    RobotCamera(world, width=320, height=240)
    world.place()
    rviz.load(configuration(CAMERA, map_display()))
    world.map.replace(concatenate([disc((0, 0, 1), z=1.0, sigma=0.5), disc((1, 0, 0), sigma=0.5)]))

    def right() -> bool:
        above, below = rviz.picture(), rviz.picture("Camera")
        return bool(
            blue(above).any()
            and not red(above).any()
            and red(below).any()
            and not blue(below).any()
        )

    world.spin_until(right)
    sorter = rviz.processes.node("rosplat_sorter", "sorter")
    try:
        world.spin_until(lambda: "sidecar" in rviz.status("Map").get("Order", ("", ""))[1])
        for _ in range(20):
            world.spin_until(right)
    finally:
        sorter.terminate()
        sorter.wait()
        rviz.processes.forget(sorter)


@pytest.mark.parametrize("tool", ["Interact", "Select"])
def test_flying_by_keys_and_mouse(rviz: Rviz, tool: str) -> None:
    """Whichever tool is in hand; "s" is the key of Select, and is not taken for it."""
    tools = [tool] + [other for other in ("Interact", "Select") if other != tool]
    listed = ", ".join(f"{{Class: rviz_default_plugins/{name}}}" for name in tools)
    rviz.load(configuration(view=FLY, tools=listed))
    yaw, pitch = 3.9, 0.4
    ahead = np.array(
        [math.cos(yaw) * math.cos(pitch), math.sin(yaw) * math.cos(pitch), -math.sin(pitch)]
    )
    left, up = np.array([-math.sin(yaw), math.cos(yaw), 0]), np.array([0, 0, 1])

    def position() -> np.ndarray:
        values = rviz.properties(root="view")
        return np.array([values[f"Position/{axis}"] for axis in "XYZ"])

    def at_rest() -> np.ndarray:
        before = None
        while not np.array_equal(before, now := position()):
            before = now
            time.sleep(0.2)
        return now

    height, width, _ = rviz.picture().shape
    rviz.click(height // 2, width // 2)
    keys = {"w": ahead, "s": -ahead, "a": left, "d": -left, "e": up, "q": -up}
    for key, direction in keys.items():
        before = at_rest()
        with rviz.held(key):
            rviz.until(lambda _: np.linalg.norm(position() - before) > 0.3)  # noqa: B023
        way = at_rest() - before
        np.testing.assert_allclose(way / np.linalg.norm(way), direction, atol=0.02)
    if tool == "Select":
        return  # a drag selects
    place = at_rest()
    rviz.drag((height // 2, width // 2), (height // 2 + 40, width // 2 + 100))

    def turned(_: object) -> bool:
        looking = rviz.properties(root="view")
        angles = [looking["Yaw"], looking["Pitch"]]
        return bool(np.allclose(angles, [yaw - 0.5, pitch + 0.2], rtol=0, atol=0.05))

    rviz.until(turned)  # the mouse's events come by way of the screen
    np.testing.assert_array_equal(position(), place)
