"""The embedded viewer over DDS: what it draws for others, whose order it takes, how it ends."""

import math
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import rclpy
from geometry_msgs.msg import Pose, Quaternion
from PIL import Image
from rclpy.node import Node
from std_msgs.msg import Header

from rosplat_core.cameras import Camera
from rosplat_core.lens_pictures import take_picture
from rosplat_core.lens_warps import Warp
from rosplat_core.lenses import Lens
from rosplat_core.maps import Arrival, GaussianMap
from rosplat_core.rendering import CpuRenderer, SplatCamera, insert_all
from rosplat_core.splats import Splats
from rosplat_msgs.msg import GaussianArray, SplatOrder, ViewCamera
from rosplat_msgs.srv import RenderView
from rosplat_ros.map_publisher import MapPublisher
from rosplat_ros.program.running import spinning
from rosplat_ros.qos import MAP_VOLATILE, ORDER, VIEW
from rosplat_ros.view_cameras import decode, view_camera
from rosplat_testing import PATIENCE
from rosplat_testing.messages import encode, encode_move

offscreen = pytest.importorskip(
    "rviz_gaussian_plugin.offscreen", reason="the renderer is not built: no viewer to test"
)

from rviz_gaussian_plugin.viewer.node import Viewer, described  # noqa: E402

Start = Callable[..., subprocess.Popen[str]]

# At the origin, looking along z.
CAMERA = Camera(0, 64, 48, 60.0, 60.0, 32.0, 24.0, np.eye(4))
RED, GREEN = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)


def discs(*colors_and_depths: tuple[tuple[float, float, float], float]) -> Splats:
    """Opaque balls of 10 cm on the camera's axis."""
    n = len(colors_and_depths)
    colors = np.array([color for color, _ in colors_and_depths])
    positions = np.zeros((n, 3))
    positions[:, 2] = [depth for _, depth in colors_and_depths]
    return Splats(
        positions=positions,
        orientations=np.tile([0, 0, 0, 1], (n, 1)),
        scales=np.full((n, 3), 0.1),
        opacities=np.ones(n),
        sh=((colors - 0.5) / 0.28209479177387814)[:, None, :],
    )


def draw(listener: Any, camera: Camera = CAMERA, timeout: float = 0.0) -> Any:
    return listener.call(
        RenderView, "gaussians/render", camera=view_camera(camera), order_timeout=timeout
    )


def pixels(image: Any) -> np.ndarray:
    channels = {"32FC4": 4, "32FC1": 1}[image.encoding]
    assert image.step == image.width * channels * 4
    shape = (image.height, image.width, channels)
    return np.frombuffer(image.data, np.float32).reshape(shape).squeeze()


def await_map(listener: Any, publisher: MapPublisher) -> None:
    """Until the viewer has the publisher's last batch."""

    def arrived() -> bool:
        answer = draw(listener)
        return bool(answer.revision == publisher.revision and answer.map_id == publisher.map_id)

    listener.wait(arrived)


@pytest.fixture
def viewer(start: Start) -> subprocess.Popen[str]:
    """On a graphics card, too, it asks for orders."""
    return start("rviz_gaussian_plugin.viewer", serve="true", order_source="sidecar")


def test_a_picture_is_colour_alpha_and_depth(
    viewer: subprocess.Popen[str], node: Node, listener: Any
) -> None:
    publisher = MapPublisher(node)
    publisher.replace(discs((GREEN, 2.0)))
    await_map(listener, publisher)
    answer = draw(listener)
    assert answer.success
    assert answer.map_complete
    assert answer.splats == 1
    assert answer.order_source
    color, depth = pixels(answer.color), pixels(answer.depth)
    assert color.shape == (48, 64, 4)
    np.testing.assert_allclose(color[24, 32], [0, 0.99, 0, 0.99], atol=0.03)
    assert depth[24, 32] == pytest.approx(2, rel=1e-3)
    assert not color[0, 0].any()
    assert np.isnan(depth[0, 0])


