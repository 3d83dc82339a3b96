"""The programs camera and compare in processes of their own: what one films, the other reads."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import rclpy
from rclpy.node import Node
from scipy.ndimage import binary_dilation
from scipy.stats import mannwhitneyu
from sensor_msgs.msg import CameraInfo, Image

from rosplat_core.cameras import look_at
from rosplat_core.generated import generate
from rosplat_core.lens_pictures import take_picture
from rosplat_core.lens_warps import Warp
from rosplat_core.lenses import Lens
from rosplat_core.rendering import CpuRenderer
from rosplat_msgs.msg import Comparison
from rosplat_ros.images import from_image, to_bytes, to_image
from rosplat_ros.map_publisher import MapPublisher
from rosplat_testing import PATIENCE, Listener
from rosplat_testing.studio import Log, Studio
from rosplat_tools.cameras import comparison
from rosplat_tools.cameras.calibrations import of_lens
from rosplat_tools.emulation.flight import Flight

SPLATS = generate(3000, seed=2)
EYES = [look_at((6 * np.cos(a), 6 * np.sin(a), 2.0), (0, 0, 0.5)) for a in np.arange(0, 1.5, 0.3)]
LENS = Lens.of_view(160, 120, 1.0)
BARREL = Lens(160, 120, 150.0, 150.0, 80.0, 60.0, "plumb_bob", (-0.2, 0.03, 1e-3, 0, 0))
PINHOLE = {"camera.width": 160, "camera.height": 120, "camera.fov": 1.0}
SENSED = ("pose", "image_raw", "camera_info", "path")  # what demo_sensors has of its camera
RELIABLE = {
    f"qos_overrides./{{}}/{topic}.subscription.reliability": "reliable"
    for topic in ("image_raw", "camera_info", "mask")
}


class Comparer:
    """What compare publishes of a camera's topics, and what it is given in their place."""

    def __init__(self, node: Node, listener: Listener, start: Callable[..., Any]) -> None:
        self.node, self.listener, self._start = node, listener, start
        self.metrics: list[Comparison] = []
        self.rendered: list[Image] = []
        self.difference: list[Image] = []
        node.create_subscription(Comparison, "metrics", self.metrics.append, 10)
        node.create_subscription(Image, "rendered", self.rendered.append, 10)
        node.create_subscription(Image, "difference", self.difference.append, 10)
        self.studio = Studio(node, listener, "")
        self._images = node.create_publisher(Image, "image_raw", 10)
        self._infos = node.create_publisher(CameraInfo, "camera_info", 10)
        self.info: CameraInfo | None = None
        self._masks = node.create_publisher(Image, "mask", 10)

    def start(self, **parameters: object) -> Log:
        namespace = self.node.get_namespace().strip("/")
        reliable = {name.format(namespace): value for name, value in RELIABLE.items()}
        log = Log(self._start("compare", poses="topic", **reliable, **parameters))
        for publisher in (self._images, self._infos, self._masks):
            self.listener.wait(publisher.get_subscription_count)
        return log

    def show(self, image: Image, seconds: int) -> None:
        """Publishes a picture and, as drivers do, the camera's calibration, if it has one."""
        if self.info:
            self._infos.publish(self.info)
        image.header.stamp.sec = seconds
        self._images.publish(image)

    def calibrate(self, lens: Lens) -> None:
        self.info = of_lens(lens)

    def mask(self, mask: np.ndarray) -> None:
        self._masks.publish(to_image(255 * mask.astype(np.uint8), "mono8"))

    def measure(self, image: Image, pose: np.ndarray, seconds: int) -> Comparison:
        """The figures of a picture that is taken now."""
        self.studio.pose(pose, seconds)
        published = (self.metrics, self.rendered, self.difference)

        def came() -> bool:
            if all(each and each[-1].header.stamp.sec == seconds for each in published):
                return True
            self.show(image, seconds)  # again: it may come before what else was sent
            return False

        self.listener.wait(came)
        return self.metrics[-1]


@pytest.fixture
def comparer(node: Node, listener: Listener, start: Callable[..., Any]) -> Comparer:
    return Comparer(node, listener, start)


def picture(splats: Any, lens: Lens, pose: np.ndarray) -> Image:
    colour = take_picture(CpuRenderer(splats), Warp(lens), pose).colour
    return to_image(to_bytes(colour), "rgb8")


