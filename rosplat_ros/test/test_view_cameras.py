"""Cameras as messages: what a camera's message says comes back, and nonsense is refused."""

import pytest

from rosplat_core.cameras import Camera, look_at
from rosplat_core.posed_camera import CameraError
from rosplat_ros.view_cameras import decode, numbers, view_camera

CAMERA = Camera(0, 640, 480, 500.0, 510.0, 320.0, 240.0, look_at((1, 2, 3), (0, 0, 0)))


def test_a_camera_comes_back() -> None:
    position, orientation, projection, *values = numbers(view_camera(CAMERA))
    assert position == tuple(CAMERA.position)
    assert orientation == tuple(CAMERA.orientation)
    assert projection == 0
    assert values[:6] == [500.0, 510.0, 320.0, 240.0, 640, 480]
    decode(view_camera(CAMERA))


def test_an_unknown_projection_is_refused() -> None:
    message = view_camera(CAMERA)
    message.projection = 7
    with pytest.raises(CameraError, match="projection is 7"):
        decode(message)