def test_a_panorama_is_drawn_as_the_processor_draws_it(
    viewer: subprocess.Popen[str], node: Node, listener: Any
) -> None:
    splats = discs((RED, 2.0), (GREEN, -3.0))  # ahead and behind
    publisher = MapPublisher(node)
    eye = np.eye(4)
    eye[:3, 3] = (0.2, -0.1, 0.0)
    camera = Camera(0, 80, 40, 40 / math.pi, 40 / math.pi, 40.0, 20.0, eye, model="equirectangular")
    for _ in range(2):  # an edit is seen, too
        splats.positions[:, 1] += 0.3
        publisher.replace(splats)
        await_map(listener, publisher)
        answer = draw(listener, camera)
        assert answer.success, answer.message
        assert answer.map_complete and answer.revision == publisher.revision
        renderer = CpuRenderer(splats)
        warp = Warp(Lens.of_camera(camera))
        expected = take_picture(renderer, warp, eye, depth="expected", alpha=True)
        np.testing.assert_allclose(pixels(answer.color), expected.colour, atol=1e-6)
        depth, solid = pixels(answer.depth), np.isfinite(expected.depth)
        np.testing.assert_allclose(depth[solid], expected.depth[solid], rtol=1e-6)
        assert solid.any() and np.isnan(depth[~solid]).all()
    wide = replace(camera, width=8192, height=8192)
    assert "a panorama of 8192 x 8192 pixels" in draw(listener, wide).message


def test_a_sorter_s_order_is_taken_but_only_for_this_view_and_map(
    viewer: subprocess.Popen[str], node: Node, listener: Any
) -> None:
    publisher = MapPublisher(node)
    publisher.replace(discs((RED, 2.0), (GREEN, 3.0)))
    await_map(listener, publisher)
    orders = node.create_publisher(SplatOrder, "gaussians/order", ORDER)
    revision_off = 0

    def sort(view: ViewCamera) -> None:
        """A sorter that has it backwards, which shows."""
        order = SplatOrder(
            header=view.header, view_id=view.view_id, sequence=view.sequence, backend="backwards",
            map_id=publisher.map_id, revision=publisher.revision - revision_off, sort_time=0.125,
        )  # fmt: skip
        order.slots = [0, 1]
        orders.publish(order)

    node.create_subscription(ViewCamera, "gaussians/view", sort, VIEW)
    listener.wait(lambda: draw(listener, timeout=0.5).order_source == "sidecar (backwards)")
    answer = draw(listener, timeout=30.0)
    assert (answer.order_source, answer.sort_time) == ("sidecar (backwards)", 0.125)
    assert pixels(answer.color)[24, 32, 1] > 0.9  # green, though red is nearer

    revision_off = 1
    elsewhere = replace(CAMERA, cx=31.0)  # to the same camera, the last order is an answer still
    answer = draw(listener, elsewhere, timeout=0.3)
    assert answer.order_source != "sidecar (backwards)"
    assert pixels(answer.color)[24, 32, 0] > 0.8


def test_edits_show(viewer: subprocess.Popen[str], node: Node, listener: Any) -> None:
    publisher = MapPublisher(node)
    publisher.replace(discs((RED, 2.0), (GREEN, 3.0)))
    publisher.upsert(np.array([7]), discs((GREEN, 1.5)))
    await_map(listener, publisher)
    assert pixels(draw(listener).color)[24, 32, 1] > 0.9
    publisher.delete(np.array([7]))
    await_map(listener, publisher)
    assert pixels(draw(listener).color)[24, 32, 0] > 0.9


def test_a_publisher_that_doesn_t_latch_is_heard_and_a_broken_batch_survived(
    viewer: subprocess.Popen[str], node: Node, listener: Any
) -> None:
    publisher = node.create_publisher(GaussianArray, "gaussians", MAP_VOLATILE)
    listener.wait(lambda: publisher.get_subscription_count() == 2)  # and the listener's
    source = MapPublisher(node, topic="elsewhere")
    sent: list[GaussianArray] = []
    source._wire._publisher = SimpleNamespace(publish=sent.append, get_subscription_count=lambda: 0)
    source.replace(discs((RED, 2.0)))
    broken = GaussianArray(map_id="broken", revision=1, count=1_000_000)
    publisher.publish(broken)
    publisher.publish(sent[0])
    await_map(listener, source)
    assert pixels(draw(listener).color)[24, 32, 0] > 0.9
    assert viewer.poll() is None


