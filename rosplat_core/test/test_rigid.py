"""Transforms that are nearly rigid become so; others are refused."""

import logging
from types import SimpleNamespace

import numpy as np
import pytest

from rosplat_core import rigid
from rosplat_core.cameras import Camera, look_at

POSE = look_at((3, 1, 2), (0, 0, 0))


def scaled(by: float) -> np.ndarray:
    pose = POSE.copy()
    pose[:3, :3] *= by
    pose[:3, 3] *= by  # as whole, so the place stays
    return pose


def test_a_rotation_that_is_slightly_off(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rigid, "_said", [])
    for _ in range(2):
        camera = Camera(0, 640, 480, 500, 500, 320, 240, scaled(1.0002))  # as 7-Scenes'
        np.testing.assert_allclose(camera.world_to_camera, POSE, atol=1e-12)
    assert [record.levelno for record in caplog.records] == [logging.WARNING]
    assert "off by 0.0004; the nearest one is taken" in caplog.text
    np.testing.assert_array_equal(rigid.rigid(POSE, "pose"), POSE)  # to the bit


@pytest.mark.parametrize(
    ("pose", "reason"),
    [
        (scaled(1.006), "pose: expected a rotation"),
        (np.diag([1.0, 1, -1, 1]), "pose: expected a rotation"),
        ([[1e308, -1e308, 0, 0], [1e308, 1e308, 0, 0], *np.eye(4)[2:].tolist()], "expected a rot"),
        (np.full((4, 4), np.nan), "4x4 finite"),
        (np.eye(3), r"4x4 finite numbers, got shape \(3, 3\)"),
        ("here", "4x4 finite numbers, got str"),
    ],
)
def test_what_is_no_pose(pose: object, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        rigid.rigid(pose, "pose")


def test_a_camera_of_ros() -> None:
    """For ROS the centre of the first pixel is (0, 0), for us (0.5, 0.5)."""
    k = [500.0, 0, 319.5, 0, 510, 239.5, 0, 0, 1]
    p = [400.0, 0, 300, 0, 0, 410, 200, 0, 0, 0, 1, 0]
    info = SimpleNamespace(width=640, height=480, k=k, p=[0.0] * 12)
    camera = Camera.from_camera_info(info)
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (500, 510, 320, 240)
    info.p = p
    camera = Camera.from_camera_info(info, POSE, 7)
    assert (camera.id, camera.fx, camera.fy, camera.cx, camera.cy) == (7, 400, 410, 300.5, 200.5)
    np.testing.assert_array_equal(camera.world_to_camera, POSE)
    with pytest.raises(ValueError, match="no CameraInfo with width, height, p and k"):
        Camera.from_camera_info(np.eye(3))
