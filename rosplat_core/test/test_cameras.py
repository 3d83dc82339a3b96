"""Cameras: read and written whole, refused by name, and put where they see the scene."""

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from rosplat_core.cameras import (
    Camera,
    load_cameras,
    load_trajectory,
    look_at,
    orbit,
    save_cameras,
)
from rosplat_core.rendering import pose
from rosplat_core.splats import InputError

points = st.tuples(*[st.floats(-100, 100)] * 3)


def camera() -> Camera:
    return Camera(7, 640, 480, 500, 510, 320, 240, look_at((3, 1, 2), (0, 0, 0)), image="7.png")


def test_round_trip(tmp_path: Path) -> None:
    written = [camera(), replace(camera(), orthographic=True, near=0.5, far=20.0, image=None)]
    save_cameras(tmp_path / "cameras.json", written)
    for one, other in zip(load_cameras(tmp_path / "cameras.json"), written, strict=True):
        np.testing.assert_array_equal(one.world_to_camera, other.world_to_camera)
        assert one.orthographic == other.orthographic
        assert (one.fy, one.near, one.far, one.image) == (
            other.fy,
            other.near,
            other.far,
            other.image,
        )


def test_numbers_may_be_of_numpy(tmp_path: Path) -> None:
    k = np.array([[525, 0, 319.5], [0, 524, 239.5], [0, 0, 1]], np.float32)
    height, width = np.empty((480, 640)).shape
    seen = Camera(
        np.int64(3), np.int64(width), height, k[0, 0], k[1, 1], k[0, 2], k[1, 2], np.eye(4)
    )
    save_cameras(tmp_path / "cameras.json", [seen])
    (read,) = load_cameras(tmp_path / "cameras.json")
    assert (read.id, read.width, read.fx, read.cy) == (3, 640, 525.0, 239.5)


def test_pose_and_position_invert_the_transform() -> None:
    np.testing.assert_allclose(camera().position, (3, 1, 2))
    np.testing.assert_allclose(
        camera().camera_to_world @ camera().world_to_camera, np.eye(4), atol=1e-12
    )


def test_a_rotation_of_few_digits_far_away_leaves_the_camera_in_its_place() -> None:
    place = np.array([4.5e5, 5.2e6, 30.0])
    rounded = look_at(place, place + np.array([1, 2, 0.5]))
    rounded[:3, :3] = rounded[:3, :3].round(5)
    rounded[:3, 3] = -rounded[:3, :3] @ place
    found = replace(camera(), world_to_camera=rounded)
    np.testing.assert_allclose(found.position, place, atol=1e-6)
    rounded[:] = 0  # a camera keeps its own numbers
    np.testing.assert_allclose(found.position, place, atol=1e-6)


def test_a_panorama_is_read_where_it_is_expected(tmp_path: Path) -> None:
    seen = replace(camera(), model="equirectangular")
    save_cameras(tmp_path / "cameras.json", [camera(), seen])
    assert load_cameras(tmp_path / "cameras.json", panoramas=True)[1].model == "equirectangular"
    with pytest.raises(InputError, match="camera 1: equirectangular has no pinhole picture"):
        load_cameras(tmp_path / "cameras.json")
    with pytest.raises(ValueError, match="camera 7: equirectangular has no pinhole picture"):
        pose(seen)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"fx": -1}, "fx, fy are -1.0"),
        ({"id": True}, "id is True"),
        ({"fy": "wide"}, "fy is 'wide'"),
        ({"cx": None}, "cx is None"),
        ({"cy": 10**400}, "cy is 1000"),
        ({"orthographic": "no"}, "orthographic is 'no'"),
        ({"image": 3}, "image is 3"),
        ({"model": "fisheye"}, "model is 'fisheye'"),
        ({"model": "equirectangular", "orthographic": True}, "model is 'equirectangular'"),
        ({"width": 0}, "width is 0, expected a whole number of 1 or more"),
        ({"height": 10.5}, "height is 10.5"),
        ({"near": 5, "far": 2}, "near, far are 5.0, 2.0"),
        ({"world_to_camera": [[1, 0], [0, 1]]}, "world_to_camera: expected 4x4"),
        ({"world_to_camera": [[1, 0], [0]]}, "world_to_camera: expected 4x4"),
        ({"world_to_camera": [[10**400] * 4] * 4}, "world_to_camera: expected 4x4"),
        ({"world_to_camera": (2 * np.eye(4)).tolist()}, "expected a rotation"),
        ({"world_to_camera": np.diag([1, 1, -1, 1]).tolist()}, "expected a rotation"),
    ],
)
def test_bad_cameras_are_named(tmp_path: Path, change: dict[str, Any], reason: str) -> None:
    save_cameras(tmp_path / "cameras.json", [camera(), camera()])
    entries = json.loads((tmp_path / "cameras.json").read_text())
    entries[1] |= change
    (tmp_path / "cameras.json").write_text(json.dumps(entries))
    with pytest.raises(InputError, match=rf"cameras\.json: camera 1: .*{reason}"):
        load_cameras(tmp_path / "cameras.json")


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("[", "not JSON"),
        ("[" * 100_000, "not JSON"),
        ("{}", "expected a list"),
        ("[3]", "camera 0: expected an object"),
        ('[{"id": 1}]', "camera 0: no width, height, fx, fy, cx, cy, world_to_camera"),
    ],
)
def test_bad_files_are_named(tmp_path: Path, text: str, reason: str) -> None:
    (tmp_path / "cameras.json").write_text(text)
    with pytest.raises(InputError, match=reason):
        load_cameras(tmp_path / "cameras.json")


