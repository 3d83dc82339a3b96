"""The view that a scene is shown in first."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from rosplat_core import first_look, formats
from rosplat_core.cameras import Camera, look_at
from rosplat_core.first_look import FirstView, cameras_beside, first_view, sample, views_within
from rosplat_core.generated import generate
from rosplat_core.rendering import CpuRenderer, posed
from rosplat_core.splats import Splats, concatenate

Z = (0.0, 0.0, 1.0)


def alpha(
    splats: Splats, view: FirstView, width: int = 160, height: int = 90
) -> NDArray[np.float32]:
    return CpuRenderer(splats).render(view.camera(width, height))[..., 3]


def border(alpha: NDArray[np.float32]) -> float:
    return float(np.mean([*alpha[0], *alpha[-1], *alpha[:, 0], *alpha[:, -1]]))


def walls(size: tuple[float, float, float], shade: NDArray[np.float64]) -> Splats:
    """A box from 0 to size [m], a splat every 5 cm; shade (k,): greys of its tiles."""
    random = np.random.default_rng(0)
    places, turns = [], []
    for axis in range(3):
        first, second = (axis + 1) % 3, (axis + 2) % 3
        u, v = np.meshgrid(*(np.arange(0, size[other], 0.05) for other in (first, second)))
        for side in (0.0, size[axis]):
            points = np.zeros((u.size, 3))
            points[:, axis], points[:, first], points[:, second] = side, u.ravel(), v.ravel()
            places.append(points)
            turns.append(
                np.tile(
                    Rotation.from_rotvec(
                        [(0, np.pi / 2, 0), (np.pi / 2, 0, 0), (0, 0, 0)][axis]
                    ).as_quat(),
                    (u.size, 1),
                )
            )
    positions = np.concatenate(places)
    tile = np.unique(np.floor(positions / 0.7 + 0.01), axis=0, return_inverse=True)[1].ravel()
    greys = random.choice(shade, tile.max() + 1)[tile]
    n = len(positions)
    return Splats(
        positions=positions, orientations=np.concatenate(turns),
        scales=np.tile([0.035, 0.035, 0.003], (n, 1)), opacities=np.full(n, 0.95),
        sh=np.repeat((greys - 0.5)[:, None, None] / 0.2821, 3, axis=2),
    )  # fmt: skip


def row_of(scene: Splats, count: int, step: tuple[float, float, float]) -> Splats:
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, :3, 3] = np.arange(count)[:, None] * step
    return concatenate([scene.moved(pose) for pose in poses])


@pytest.fixture(autouse=True)
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """The views of a loaded machine are those of a quiet one."""
    monkeypatch.setattr(first_look, "PATIENCE", np.inf)


@pytest.fixture(scope="module")
def garden() -> Splats:
    return generate(30_000, scene="garden")


@pytest.fixture(scope="module")
def rooms() -> Splats:
    return generate(60_000, scene="rooms")


@pytest.fixture(scope="module")
def dense_rooms() -> Splats:
    return generate(300_000, scene="rooms")


def test_an_object_is_shown_whole_from_above_its_ground(garden: Splats) -> None:
    view = first_view(garden, Z)
    picture = alpha(garden, view)
    assert picture.mean() > 0.2
    assert border(picture) < 0.02
    assert view.eye[2] > 0.2
    assert not view.inside


@pytest.mark.parametrize("kind", ["garden", "long", "tall"])
def test_an_object_fits_a_window_of_any_shape(garden: Splats, kind: str) -> None:
    scene = {
        "garden": garden,
        "long": row_of(garden, 4, (6, 0, 0)),
        "tall": row_of(garden, 6, (0, 0, 4)),
    }[kind]
    view = first_view(scene, Z)
    for width, height in ((160, 90), (120, 90), (90, 90), (60, 90), (240, 90)):
        picture = alpha(scene, view, width, height)
        assert border(picture) < 0.05
        assert picture.mean() > 0.02
        # As near as that: it reaches from side to side, or from top to bottom.
        if width < 240:
            rows, columns = (np.flatnonzero(picture.max(axis=axis) > 0.3) for axis in (1, 0))
            assert max(np.ptp(rows) / height, np.ptp(columns) / width) > 0.55


def test_rooms_are_shown_from_within(rooms: Splats) -> None:
    view = first_view(rooms, Z)
    low, high = rooms.positions.min(axis=0), rooms.positions.max(axis=0)
    assert (view.eye > low).all()
    assert (view.eye < high).all()
    assert alpha(rooms, view).mean() > 0.95
    assert view.width == 0  # no narrow window moves the camera through a wall
    assert view.inside


def test_of_many_splats_those_read_show_a_room_from_within(
    dense_rooms: Splats, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(first_look, "sample", lambda splats: sample(splats, 30_000))
    assert first_view(dense_rooms, Z).inside


def test_what_is_hidden_from_outside_is_shown_from_within() -> None:
    shell = walls((1.5, 1, 0.65), np.array([0.2, 0.5, 0.8]))
    window = np.floor(shell.positions / 0.175 + 0.01) @ (3, 5, 7) % 4 == 0
    hall = replace(shell, positions=4 * shell.positions, scales=4 * shell.scales)[~window]
    box = walls((1, 1, 1), np.array([0.1, 0.9]))
    boxes = [
        replace(box, positions=0.4 * box.positions + (x, y, 0), scales=0.4 * box.scales)
        for x in (0.6, 2, 3.4, 4.8)
        for y in (0.5, 1.8, 3.1)
    ]
    view = first_view(concatenate([hall, *boxes]), Z)
    assert ((view.eye > 0) & (view.eye < (6, 4, 2.6))).all()
    assert view.inside


@pytest.mark.parametrize(("count", "size"), [(3000, 0.12), (20_000, 0.03)])
def test_a_hollow_object_is_shown_from_outside(count: int, size: float) -> None:
    away = np.random.default_rng(0).normal(size=(count, 3))
    away *= (1, 1, 1.3) / np.linalg.norm(away, axis=1, keepdims=True)
    head = Splats(
        positions=away, orientations=np.tile([0, 0, 0, 1], (count, 1)),
        scales=np.full((count, 3), size), opacities=np.full(count, 0.9),
        sh=np.random.default_rng(1).normal(size=(count, 1, 3)),
    )  # fmt: skip
    view = first_view(head, Z)
    assert np.linalg.norm(view.eye) > 2
    assert not view.inside


def test_a_thin_part_of_an_object_is_shown_too() -> None:
    random = np.random.default_rng(0)
    body = random.normal(size=(20_000, 3))
    body *= 0.3 / np.linalg.norm(body, axis=1, keepdims=True)
    neck = np.column_stack([random.uniform(-0.05, 0.05, (2000, 2)), random.uniform(0.3, 2.5, 2000)])
    n = 22_000
    guitar = Splats(
        positions=np.concatenate([body, neck]), orientations=np.tile([0, 0, 0, 1], (n, 1)),
        scales=np.full((n, 3), 0.01), opacities=np.full(n, 0.9), sh=np.zeros((n, 1, 3)),
    )  # fmt: skip
    assert border(alpha(guitar, first_view(guitar, Z))) < 0.02


def test_a_long_room_is_looked_at_along_its_length() -> None:
    view = first_view(walls((9, 3, 2.6), np.array([0.2, 0.5, 0.8])), Z)
    ahead = (view.target - view.eye) / np.linalg.norm(view.target - view.eye)
    assert abs(ahead[0]) > 0.8


@pytest.mark.parametrize("column", [0, 1, 2])
def test_a_room_is_looked_at_where_it_is_furnished(dense_rooms: Splats, column: int) -> None:
    flat = dense_rooms
    low, high = np.array([4 * column - 6.1, -6.1, -1]), np.array([4 * column - 1.9, -1.9, 9])
    room = flat[((flat.positions > low) & (flat.positions < high)).all(axis=1)]
    view = first_view(room, Z)
    assert ((view.eye > low) & (view.eye < high)).all()
    picture = CpuRenderer(room).render(view.camera(160, 90))[..., :3]
    parts = picture.reshape(15, 6, 20, 8, 3).mean(axis=(1, 3))
    steps = [np.abs(np.diff(parts, axis=axis)).sum(axis=-1).mean() for axis in (0, 1)]
    assert sum(steps) > 0.37  # a bare wall has none


@pytest.mark.parametrize("width", [90, 160])
def test_no_third_of_a_room_s_picture_is_a_bare_wall(rooms: Splats, width: int) -> None:
    picture = CpuRenderer(rooms).render(first_view(rooms, Z).camera(width, 90))[..., :3]
    parts = picture.mean(axis=-1).reshape(18, 5, width // 5, 5).mean(axis=(1, 3))
    thirds = np.array_split(np.abs(np.diff(parts, axis=1)), 3, axis=1)
    assert min(third.mean() for third in thirds) > 0.025


def test_views_within_are_of_scenes_that_surround_them(garden: Splats, rooms: Splats) -> None:
    found = views_within(rooms, Z)
    assert len(found) > 20
    assert min(alpha(rooms, view).mean() for view in found[:10]) > 0.8
    assert not views_within(garden, Z)


@pytest.mark.parametrize("tilt", [(90, 0, 0), (70, 20, 10)])
def test_a_view_turns_with_its_scene(garden: Splats, tilt: tuple[float, float, float]) -> None:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler("xyz", tilt, degrees=True).as_matrix()
    up = pose[:3, 2]
    view = first_view(garden.moved(pose), up)
    camera = view.camera(160, 90)
    right = camera.world_to_camera[0, :3]
    assert abs(right @ up) < 1e-9  # the horizon is level
    assert -camera.world_to_camera[1, :3] @ up > 0.5
    assert border(alpha(garden.moved(pose), view)) < 0.1


def test_a_sky_and_floaters_dont_push_the_view_away(garden: Splats) -> None:
    random = np.random.default_rng(1)
    away = random.normal(size=(3000, 3))
    away *= random.uniform(30, 100, (3000, 1)) / np.linalg.norm(away, axis=1, keepdims=True)
    sky = replace(
        garden[np.zeros(3000, int)], positions=away, scales=np.full((3000, 3), 2.0),
        opacities=np.full(3000, 0.8),
    )  # fmt: skip
    view = first_view(concatenate([garden, sky]), Z)
    assert np.linalg.norm(view.eye) < 12
    assert alpha(garden, view).mean() > 0.2  # of the garden alone


def test_a_shell_of_most_splats_is_a_sky(garden: Splats) -> None:
    random = np.random.default_rng(1)
    n = 2 * len(garden)
    away = random.normal(size=(n, 3))
    away *= 40 / np.linalg.norm(away, axis=1, keepdims=True)
    away[:, 2] = np.abs(away[:, 2])
    dome = replace(garden[np.zeros(n, int)], positions=away, scales=np.full((n, 3), 0.4))
    view = first_view(concatenate([garden, dome]))
    assert view.up[2] > 0.99
    assert not view.inside
    assert border(alpha(garden, view)) < 0.02
    assert alpha(garden, view).mean() > 0.2


def test_far_scenes_and_other_units_give_the_same_picture(garden: Splats) -> None:
    far = replace(
        garden, positions=1e3 * garden.positions, scales=1e3 * garden.scales,
        origin=np.array([4e6, 5e5, 100.0]),
    )  # fmt: skip
    expected, found = first_view(garden, Z), first_view(far, Z)
    np.testing.assert_allclose(found.eye, 1e3 * expected.eye + far.origin, rtol=1e-4)


def test_of_cameras_that_took_the_scene_the_best_is_shown(garden: Splats) -> None:
    away = Camera(0, 640, 480, 500, 500, 320, 240, look_at((4, 0, 1), (9, 0, 1)))
    there = Camera(1, 640, 480, 500, 500, 320, 240, look_at((4.5, 2, 2), (0, 0, 0.5)))
    view = first_view(garden, Z, [away, there, away])
    np.testing.assert_allclose(view.eye, there.position, atol=1e-6)
    ahead = (view.target - view.eye) / np.linalg.norm(view.target - view.eye)
    np.testing.assert_allclose(ahead, there.world_to_camera[2, :3], atol=1e-6)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_relief_is_seen_from_where_its_photograph_was_taken(rooms: Splats, sign: int) -> None:
    """With z ahead and y down, or -z ahead and y up."""
    camera = first_view(rooms, Z).camera(320, 240)
    drawn = CpuRenderer(rooms).draw(posed(camera), mean_depth=True)
    v, u = np.mgrid[:240:2, :320:2]
    depth = drawn["depth"][v, u, 0].ravel()
    rays = np.column_stack([u.ravel() - 160, v.ravel() - 120, np.full(u.size, camera.fx)])
    n = len(rays)
    relief = Splats(
        positions=rays / camera.fx * depth[:, None] * (1, sign, sign),
        orientations=np.tile([0, 0, 0, 1], (n, 1)),
        scales=np.repeat(1.2 * depth[:, None] / camera.fx, 3, axis=1), opacities=np.full(n, 0.9),
        sh=(drawn["colour"][v, u, :3].reshape(n, 1, 3) - 0.5) / 0.2821,
    )  # fmt: skip
    view = first_view(relief)
    np.testing.assert_allclose(view.eye, 0, atol=1e-6)
    assert sign * view.target[2] > 0.5
    assert -sign * view.up[1] > 0.9
    assert alpha(relief, view, 120, 90).mean() > 0.9


@pytest.mark.parametrize("count", [1, 2, 10])
def test_few_splats_are_looked_at(garden: Splats, count: int) -> None:
    few = replace(garden[:count], opacities=np.full(count, 0.9))
    view = first_view(few, Z)
    assert np.isfinite([*view.eye, *view.target]).all()
    assert alpha(few, view).max() > 0.01


@pytest.mark.parametrize("size", [1e-30, 1e15])
def test_extreme_sizes_give_finite_views(garden: Splats, size: float) -> None:
    scene = replace(garden, positions=size * garden.positions, scales=size * garden.scales)
    view = first_view(scene, Z)
    assert np.isfinite([*view.eye, *view.target]).all()
    view.camera(64, 48)


def test_a_photograph_s_scene_is_seen_from_its_camera(garden: Splats, tmp_path: Path) -> None:
    """SHARP's PLYs have it in elements of their own."""
    camera = Camera(0, 640, 480, 500, 500, 320, 240, look_at((4.5, 2, 2), (0, 0, 0.5)))
    formats.save(tmp_path / "photo.ply", garden)
    assert not cameras_beside(str(tmp_path / "photo.ply"))
    header, splats = (tmp_path / "photo.ply").read_bytes().split(b"end_header\n", 1)
    numbers = {
        "extrinsic": camera.world_to_camera.astype("<f4"),
        "intrinsic": np.array([500, 0, 320, 0, 500, 240, 0, 0, 1], "<f4"),
        "image_size": np.array([640, 480], "<u4"),
    }
    for name, values in numbers.items():
        kind = "uint" if name == "image_size" else "float"
        header += f"element {name} {values.size}\nproperty {kind} {name}\n".encode()
    data = b"".join(values.tobytes() for values in numbers.values())
    (tmp_path / "photo.ply").write_bytes(header + b"end_header\n" + splats + data)
    (found,) = cameras_beside(str(tmp_path / "photo.ply"))
    np.testing.assert_allclose(found.world_to_camera, camera.world_to_camera, atol=1e-6)
    assert (found.width, found.height, found.fx, found.cy) == (640, 480, 500, 240)
    np.testing.assert_allclose(first_view(garden, Z, [found]).eye, (4.5, 2, 2), atol=1e-5)