def test_what_can_t_be_drawn_is_answered_with_the_reason(
    viewer: subprocess.Popen[str], node: Node, listener: Any
) -> None:
    publisher = MapPublisher(node)
    publisher.replace(discs((RED, 2.0)))
    await_map(listener, publisher)
    camera = view_camera(CAMERA)
    camera.header.frame_id = "moon"
    answer = listener.call(RenderView, "gaussians/render", camera=camera)
    assert not answer.success
    assert "moon" in answer.message
    for field, value in (
        ("width", 0),
        ("width", 2**32 - 1),
        ("height", 2**32 - 1),
        ("projection", 9),
        ("fx", float("nan")),
        ("near_clip", -1.0),
    ):
        camera = view_camera(CAMERA)
        setattr(camera, field, value)
        answer = listener.call(RenderView, "gaussians/render", camera=camera)
        assert not answer.success
        assert field in answer.message
    assert draw(listener).success


WITHOUT_DRAWER = """
from rosplat_core.rendering import Rasterizer
from rviz_gaussian_plugin.viewer import command, node

class Renderer(node.Renderer):
    def __init__(self):
        super().__init__()
        self.settings.rasterizer = Rasterizer.TILES

node.Renderer = Renderer
exit(command.main())
"""


def test_who_can_t_draw_at_all_answers_with_the_reason(node: Node, listener: Any) -> None:
    """A driver that is too old for what is asked of it."""
    publisher = MapPublisher(node)
    publisher.replace(discs((GREEN, 2.0)))
    name = ["--ros-args", "-r", f"__ns:={node.get_namespace()}", "-p", "serve:=true"]
    old = os.environ | {"MESA_GL_VERSION_OVERRIDE": "3.0COMPAT"}
    with subprocess.Popen([sys.executable, "-c", WITHOUT_DRAWER, *name], env=old) as process:
        try:
            for _ in range(3):
                answer = draw(listener)
                assert not answer.success
                assert "OpenGL 4.4 is needed to draw splats" in answer.message
            assert process.poll() is None
        finally:
            process.send_signal(signal.SIGINT)
    assert process.returncode == 0


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_it_ends_quietly_in_the_middle_of_a_request(
    start: Start, listener: Any, node: Node, number: signal.Signals
) -> None:
    process = start("rviz_gaussian_plugin.viewer", serve="true", order_source="sidecar")
    pending = listener.request(
        RenderView, "gaussians/render", camera=view_camera(CAMERA), order_timeout=60.0
    )
    listener.wait(lambda: node.count_publishers("gaussians/view"))
    process.send_signal(number)
    output, _ = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0
    assert "Error" not in output
    assert "exception" not in output
    del pending


def test_without_a_display_it_draws_a_still_and_a_turn(
    start: Start, node: Node, listener: Any, tmp_path: Path, random_splats: Callable[..., Splats]
) -> None:
    process = start("rviz_gaussian_plugin.viewer", output=tmp_path / "out")
    assert process.stdout
    said = next(line for line in process.stdout if "waiting" in line)
    assert f"waiting for a map on {node.resolve_topic_name('gaussians')}" in said
    publisher = MapPublisher(node)
    publisher.replace(random_splats(500, 1))
    output, _ = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0
    assert "500 splats" in output
    still = Image.open(tmp_path / "out" / "demo.png")
    assert still.size == (1280, 720)
    assert np.asarray(still).std() > 5
    turn = Image.open(tmp_path / "out" / "demo.webp")
    assert getattr(turn, "n_frames", 1) > 10


def test_a_map_of_any_size_is_drawn(
    start: Start, node: Node, listener: Any, tmp_path: Path
) -> None:
    splats = discs((RED, 2.0), (GREEN, -1e15), (RED, 1e15))
    publisher = MapPublisher(node)
    publisher.replace(splats)
    process = start("rviz_gaussian_plugin.viewer", output=tmp_path)
    listener.wait(lambda: process.poll() is not None)  # meanwhile the publisher is pulled from
    output, _ = process.communicate()
    assert process.returncode == 0, output
    assert "3 splats" in output


def project(camera: Camera, point: np.ndarray) -> np.ndarray:
    x, y, z = camera.world_to_camera[:3, :3] @ point + camera.world_to_camera[:3, 3]
    return np.array([camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy])