def test_no_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="none"):
        load_cameras(tmp_path / "none.json")
    with pytest.raises(InputError, match="none"):
        save_cameras(tmp_path / "none" / "cameras.json", [])


@given(eye=points, target=points)
def test_look_at_puts_the_target_ahead(eye: tuple[float, ...], target: tuple[float, ...]) -> None:
    distance = float(np.linalg.norm(np.subtract(target, eye)))
    assume(distance > 1e-3)
    transform = look_at(eye, target)
    np.testing.assert_allclose(transform @ [*target, 1], [0, 0, distance, 1], atol=1e-9)
    np.testing.assert_allclose(transform @ [*eye, 1], [0, 0, 0, 1], atol=1e-9)
    assert np.linalg.det(transform[:3, :3]) == pytest.approx(1)
    assert transform[1, 2] <= 1e-9  # up in the world is not down in the picture


@pytest.mark.parametrize("up", [(1, 1, 1), (0, 0, 2), (-3, 0, 0)])
def test_look_at_along_the_vertical(up: tuple[float, ...]) -> None:
    rotation = look_at((0, 0, 0), up, up)[:3, :3]
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1)


def test_look_at_nothing() -> None:
    with pytest.raises(ValueError, match="own position"):
        look_at((1, 1, 1), (1, 1, 1))


@pytest.mark.parametrize("up", [(0, 0, 1), (0, -1, 0), (1, 1, 0)])
def test_an_orbit_sees_all_of_the_bounds(up: tuple[float, ...]) -> None:
    bounds = np.array([[-1.0, -2.0, 0.0], [3.0, 2.0, 1.0]])
    corners = np.stack(np.meshgrid(*bounds.T), axis=-1).reshape(-1, 3)
    cameras = orbit(bounds, 8, width=400, height=300, up=up)
    assert len({tuple(np.round(c.position, 6)) for c in cameras}) == 8
    for c in cameras:
        x, y, z = c.world_to_camera[:3, :3] @ corners.T + c.world_to_camera[:3, 3:]
        assert (z > 0).all()
        assert (np.abs(c.fx * x / z) <= c.width / 2).all()
        assert (np.abs(c.fy * y / z) <= c.height / 2).all()
        assert c.world_to_camera[1, :3] @ up < 0
        assert (c.position - bounds.mean(axis=0)) @ up > 0


def test_a_real_camera_file(reference: Callable[[str], Path]) -> None:
    cameras = load_cameras(reference("wolf/cameras.json"))
    assert [(c.id, c.image) for c in cameras] == [(0, "0.png"), (2, "2.png")]


def test_a_trajectory_has_a_camera_at_each_pose(tmp_path: Path) -> None:
    seen = [camera(), replace(camera(), id=0, world_to_camera=look_at((0, -2, 1), (5, 5, 5)))]
    lines = [
        " ".join(map(repr, [1.5, *one.position.tolist(), *(-2 * one.orientation).tolist()]))
        for one in seen
    ]
    path = tmp_path / "poses.txt"
    path.write_text("# time x y z qx qy qz qw\n\n" + "\n".join(lines) + " # the last\n")
    found = load_trajectory(path, camera())
    for number, (one, other) in enumerate(zip(found, seen, strict=True)):
        np.testing.assert_allclose(one.world_to_camera, other.world_to_camera, atol=1e-12)
        assert (one.id, one.width, one.fx, one.cy) == (number, 640, 500, 240)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "holds no poses"),
        ("# only a comment", "holds no poses"),
        ("0 1 2 3 0 0 0 1\n1 1 2 3 0 0 0", "line 2: expected time x y z qx qy qz qw"),
        ("0 1 2 3 0 0 0 0", "line 1: expected"),
        ("0 1 2 nan 0 0 0 1", "line 1: expected"),
        ("time x y z qx qy qz qw", "line 1: expected"),
    ],
)
def test_a_trajectory_that_is_none(tmp_path: Path, text: str, reason: str) -> None:
    path = tmp_path / "poses.txt"
    path.write_text(text)
    with pytest.raises(InputError, match=f"poses.txt: {reason}"):
        load_trajectory(path, camera())
    with pytest.raises(InputError, match=r"none\.txt: No such file"):
        load_trajectory(tmp_path / "none.txt", camera())


@pytest.mark.parametrize("fov", [0.0, -0.9, math.pi, math.nan])
def test_an_angle_of_view_that_can_t_be_is_named(fov: float) -> None:
    with pytest.raises(ValueError, match=r"^fov is \S+, expected 0 < fov < pi$"):
        orbit([(0, 0, 0), (1, 1, 1)], 1, fov=fov)


def test_a_path_that_can_t_be_is_named() -> None:
    with pytest.raises(InputError, match="no name of a file"):
        save_cameras("a\0", [camera()])
