"""The first view that publishers of scenes offer, and the frame that scenes stand upright in."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rclpy.node import Node
from scipy.spatial.transform import Rotation

from rosplat_core import formats
from rosplat_core.first_look import first_view
from rosplat_core.generated import generate
from rosplat_msgs.msg import FirstView
from rosplat_ros.first_views import first_view_message, read_first_view
from rosplat_ros.qos import LATCHED

Start = Callable[..., subprocess.Popen[str]]


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """A garden whose vertical is -y, which its file doesn't tell."""
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler("x", 90, degrees=True).as_matrix()
    formats.save(tmp_path / "garden.splat", generate(5000, scene="garden").moved(pose))
    return tmp_path / "garden.splat"


def test_a_view_survives_its_message() -> None:
    view = first_view(generate(500), (0, 0, 1))
    message = first_view_message(view, "map", FirstView().header.stamp)
    found = read_first_view(message)
    for name in ("eye", "target", "up", "width"):
        np.testing.assert_array_equal(getattr(found, name), getattr(view, name))
    message.up.x = float("nan")
    with pytest.raises(ValueError, match="not finite"):
        read_first_view(message)


def test_a_view_is_offered_with_the_map(
    node: Node, start: Start, listener: Any, scene: Path
) -> None:
    views: list[FirstView] = []
    node.create_subscription(FirstView, "gaussians/first_view", views.append, LATCHED)
    start("ply_publisher", path=scene, frame_id="scene")
    listener.wait_for(5000)
    listener.wait(lambda: views)
    assert views[-1].header.frame_id == "scene"
    assert -views[-1].up.y == pytest.approx(1, abs=1e-3)
    assert views[-1].eye.y < 0  # above the ground


def test_a_scene_is_stood_upright_by_a_transform(
    node: Node, start: Start, listener: Any, scene: Path
) -> None:
    tf2_msgs = pytest.importorskip("tf2_msgs.msg", reason="no tf2_msgs here")
    stands: list[Any] = []
    node.create_subscription(tf2_msgs.TFMessage, "/tf_static", stands.append, LATCHED)
    frame = node.get_namespace().strip("/")
    start("ply_publisher", path=scene, frame_id=frame, upright_frame="map")
    listener.wait(lambda: any(heard.transforms[0].child_frame_id == frame for heard in stands))
    listener.wait_for(5000)
    (transform,) = next(
        heard.transforms
        for heard in reversed(stands)
        if heard.transforms[0].child_frame_id == frame
    )
    assert (transform.header.frame_id, transform.child_frame_id) == ("map", frame)
    turn = transform.transform.rotation
    upright = Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).apply([0, -1, 0])
    np.testing.assert_allclose(upright, [0, 0, 1], atol=0.03)


@pytest.mark.parametrize("up", ["0 1", "a b c", "0 0 0", "1 1 inf"])
def test_an_up_that_is_no_direction_is_named(refusal: Callable[..., str], up: str) -> None:
    assert "parameter up" in refusal("ply_publisher", up=up)