@pytest.mark.parametrize("up", [(0, 0, 1), (0, -1, 0), (1, 0, 0), (1, 2, -3)])
def test_the_map_follows_the_mouse(up: tuple[float, float, float]) -> None:
    from rviz_gaussian_plugin.viewer.orbit import OrbitCamera

    target = np.array([1.0, -2.0, 3.0])
    orbit = OrbitCamera(target, distance=4.0, up=np.array(up, float))
    middle = [160, 120]
    camera = orbit.camera(320, 240)
    np.testing.assert_allclose(project(camera, target), middle, atol=1e-6)
    assert np.linalg.norm(camera.position - target) == pytest.approx(4)
    assert project(camera, target + 0.1 * np.array(up))[1] < 120  # up is up

    nearer = target + 0.2 * (camera.position - target)
    orbit.turn(0.2, 0)
    assert project(orbit.camera(320, 240), nearer)[0] > 165
    orbit.turn(-0.2, 0.2)
    assert project(orbit.camera(320, 240), nearer)[1] > 125
    orbit.turn(0, 10)  # as far as it goes
    np.testing.assert_allclose(project(orbit.camera(320, 240), target), middle, atol=1e-6)

    orbit = OrbitCamera(target, distance=4.0, up=np.array(up, float))
    orbit.pan(0.25, -0.125)
    np.testing.assert_allclose(
        project(orbit.camera(320, 240), target), [160 + 60, 120 - 30], atol=1e-6
    )


def test_pictures_wait_for_a_first_view_that_comes_after_the_map() -> None:
    from rviz_gaussian_plugin.viewer import command

    view = object()
    asked: list[str] = []

    def count_publishers(topic: str) -> int:
        asked.append(topic)
        if len(asked) == 3:
            viewer.first_view = view
        return 1

    viewer = SimpleNamespace(
        first_view=None, complete=lambda: True, count_publishers=count_publishers,
        resolve_topic_name=lambda name: f"/{name}",
    )  # fmt: skip
    command._wait_for_map(viewer)
    assert viewer.first_view is view
    assert set(asked) == {"/gaussians/first_view"}


def test_inside_a_map_a_drag_turns_on_the_spot_and_the_wheel_walks() -> None:
    from rosplat_core.first_look import FirstView
    from rviz_gaussian_plugin.viewer.orbit import OrbitCamera

    eye, target, up = np.array([1.0, -2, 1.5]), np.array([4.0, 2, 1.5]), np.array([0, 0, 1.0])
    orbit = OrbitCamera.of(FirstView(eye, target, up, inside=True), 320, 240)
    orbit.turn(0.3, 0.1)
    camera = orbit.camera(320, 240)
    np.testing.assert_allclose(camera.position, eye, atol=1e-9)
    assert project(camera, target)[0] < 150
    orbit.turn(-0.3, -0.1)
    orbit.zoom(0.9)
    np.testing.assert_allclose(
        orbit.camera(320, 240).position, eye + 0.1 * (target - eye), atol=1e-9
    )


@pytest.mark.parametrize("wide", [0.0, 1e-300, 1e12, 1e15, 1e30, 3e38])
@pytest.mark.parametrize("far", [0.0, 1e17, 1e300])
def test_every_map_is_framed_by_a_camera_that_can_be_drawn_from(wide: float, far: float) -> None:
    from rosplat_ros.view_cameras import numbers
    from rviz_gaussian_plugin.viewer.orbit import OrbitCamera, bounds

    def look() -> None:
        camera = orbit.camera(640, 480)
        SplatCamera(*numbers(view_camera(camera)))
        decode(view_camera(camera))

    positions = wide * np.random.default_rng(0).uniform(-1, 1, (1000, 3))
    with np.errstate(over="ignore"):
        centre, radius = bounds(np.add(positions, (2 * far, far, 0)))
    orbit = OrbitCamera(centre, 2.5 * radius, np.array([0.0, 0, 1]))
    look()
    for zoom in (1.5, 0.5):
        for _ in range(300):
            orbit.zoom(zoom)
            orbit.pan(1.0, -1.0)
            orbit.turn(0.5, 0.1)
        look()