def test_what_camera_films_on_a_flight_compare_reads_back(
    node: Node, listener: Listener, start: Callable[..., subprocess.Popen[str]]
) -> None:
    """Until a part of the map is gone, to which the residuals point."""
    namespace = node.get_namespace()
    metrics: list[Comparison] = []
    node.create_subscription(Comparison, "metrics", metrics.append, 10)
    truth = MapPublisher(node, topic="truth")
    truth.replace(SPLATS)
    compared = MapPublisher(node)
    compared.replace(SPLATS)
    flight = Flight.around(SPLATS.positions + SPLATS.origin, 3.0)  # as demo_sensors lays it

    def begin(program: str, names: dict[str, str], **parameters: object) -> None:
        topics = ("camera/image_raw", "camera/camera_info", "robot/pose")
        reliable = {
            f"qos_overrides.{namespace}/{topic}.subscription.reliability": "reliable"
            for topic in topics
        }
        start(program, names, **reliable, **parameters)

    begin(
        "demo_sensors", {f"camera/{name}": f"robot/{name}" for name in SENSED},
        period=flight.period,
    )  # fmt: skip
    begin(
        "camera", {"gaussians": "truth", "camera/pose": "robot/pose"},
        poses="topic", rate=50.0, **PINHOLE,
    )  # fmt: skip
    begin(
        "compare",
        {"image_raw": "camera/image_raw", "camera_info": "camera/camera_info",
         "pose": "robot/pose"},
        poses="topic", attribute=True,
    )  # fmt: skip
    listener.wait(
        lambda: len(metrics) > 10 and _seconds(metrics[-1]) > _seconds(metrics[0]) + flight.period
    )
    for found in metrics:
        assert found.psnr >= 60
        assert found.ssim > 0.999
        assert (found.explained, found.pixels, found.map_id) == (1, 160 * 120, compared.map_id)
        np.testing.assert_allclose(found.gain, 1, atol=0.01)

    nearest = np.linalg.norm(SPLATS.positions + SPLATS.origin - flight.centre, axis=1).argsort()
    gone = np.sort(nearest[:300])
    compared.delete(gone)
    listener.wait(lambda: metrics[-1].psnr < 40)
    known = len(metrics) - 1
    residuals = Listener(
        rclpy.create_node(
            "residuals", namespace=namespace, context=node.context,
            cli_args=["--ros-args", "-r", "gaussians:=residuals"],
        )
    )  # fmt: skip
    residuals.wait(
        lambda: residuals.map is not None and len(residuals.map) == len(SPLATS) - len(gone)
    )
    while _seconds(metrics[-1]) < _seconds(metrics[known]) + 2 * flight.period:
        listener.spin_once()
        residuals.spin_once()
    assert all(found.psnr < 45 and found.explained < 1 for found in metrics[known:])
    _, splats = residuals.map.snapshot()
    values = splats.channels["residual"]
    seen = np.flatnonzero(np.isfinite(values))
    assert len(seen) > 300
    # Where pictures differ in some view: what is seen there now is worse than the rest.
    rest = SPLATS[np.delete(np.arange(len(SPLATS)), gone)]
    renderers = CpuRenderer(SPLATS), CpuRenderer(rest)
    wrong = np.zeros(len(seen), bool)
    for turn in np.arange(0, flight.period, 0.5):
        eye = flight.camera(flight.at(turn), 160, 120).world_to_camera
        whole, lacking = (take_picture(each, Warp(LENS), eye).colour for each in renderers)
        differs = binary_dilation(comparison.errors(whole, lacking) > 0.1)
        places = (splats.positions[seen] + splats.origin) @ eye[:3, :3].T + eye[:3, 3]
        x, y = np.rint(LENS.project(places)).astype(int).T.clip(0, [[159], [119]])
        wrong |= differs[y, x]
    of_wrong, of_rest = values[seen][wrong], values[seen][~wrong]
    pairs = len(of_wrong) * len(of_rest)
    # The chance that the worse one of two is one of them: 0.76 to 0.81 in five runs.
    assert mannwhitneyu(of_wrong, of_rest).statistic / pairs > 0.65


def _seconds(found: Comparison) -> float:
    return found.header.stamp.sec + 1e-9 * found.header.stamp.nanosec


def test_a_lens_an_exposure_and_a_mask(node: Node, comparer: Comparer) -> None:
    MapPublisher(node).replace(SPLATS)
    comparer.start()
    comparer.calibrate(BARREL)
    image = picture(SPLATS, BARREL, EYES[0])
    found = comparer.measure(image, EYES[0], 1)
    assert (found.psnr, found.explained) == (Comparison.MOST_PSNR, 1.0)
    np.testing.assert_array_equal(from_image(comparer.rendered[-1]), from_image(image))
    assert not from_image(comparer.difference[-1]).any()

    darker = (0.7 * from_image(image) + 20).astype(np.uint8)
    found = comparer.measure(to_image(darker, "rgb8"), EYES[0], 2)
    np.testing.assert_allclose(found.gain, 0.7, atol=0.02)
    assert found.fitted_psnr > 45 > 35 > found.psnr

    covered, mask = from_image(image).copy(), np.ones((120, 160), bool)
    covered[:30], mask[:30] = (255, 0, 255), False
    assert comparer.measure(to_image(covered, "rgb8"), EYES[0], 3).psnr < 20
    comparer.mask(mask)
    second = 4
    while (found := comparer.measure(to_image(covered, "rgb8"), EYES[0], second)).psnr < 20:
        comparer.mask(mask)  # again: it may come before compare hears it
        second += 1
    assert (found.psnr, found.pixels) == (Comparison.MOST_PSNR, 90 * 160)


