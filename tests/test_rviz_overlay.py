"""The map over a real camera's picture, live: rviz's own Camera display draws it from there."""

from __future__ import annotations

import numpy as np
import pytest

from rosplat_core.splats import Splats
from rviz_harness import Rviz, World, configuration, display, map_display, needs_rviz

pytestmark = needs_rviz

WIDTH, HEIGHT = 240, 180
FX, FY, CX, CY = 210.0, 200.0, 100.0, 75.0  # the principal point off the middle
DISTANCE = 4.0  # [m]
GREY = 128  # of the real camera's picture


def cloud(count: int = 300) -> Splats:
    """Splats of all sizes, opacities and colours in a ball of 1 m."""
    random = np.random.default_rng(2)
    orientations = random.normal(size=(count, 4))
    return Splats(
        positions=random.normal(scale=0.4, size=(count, 3)).astype(np.float32),
        orientations=(orientations / np.linalg.norm(orientations, axis=1, keepdims=True)).astype(
            np.float32
        ),
        scales=random.uniform(0.01, 0.2, size=(count, 3)).astype(np.float32),
        opacities=random.uniform(size=count).astype(np.float32),
        sh=random.normal(scale=0.8, size=(count, 4, 3)).astype(np.float32),
    )


class RealCamera:
    """A camera in TF that looks at the map from below, and what it publishes."""

    def __init__(self, world: World) -> None:
        from sensor_msgs.msg import CameraInfo, Image

        self.world = world
        self.frame = f"camera_of_{world.frame}"
        self._image = world.node.create_publisher(Image, "/camera/image_raw", 5)
        self._info = world.node.create_publisher(CameraInfo, "/camera/camera_info", 5)
        self._image_type, self._info_type = Image, CameraInfo
        world.place(0)
        world.place(frame=self.frame, z=-DISTANCE)  # its z is forward

    def publish(self, pixels: np.ndarray) -> None:
        """One picture, (HEIGHT, WIDTH, 3) bytes, and its calibration."""
        image = self._image_type(width=WIDTH, height=HEIGHT, encoding="rgb8", step=3 * WIDTH)
        image.header.frame_id = self.frame
        image.header.stamp = self.world.node.get_clock().now().to_msg()
        image.data.frombytes(pixels.astype(np.uint8).tobytes())
        info = self._info_type(header=image.header, width=WIDTH, height=HEIGHT)
        info.k = [FX, 0.0, CX, 0.0, FY, CY, 0.0, 0.0, 1.0]
        info.p = [FX, 0.0, CX, 0.0, 0.0, FY, CY, 0.0, 0.0, 0.0, 1.0, 0.0]
        self._info.publish(info)
        self._image.publish(image)

    def render(self, width: int, height: int) -> np.ndarray:
        """(height, width, 4) the map from there as a panel of that size shows it, by the service.

        The picture fills the panel as far as its shape lets it, in its middle.
        """
        from rosplat_msgs.msg import ViewCamera
        from rosplat_msgs.srv import RenderView

        scale = min(width / (WIDTH / FX), height / (HEIGHT / FY))  # [px] of the panel
        zoom_x, zoom_y = scale / FX, scale / FY
        camera = ViewCamera(
            fx=scale,
            fy=scale,
            cx=width / 2 + (CX - WIDTH / 2) * zoom_x,
            cy=height / 2 + (CY - HEIGHT / 2) * zoom_y,
            width=width,
            height=height,
            near_clip=0.01,
            far_clip=1000.0,
        )
        camera.header.frame_id = self.frame
        camera.pose.orientation.w = 1.0
        client = self.world.node.create_client(RenderView, "/gaussians/render")
        self.world.spin_until(client.service_is_ready)
        answers = []

        def drawn() -> bool:  # rviz2 may hear of the picture before it hears of the frame
            future = client.call_async(RenderView.Request(camera=camera))
            self.world.spin_until(future.done)
            answers.append(future.result())
            return answers[-1].success or "no transform" not in answers[-1].message

        self.world.spin_until(drawn)
        assert answers[-1].success, answers[-1].message
        return np.frombuffer(answers[-1].color.data, np.float32).reshape(height, width, 4)


def decibels(picture: np.ndarray, expected: np.ndarray) -> float:
    return float(-10 * np.log10(np.mean((picture - expected) ** 2) + 1e-300))


@pytest.fixture
def camera(rviz: Rviz, world: World) -> RealCamera:
    """The map in rviz's Camera display, before the picture of a real camera."""
    rviz.load(
        configuration(
            map_display(), display("Camera", "Camera", Topic={"Value": "/camera/image_raw"})
        )
    )
    world.map.replace(cloud())
    return RealCamera(world)


@pytest.mark.parametrize("alpha", [0.0, 0.25])
def test_the_map_is_drawn_over_the_picture_from_where_the_camera_is(
    rviz: Rviz, world: World, camera: RealCamera, alpha: float
) -> None:
    """As the service draws it for the same camera; then the picture over it once more."""
    rviz.set("Camera", "Overlay Alpha", value=alpha)
    grey = np.full((HEIGHT, WIDTH, 3), GREY)
    rviz.until(lambda s: camera.publish(grey) or framed(s).sum() > 20000, "Camera")
    width, height = rviz.ask("places")["Camera"][2:]
    rgba = camera.render(width, height)
    assert rgba[..., 3].max() > 0.9
    over = np.clip(rgba[..., :3] + (1 - rgba[..., 3:]) * (GREY / 255), 0, 1)
    expected = alpha * GREY / 255 + (1 - alpha) * over

    def alike(picture: np.ndarray) -> bool:
        inside = framed(picture)
        return decibels(picture[inside] / 255, expected[inside]) > 45

    rviz.until(alike, "Camera")
    # The renderer is made anew while the panel's OpenGL context lives on.
    rviz.ask("reset", path=["Map"])
    rviz.until_status("Map", "Order", "Ok")
    rviz.until(alike, "Camera")


def framed(picture: np.ndarray) -> np.ndarray:
    """Where the real camera's picture is, but for its edge: rows and columns that show its grey."""
    grey = (np.abs(picture - GREY) <= 1).all(axis=-1)
    inside = np.zeros_like(grey)
    if grey.any():
        top, bottom = np.flatnonzero(grey.any(axis=1))[[0, -1]]
        left, right = np.flatnonzero(grey.any(axis=0))[[0, -1]]
        inside[top + 2 : bottom - 1, left + 2 : right - 1] = True
    return inside