def test_a_map_of_groups_is_framed_as_its_splats_lie() -> None:
    """A few thousand of them, but for those that a few far ones are."""
    from rviz_gaussian_plugin.viewer.orbit import bounds

    books = GaussianMap()
    assert bounds(books.sample)[1] == 1
    rng = np.random.default_rng(0)
    positions = rng.uniform(-1, 1, (100_000, 3)).astype(np.float32)
    positions[0] = 1e6
    splats = replace(
        discs(*[(RED, 1.0)] * len(positions)), positions=positions, origin=np.array([4.5e6, 0, 0])
    )
    of = {"header": Header(), "map_id": "map"}
    replaces = GaussianArray.REPLACE
    books.apply(encode(splats, np.arange(len(splats)), revision=1, operation=replaces, **of))
    turn = Pose(orientation=Quaternion(z=0.5**0.5, w=0.5**0.5))
    for revision, centre in ((2, (4.5e6, 0, 0)), (3, (0, 4.5e6, 0))):
        assert 1000 < len(books.sample) <= 4096
        found, radius = bounds(books.sample)
        np.testing.assert_allclose(found, centre, atol=0.1)
        assert radius == pytest.approx(0.98 * 3**0.5, rel=0.02)
        books.apply(encode_move({0: turn}, revision=revision, **of))


