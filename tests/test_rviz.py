"""The Display in a real rviz2: beside other displays, in its frame, with and without a sidecar."""

from __future__ import annotations

import math
import os
import shutil
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

pytestmark = [
    pytest.mark.rviz,
    pytest.mark.skipif(not shutil.which("rviz2"), reason="no rviz2: the Display is not tested"),
]

CONFIG = """\
Panels: []
Visualization Manager:
  Displays:
    - {{Class: rviz_default_plugins/Marker, Name: Marker, Enabled: true, Value: true, Topic: {{
        Value: /marker, Durability Policy: Transient Local, Depth: 5}}}}
    - {{Class: rviz_gaussian_plugin/GaussianMap, Name: Map, Enabled: true, Value: true,
       Topic: /gaussians{properties}}}
  Global Options: {{Fixed Frame: map, Background Color: 0; 0; 0, Frame Rate: 30}}
  Tools:
    - {{Class: rviz_default_plugins/PublishPoint, Single click: false, Topic: {{
        Value: /clicked_point}}}}
  Views:
    Current: {{Class: rviz_default_plugins/TopDownOrtho, Scale: 100, X: 0, Y: 0, Angle: 0}}
Window Geometry: {{Width: 1000, Height: 800}}
"""


CROP = 100  # [px]