def test_residuals_outlive_edits_elsewhere(node: Node, comparer: Comparer) -> None:
    """They are in the map's own slots, and go with what is deleted and written."""
    publisher = MapPublisher(node)
    slots = np.arange(len(SPLATS)) + 5000
    publisher.replace(SPLATS[:0])
    publisher.upsert(slots, SPLATS)
    comparer.start(attribute=True)
    comparer.calibrate(LENS)
    darker = to_image((0.7 * from_image(picture(SPLATS, LENS, EYES[0]))).astype(np.uint8), "rgb8")
    residuals = Listener(
        rclpy.create_node(
            "residuals", namespace=node.get_namespace(), context=node.context,
            cli_args=["--ros-args", "-r", "gaussians:=residuals"],
        )
    )  # fmt: skip
    second = 0

    def until(holds: Callable[[dict[int, float]], bool]) -> dict[int, float]:
        """Residuals by slot, once they are as that says."""
        nonlocal second
        while True:
            second += 1
            comparer.measure(darker, EYES[0], second)
            residuals.spin_once()
            if residuals.map is None or not len(residuals.map):
                continue
            at, splats = residuals.map.snapshot()
            values = splats.channels.get("residual", np.full(len(at), np.nan))
            found = dict(zip(np.array(at).tolist(), values.tolist(), strict=True))
            if holds(found):
                return found

    first = until(lambda found: np.isfinite(list(found.values())).sum() > 300)
    assert first.keys() == set(slots.tolist())
    seen = [slot for slot, value in first.items() if np.isfinite(value)]
    gone, black = seen[:20], seen[20:40]
    dark = SPLATS[np.array(black) - 5000]
    dark.sh[:] = -2
    publisher.delete(np.array(gone))
    publisher.upsert(np.array(black), dark)
    publisher.upsert(range(9000, 9020), SPLATS[np.array(gone) - 5000])  # beyond what there was
    later = until(lambda found: found.keys() >= set(range(9000, 9020)))
    assert later.keys() == first.keys() - set(gone) | set(range(9000, 9020))
    kept = np.array([(first[slot], later[slot]) for slot in seen[40:]])
    assert (np.abs(kept[:, 0] - kept[:, 1]) < 0.02).mean() > 0.9


def test_rectified_pictures_are_compared_by_r_and_p(node: Node, comparer: Comparer) -> None:
    MapPublisher(node).replace(SPLATS)
    comparer.start(rectified=True)
    angle = 0.05
    turn = np.array(
        [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
    )
    info = of_lens(BARREL)
    info.r, info.p[0], info.p[5], info.p[2], info.p[6] = turn.ravel(), 120.0, 121.0, 75.0, 62.0
    comparer.info = info
    turned = np.eye(4)
    turned[:3, :3] = turn
    image = picture(SPLATS, Lens(160, 120, 120.0, 121.0, 75.0, 62.0), turned @ EYES[0])
    assert comparer.measure(image, EYES[0], 1).psnr >= 60


def test_what_cannot_be_compared_is_said_and_passes(node: Node, comparer: Comparer) -> None:
    log = comparer.start()
    image = picture(SPLATS, LENS, EYES[0])

    def shows(said: str, second: int, shown: Image = image) -> None:
        comparer.show(shown, second)
        comparer.listener.wait(lambda: log.has(said))

    shows("no map has come yet", 1)
    publisher = MapPublisher(node)
    publisher.replace(SPLATS)
    comparer.studio.pose(EYES[0], 10)
    comparer.studio.pose(EYES[0], 20)
    # The map and the poses come when they do.
    while not log.has("no CameraInfo has come on camera_info"):
        comparer.show(image, 11)
        comparer.listener.spin_once()
    shows("after all poses that are known", 25)
    comparer.calibrate(Lens.of_view(320, 240, 1.0))
    while not log.has("a picture is 160 x 120, camera_info says 320 x 240"):
        comparer.show(image, 12)
        comparer.listener.spin_once()
    comparer.calibrate(LENS)
    odd = to_image(from_image(image), "rgb8")
    odd.encoding = "yuv422"
    while not log.has("encoding is 'yuv422', known are rgb8"):
        comparer.show(odd, 13)
        comparer.listener.spin_once()
    assert not comparer.metrics
    assert comparer.measure(image, EYES[0], 14).psnr >= 60
    assert not any("Traceback" in line for line in log.lines)


@pytest.mark.parametrize(
    ("parameter", "value", "said"),
    [
        ("mask", "/nowhere.png", "mask /nowhere.png: No such file or directory"),
        ("mask", __file__, "no picture"),
        ("far", 0.001, "parameters near, far: 0.01 is not less than 0.001"),
    ],
)
def test_a_mistake_is_one_line(
    start: Callable[..., subprocess.Popen[str]], parameter: str, value: object, said: str
) -> None:
    process = start("compare", **{"poses": "topic", parameter: value})
    log, _ = process.communicate(timeout=PATIENCE)
    assert process.returncode == 1
    lines = [line for line in log.splitlines() if "[INFO]" not in line]
    assert len(lines) == 1 and lines[0].startswith("compare: ") and said in lines[0]