@pytest.fixture
def display(monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    with offscreen.ensure_display() as name:
        monkeypatch.setenv("SDL_VIDEODRIVER", "x11")
        yield name


def test_with_a_display_a_window_asks_for_its_view(
    display: str, start: Start, node: Node, listener: Any
) -> None:
    pytest.importorskip("pygame")
    publisher = MapPublisher(node)
    publisher.replace(discs((RED, 2.0)))
    views: list[ViewCamera] = []
    node.create_subscription(ViewCamera, "gaussians/view", views.append, VIEW)
    process = start("rviz_gaussian_plugin.viewer", width=320, height=240, order_source="sidecar")
    listener.wait(lambda: views and views[-1].header.frame_id == "map")
    assert (views[-1].width, views[-1].height) == (320, 240)
    services = [name for name, _ in node.get_service_names_and_types()]
    assert f"{node.get_namespace()}/gaussians/render" not in services  # it wasn't told to serve
    process.send_signal(signal.SIGINT)
    output, _ = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0
    assert "Traceback" not in output


@pytest.fixture
def windowed(
    display: str, node: Node, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Callable[[Callable[[Viewer, ViewCamera], None]], None]]:
    """Shows a map of one splat in a window, and calls a function before each frame."""
    pytest.importorskip("pygame")
    from rviz_gaussian_plugin.viewer.window import show_window

    MapPublisher(node).replace(discs((RED, 2.0)))
    rclpy.init(args=["--ros-args", "-r", f"__ns:={node.get_namespace()}"])
    viewer = Viewer()
    draw_frame = viewer.draw_frame

    def show(before: Callable[[Viewer, ViewCamera], None]) -> None:
        def draw(view_id: str, camera: ViewCamera) -> dict[str, Any]:
            before(viewer, camera)
            return draw_frame(view_id, camera)

        monkeypatch.setattr(viewer, "draw_frame", draw)
        with spinning(viewer, threads=4):
            show_window(viewer)

    yield show
    del viewer.renderer
    rclpy.try_shutdown()


def test_a_closed_window_leaves_its_last_figures(
    windowed: Callable[..., None], capsys: pytest.CaptureFixture[str]
) -> None:
    import pygame

    def close(viewer: Viewer, camera: ViewCamera) -> None:
        if viewer.complete():
            pygame.event.post(pygame.event.Event(pygame.QUIT))

    windowed(close)
    assert "1 splat, 1 in view" in capsys.readouterr().out


def test_a_window_at_rest_is_drawn_anew_for_what_changes_it(
    windowed: Callable[..., None], monkeypatch: pytest.MonkeyPatch
) -> None:
    import pygame

    from rviz_gaussian_plugin.viewer import window

    monkeypatch.setattr(window, "CAPTION", float("inf"))
    shown: list[None] = []  # one for each time
    flip = pygame.display.flip
    monkeypatch.setattr(pygame.display, "flip", lambda: (shown.append(None), flip()))

    def expose(viewer: Viewer) -> None:
        pygame.event.post(pygame.event.Event(pygame.WINDOWEXPOSED))

    def zoom(viewer: Viewer) -> None:
        pygame.event.post(pygame.event.Event(pygame.MOUSEWHEEL, y=1))

    def grow(viewer: Viewer) -> None:
        insert_all(viewer.renderer, discs((RED, 2.0), (GREEN, 3.0)))

    def close(viewer: Viewer) -> None:
        pygame.event.post(pygame.event.Event(pygame.QUIT))

    changes = [expose, zoom, grow, close]
    counts: list[int] = []  # of what was shown, at each frame since the last change

    def change_at_rest(viewer: Viewer, camera: ViewCamera) -> None:
        counts.append(len(shown))
        if viewer.complete() and shown and counts[-20:] == [len(shown)] * 20:
            changes.pop(0)(viewer)
            counts.clear()
            shown.clear()
        elif len(counts) > 1000:  # it never rests, or doesn't show the change
            close(viewer)

    windowed(change_at_rest)
    assert not changes


def test_a_frame_s_time_is_that_of_its_picture() -> None:
    report = {
        "splats": 1, "error": 0.0, "detail_error": "", "order_source": "processor",
        "order_age": 0.0, "sort_time": 0.0, "draw_time": 2e-4, "paint_time": 0.02,
    }  # fmt: skip
    assert "frame 20.0 ms" in described(1, report)
    assert "frame 0.2 ms" in described(1, report | {"paint_time": 0.0})  # a card's


def test_a_drag_turns_a_map_that_still_grows(
    windowed: Callable[..., None], monkeypatch: pytest.MonkeyPatch
) -> None:
    import pygame

    monkeypatch.setattr(Viewer, "complete", lambda viewer: False)
    eyes: list[float] = []

    def drag(viewer: Viewer, camera: ViewCamera) -> None:
        if viewer.renderer.splats:
            eyes.append(camera.pose.position.x)
            turn = (viewer.window_size[1] // 8, 0)
            moved = pygame.event.Event(pygame.MOUSEMOTION, pos=(0, 0), rel=turn, buttons=(1, 0, 0))
            pygame.event.post(moved if len(eyes) < 4 else pygame.event.Event(pygame.QUIT))

    windowed(drag)
    assert len(set(eyes[1:4])) == 3


def test_a_renderer_that_sorts_itself_asks_no_sorter(
    display: str, node: Node, listener: Any
) -> None:
    from rosplat_core.rendering import Rasterizer
    from rviz_gaussian_plugin.viewer.node import ORDER_SOURCES, Viewer

    views: list[ViewCamera] = []
    node.create_subscription(ViewCamera, "gaussians/view", views.append, VIEW)
    sorter = node.create_publisher(SplatOrder, "gaussians/order", VIEW)
    publisher = MapPublisher(node)
    publisher.replace(discs((RED, 2.0)))
    namespace = f"__ns:={node.get_namespace()}"
    rclpy.init(args=["--ros-args", "-r", namespace, "-p", "order_source:=auto"])
    viewer = Viewer()
    viewer.renderer.settings.rasterizer = Rasterizer.TILES
    try:
        with spinning(viewer, threads=4):
            listener.wait(lambda: viewer.complete() and viewer.count_subscribers("gaussians/view"))
            camera = view_camera(CAMERA)
            # Longer than any test waits for something.
            assert viewer.draw_still(camera, "still", order_timeout=1e6)["order_source"] == "gpu"
            view_id = viewer.set_camera(camera, "window")
            assert viewer.draw_frame(view_id, camera)["order_source"] == "gpu"
            viewer.renderer.settings.order = ORDER_SOURCES["sidecar"]
            viewer.draw_frame(view_id, camera)
            listener.wait(lambda: views)
            assert [view.view_id for view in views] == [view_id]  # and before it none
            assert views[0].sequence > 0
            # Who hears views and sorts nothing is told of them all the same.
            viewer.renderer.settings.order = ORDER_SOURCES["auto"]
            node.destroy_publisher(sorter)
            listener.wait(lambda: not viewer.count_publishers("gaussians/order"))
            views.clear()
            viewer.set_camera(camera, "window")
            listener.wait(lambda: views)
            assert (views[0].view_id, views[0].sequence) == (view_id, 0)
    finally:
        del viewer.renderer
        rclpy.try_shutdown()


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("up", []),
        ("up", [0.0, 0.0, 0.0]),
        ("up", [float("nan"), 0.0, 1.0]),
        ("order_source", "unsorted"),
        ("detail", "much"),
    ],
)
def test_a_start_that_makes_no_sense_is_one_line_and_code_1(
    refusal: Callable[..., str], name: str, value: object
) -> None:
    assert name in refusal("rviz_gaussian_plugin.viewer", **{name: value})