class Rviz:
    """rviz2 on a screen of its own, and a node that feeds it."""

    def __init__(self, folder: Path, properties: str = "") -> None:
        import rclpy
        from geometry_msgs.msg import TransformStamped
        from rclpy.node import Node
        from rclpy.qos import DurabilityPolicy, QoSProfile
        from tf2_msgs.msg import TFMessage
        from visualization_msgs.msg import Marker

        from rosplat_tools.map_publisher import MapPublisher
        from rosplat_tools.processes import Processes
        from rviz_gaussian_plugin.offscreen import ensure_display

        self._display = ensure_display(1000, 800)
        self.display = self._display.__enter__()
        rclpy.init()
        self.node = Node("rviz_test")
        latched = QoSProfile(depth=5, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._tf = self.node.create_publisher(TFMessage, "/tf_static", latched)
        self._marker = self.node.create_publisher(Marker, "/marker", latched)
        self._transform, self._marker_type = TransformStamped, Marker
        self.map = MapPublisher(self.node, frame_id="scene")
        config = folder / "test.rviz"
        config.write_text(CONFIG.format(properties=properties))
        self.processes = Processes(folder / "log").__enter__()
        self.processes.start("rviz2", ["rviz2", "-d", str(config)], LIBGL_ALWAYS_SOFTWARE="1")

    def close(self) -> None:
        import rclpy

        self.processes.end()
        self.node.destroy_node()
        rclpy.shutdown()
        self._display.__exit__(None, None, None)

    def place_scene(self, x: float, yaw: float = 0.0) -> None:
        from tf2_msgs.msg import TFMessage

        transform = self._transform()
        transform.header.frame_id, transform.child_frame_id = "map", "scene"
        transform.transform.translation.x = x
        transform.transform.rotation.z = math.sin(yaw / 2)
        transform.transform.rotation.w = math.cos(yaw / 2)
        self._tf.publish(TFMessage(transforms=[transform]))

    def place_cube(self, z: float) -> None:
        """A green cube of 1 m at x = y = 0."""
        cube = self._marker_type(type=self._marker_type.CUBE)
        cube.header.frame_id = "map"
        cube.pose.position.z = z
        cube.pose.orientation.w = 1.0
        cube.scale.x = cube.scale.y = cube.scale.z = 1.0
        cube.color.g = cube.color.a = 1.0
        self._marker.publish(cube)

    def click(self, row: int, column: int) -> None:
        subprocess.run(
            ["xdotool", "mousemove", str(column), str(row + CROP), "click", "1"],
            env=os.environ | {"DISPLAY": self.display},
            check=True,
        )

    def screen(self) -> np.ndarray:
        from PIL import ImageGrab

        screen = np.asarray(ImageGrab.grab(xdisplay=self.display).convert("RGB")).astype(int)
        return screen[CROP:-60]  # without tools and status bar

    def until(self, found: Callable[[np.ndarray], bool], seconds: float = 60.0) -> np.ndarray:
        """The first screen on which something is found."""
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            self.processes.check()
            screen = self.screen()
            if found(screen):
                return screen
            time.sleep(0.2)
        raise AssertionError("not seen on the screen: " + self.processes.said("rviz2")[-500:])


@pytest.fixture
def rviz(tmp_path: Path) -> Iterator[Rviz]:
    rviz = Rviz(tmp_path)
    yield rviz
    rviz.close()


def disc(colour: tuple[float, float, float], x: float = 0.0, z: float = 0.0, sigma: float = 1.0):
    """An opaque splat, wide in x and y."""
    from rosplat_tools.splats import Splats

    return Splats(
        positions=np.array([[x, 0, z]], np.float32),
        orientations=np.array([[0, 0, 0, 1]], np.float32),
        scales=np.array([[sigma, sigma, 0.01]], np.float32),
        opacities=np.ones(1, np.float32),
        sh=((np.array([[colour]], np.float32) - 0.5) / 0.28209479).astype(np.float32),
    )


def red(screen: np.ndarray) -> np.ndarray:
    return (screen[..., 0] > 150) & (screen[..., 1] < 60) & (screen[..., 2] < 60)


def green(screen: np.ndarray) -> np.ndarray:
    return (screen[..., 1] > 100) & (screen[..., 0] < 60) & (screen[..., 2] < 60)


def blue(screen: np.ndarray) -> np.ndarray:
    return (screen[..., 2] > 150) & (screen[..., 0] < 60) & (screen[..., 1] < 60)


def centre(mask: np.ndarray) -> np.ndarray:
    return np.argwhere(mask).mean(axis=0)


def test_splats_and_markers_hide_each_other(rviz: Rviz) -> None:
    rviz.place_scene(0)
    rviz.place_cube(z=1.0)  # seen from above: before the splat
    rviz.map.replace(disc((1, 0, 0)))
    screen = rviz.until(lambda s: red(s).sum() > 3000 and green(s).sum() > 3000)
    cube = centre(green(screen)).astype(int)
    assert green(screen)[cube[0], cube[1]]
    rviz.place_cube(z=-1.0)  # behind it
    rviz.until(lambda s: red(s)[cube[0], cube[1]])


def test_the_map_follows_its_frame(rviz: Rviz) -> None:
    rviz.map.replace(disc((1, 0, 0), x=1.0, sigma=0.2))
    time.sleep(3)
    assert not red(rviz.screen()).any(), "drawn although nobody knows where its frame is"
    rviz.place_scene(0)
    before = centre(red(rviz.until(lambda s: red(s).sum() > 300)))
    rviz.place_scene(1.0)
    moved = centre(red(rviz.until(lambda s: np.abs(centre(red(s)) - before).max() > 50))) - before
    assert np.abs(moved).max() == pytest.approx(100, abs=3)  # 1 m at 100 px/m
    rviz.place_scene(0, yaw=math.pi)
    turned = centre(red(rviz.until(lambda s: np.abs(centre(red(s)) - before).max() > 150)))
    assert np.abs(turned - before).max() == pytest.approx(200, abs=3)


def test_the_picture_outlives_its_sidecar(rviz: Rviz) -> None:
    """A near blue over a far red disc, whatever sorts and although the slots say otherwise."""
    from rosplat_tools.splats import concatenate

    sorter = rviz.processes.node("rosplat_sorter", "sorter")
    rviz.place_scene(0)
    rviz.map.replace(concatenate([disc((0, 0, 1), z=1.0, sigma=0.5), disc((1, 0, 0), sigma=0.8)]))
    spot = centre(blue(rviz.until(lambda s: blue(s).sum() > 3000))).astype(int)
    sorter.kill()
    sorter.wait()
    rviz.processes.forget(sorter)
    time.sleep(1)
    # An edit that no sidecar will ever sort: green in between.
    rviz.map.upsert(range(2, 3), disc((0, 1, 0), z=0.5, sigma=1.5))
    screen = rviz.until(lambda s: green(s).any())
    assert blue(screen)[spot[0], spot[1]]


def test_a_growing_and_shrinking_map(rviz: Rviz) -> None:
    rviz.place_scene(0)
    rviz.map.replace(disc((1, 0, 0), x=-1.0, sigma=0.2))
    rviz.until(lambda s: red(s).sum() > 300)
    rviz.map.upsert(range(1, 2), disc((0, 0, 1), x=1.0, sigma=0.2))
    rviz.until(lambda s: red(s).sum() > 300 and blue(s).sum() > 300)
    rviz.map.delete(range(1))
    rviz.until(lambda s: not red(s).any() and blue(s).sum() > 300)
    rviz.map.upsert(range(1), disc((0, 1, 0), x=-1.0, sigma=0.2))
    rviz.until(lambda s: green(s).sum() > 300 and blue(s).sum() > 300)


def test_garbage_does_not_end_rviz(rviz: Rviz) -> None:
    from rosplat_msgs.msg import GaussianArray, SplatOrder
    from rosplat_tools.qos import MAP, ORDER

    garbage = rviz.node.create_publisher(GaussianArray, "gaussians", MAP)
    orders = rviz.node.create_publisher(SplatOrder, "gaussians/order", ORDER)
    rviz.place_scene(0)
    for revision, message in enumerate(
        [
            GaussianArray(count=5),
            GaussianArray(count=5, positions=[math.nan] * 15, sh_degree=7),
            GaussianArray(operation=9),
            GaussianArray(operation=1, first_slot=2**32 - 1, count=2**32 - 1),
            GaussianArray(operation=2, count=2**32 - 1),
        ]
    ):
        message.map_id, message.revision = "garbage", revision + 1
        garbage.publish(message)
    orders.publish(SplatOrder(view_id="nobody", map_id="?", slots=[2**32 - 1]))
    time.sleep(2)
    rviz.node.destroy_publisher(garbage)
    rviz.map.replace(disc((1, 0, 0)))
    rviz.until(lambda s: red(s).sum() > 3000)


@pytest.mark.skipif(not shutil.which("xdotool"), reason="no xdotool to click with")
def test_mouse_tools_touch_the_splats(rviz: Rviz) -> None:
    """Publish Point lands on the disc, 0.7 m above the ground, not in the void behind it."""
    import rclpy
    from geometry_msgs.msg import PointStamped

    points: list[PointStamped] = []
    rviz.node.create_subscription(PointStamped, "/clicked_point", points.append, 10)
    rviz.place_scene(0)
    rviz.map.replace(disc((1, 0, 0), x=0.5, z=0.7, sigma=0.3))
    screen = rviz.until(lambda s: red(s).sum() > 1000)
    row, column = centre(red(screen)).astype(int)
    deadline = time.monotonic() + 20
    while not points and time.monotonic() < deadline:
        rviz.click(row, column)
        for _ in range(20):
            rclpy.spin_once(rviz.node, timeout_sec=0.05)
    assert points, "nothing was touched"
    assert points[-1].header.frame_id == "map"
    assert points[-1].point.x == pytest.approx(0.5, abs=0.03)
    assert points[-1].point.y == pytest.approx(0.0, abs=0.03)
    assert points[-1].point.z == pytest.approx(0.7, abs=0.02)