def test_a_start_that_fails_late_ends_before_its_display(start: Start, node: Node) -> None:
    topic = node.resolve_topic_name("gaussians")
    profile = {f"qos_overrides.{topic}.subscription.reliability": "much"}
    process = start("rviz_gaussian_plugin.viewer", serve=True, **profile)
    output, _ = process.communicate(timeout=PATIENCE)
    assert process.returncode == 1
    assert output.strip().splitlines()[-1].startswith("viewer: ")
    assert "XIO" not in output


def test_a_folder_that_can_t_be_is_told_before_a_map_comes(start: Start, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    process = start("rviz_gaussian_plugin.viewer", output=tmp_path / "file" / "out")
    output, _ = process.communicate(timeout=PATIENCE)
    assert process.returncode == 1
    last = output.strip().splitlines()[-1]
    assert last == f"viewer: parameter output: {tmp_path}/file/out: Not a directory"


@pytest.mark.parametrize("error", [MemoryError(), RuntimeError("a\nb" * 10**6)])
def test_no_message_ends_it(error: Exception) -> None:
    lines: list[str] = []
    lost: list[Exception] = []

    def fail(*_: object) -> None:
        raise error

    viewer = SimpleNamespace(
        renderer=SimpleNamespace(apply=fail, set_order=fail, read_order=fail),
        get_logger=lambda: SimpleNamespace(
            error=lambda text, **_: lines.append(text), warning=lambda text, **_: lines.append(text)
        ),
        _map=SimpleNamespace(topic="gaussians", pull_again=lambda: lost.append(error)),
        _instance="me",
    )
    viewer._apply = lambda *of: Viewer._apply(viewer, *of)
    Viewer._on_batch(viewer, GaussianArray(), Arrival.HEARD)
    for encoding in (SplatOrder.SLOTS, SplatOrder.SHARED):
        assert not Viewer._on_order(viewer, SplatOrder(view_id="me/view", encoding=encoding))
    assert len(lines) == 3
    assert bool(lost) == isinstance(error, MemoryError)  # all of the map is pulled again
    assert all(line.isprintable() and len(line) < 1000 for line in lines)


def test_a_killed_viewer_leaves_no_display(start: Start, listener: Any, node: Node) -> None:
    process = start("rviz_gaussian_plugin.viewer", serve=True)
    listener.wait(lambda: node.count_subscribers("gaussians") == 2)  # it and the listener
    (server,) = children(process.pid, "Xvfb")
    process.kill()
    process.wait()
    listener.wait(lambda: not Path(f"/proc/{server}").exists())


def children(pid: int, name: str) -> list[int]:
    found = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    return [int(child) for child in found if Path(f"/proc/{child}/comm").read_text() == f"{name}\n"]


def test_the_orbit_of_a_view_sees_what_the_view_does() -> None:
    from rosplat_core.first_look import FirstView
    from rviz_gaussian_plugin.viewer.orbit import OrbitCamera

    for up in ((0, 0, 1), (0, -1, 0), (0.6, -0.8, 0)):
        view = FirstView(np.array([1.0, -2, 3]), np.array([0.5, 0.25, 1]), np.array(up, float), 1.5)
        for size in ((64, 48), (32, 48)):
            expected, found = view.camera(*size), OrbitCamera.of(view, *size).camera(*size)
            np.testing.assert_allclose(found.world_to_camera, expected.world_to_camera, atol=1e-12)


@pytest.mark.parametrize("size", [(160, 90), (90, 160)])
def test_an_orbit_around_a_ball_sees_all_of_it(size: tuple[int, int]) -> None:
    from rviz_gaussian_plugin.viewer.orbit import OrbitCamera

    centre, up = np.array([1.0, 2, 3]), np.array([0.0, 0, 1])
    camera = OrbitCamera.around(centre, 2.0, up, *size).camera(*size)
    distance = np.linalg.norm(camera.position - centre)
    reach = camera.fx * math.tan(math.asin(2.0 / distance))
    assert reach == pytest.approx(min(size) / 2)


@pytest.mark.parametrize("window", [(0, 0), (1, 1), (6000, 6000), (30_000, 2), (1280, 720)])
def test_a_picture_is_drawn_for_any_window(window: tuple[int, int]) -> None:
    from rviz_gaussian_plugin.viewer.window import MOST_PIXELS, picture_size

    width, height = picture_size(*window)
    assert min(width, height) >= 1
    assert width * height <= MOST_PIXELS
    if window == (1280, 720):
        assert (width, height) == window
