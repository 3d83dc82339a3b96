"""`simplify` for the views along a path: what matters there, and what is held back of it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rosplat_core.cameras import Camera, look_at, orbit, save_cameras
from rosplat_core.formats import load, save
from rosplat_core.generated import generate
from rosplat_core.simplification import search
from rosplat_core.simplification.search import Simplification
from rosplat_core.simplification.views import LEAST_BETWEEN, TURN, Along
from rosplat_core.slot_order import put_in_slot_order
from rosplat_core.splats import InputError, Splats, concatenate
from rosplat_ros.poses import to_pose
from rosplat_testing.bags import needs_bags, record
from rosplat_tools.simplify.command import main
from rosplat_tools.simplify.path import along, load_camera_info

HIGH = 30.0  # where what no camera sees is [m]
POSES = 40
LEARNT, NEW = 24, 20  # views, see few_views

pytestmark = pytest.mark.usefixtures("few_views")


def camera_at(angle: float) -> Camera:
    eye = np.array([2.0 * np.cos(angle), 2.0 * np.sin(angle), 0.8])
    view = look_at(eye, (0, 0, 0.4))
    return Camera(0, 320, 180, 150, 150, 160, 90, view)


@pytest.fixture(scope="module")
def path() -> list[Camera]:
    """A third of the way around the garden."""
    return [camera_at(angle) for angle in np.linspace(0, 2, POSES)]


@pytest.fixture(scope="module")
def scene() -> Splats:
    """A garden, and another one out of sight above it."""
    above = generate(3000, seed=1)
    above.positions[:, 2] += np.float32(HIGH)
    splats = concatenate([generate(3000), above])
    put_in_slot_order(splats)
    return splats


@pytest.fixture(scope="module")
def files(
    scene: Splats, path: list[Camera], tmp_path_factory: pytest.TempPathFactory
) -> tuple[str, str]:
    folder = tmp_path_factory.mktemp("path")
    save(folder / "scene.ply", scene)
    save_cameras(folder / "cameras.json", path)
    return str(folder / "scene.ply"), str(folder / "cameras.json")


def angle_between(one: Camera, other: Camera) -> float:
    """[deg]"""
    turn = one.world_to_camera[:3, :3] @ other.world_to_camera[:3, :3].T
    return float(np.degrees(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1))))


def test_neighbours_are_beside_the_path_and_look_along_it_or_around(
    scene: Splats, path: list[Camera]
) -> None:
    views = Along(scene, path, margin=0.1)
    found = views.cameras(200, 5)
    places = np.array([camera.position for camera in path])
    nearest = [np.linalg.norm(places - camera.position, axis=1) for camera in found]
    assert 0.05 < max(distances.min() for distances in nearest) <= 0.1
    turned = np.array([min(angle_between(camera, other) for other in path) for camera in found])
    assert 0.6 < (turned <= TURN).mean() < 0.9
    upright = [camera.world_to_camera[1, 2] for camera in found]  # down, in what is down there
    assert max(upright) < -0.8


def test_no_neighbour_is_nearer_to_things_than_half_way(scene: Splats, path: list[Camera]) -> None:
    opaque = scene.positions[scene.opacities >= 0.3]

    def clearance(camera: Camera) -> float:
        return float(np.linalg.norm(opaque - camera.position, axis=1).min())

    least = min(map(clearance, path))
    assert min(map(clearance, Along(scene, path, margin=50).cameras(200, 5))) >= 0.49 * least


def test_what_a_neighbour_s_turn_brings_into_view_is_learnt_from(
    scene: Splats, path: list[Camera]
) -> None:
    """At the edges of pictures, where only few turns reach: each picture to learn from has it."""
    views = Along(scene, path, margin=0)
    for camera, wide in zip(views.cameras(20, 5), views.to_learn(20, 5), strict=True):
        np.testing.assert_array_equal(camera.world_to_camera, wide.world_to_camera)
        for edges in (
            (camera.cx / camera.fx, wide.cx / wide.fx),
            (camera.cy / camera.fy, wide.cy / wide.fy),
            ((camera.width - camera.cx) / camera.fx, (wide.width - wide.cx) / wide.fx),
            ((camera.height - camera.cy) / camera.fy, (wide.height - wide.cy) / wide.fy),
        ):
            angle, reached = np.degrees(np.arctan(edges))
            assert angle + TURN - 0.1 < reached < angle + TURN + 0.5


def test_what_no_view_sees_goes_before_what_one_barely_sees(
    scene: Splats, path: list[Camera]
) -> None:
    work = Simplification(scene, path=path)
    work.reduce(len(scene) // 4)
    assert (work.splats.positions[:, 2] < HIGH / 2).all()


def test_searches_begin_with_cameras_that_nothing_was_learnt_from(
    scene: Splats, path: list[Camera]
) -> None:
    views = Along(scene, path, margin=0)
    learnt = {tuple(camera.position.round(9)) for camera in views.cameras(500, 0)}
    held = {tuple(camera.position.round(9)) for camera in views.checked[: POSES // 10]}
    assert len(views.checked) == NEW
    assert learnt | held == {tuple(camera.position.round(9)) for camera in path}
    assert not learnt & held


def test_what_never_shows_along_the_path_is_left_out(
    scene: Splats, files: tuple[str, str], tmp_path: Path
) -> None:
    out, report = tmp_path / "out.ply", tmp_path / "report.json"
    arguments = [files[0], str(out), "--psnr", "36", "--cameras", files[1]]
    assert main([*arguments, "--report", str(report)]) == 0
    left = load(out)
    assert (left.positions[:, 2] < HIGH / 2).all()
    assert len(left) < 0.45 * len(scene)
    told = json.loads(report.read_text())
    assert told["psnr"] >= 36 - 1  # 20 new views tell it no better
    assert told["worst"] <= told["psnr"]
    assert told["views"]["checked"] >= 2 * NEW and told["views"]["learnt"] >= LEARNT
    assert 0 < told["views"]["margin_m"] < 0.5


def test_the_same_count_looks_better_along_the_path(scene: Splats, path: list[Camera]) -> None:
    along, anywhere = Simplification(scene, path=path), Simplification(scene)
    for work in (along, anywhere):
        work.reduce(1500)
    ours, others = along.judge(along.splats), along.judge(anywhere.splats)
    assert ours.psnr > others.psnr + 3
    assert ours.worst > others.worst + 3


def test_what_nobody_notices_goes_without_pairing(
    scene: Splats, path: list[Camera], monkeypatch: pytest.MonkeyPatch
) -> None:
    work = Simplification(scene, path=path)
    monkeypatch.delattr(search, "find_pairs")
    work.reduce(int(0.7 * len(scene)))
    assert work.judge(work.splats).psnr > 60
    with pytest.raises(NameError, match="find_pairs"):  # the rest is not left out unasked
        work.reduce(int(0.3 * len(scene)))


@pytest.mark.parametrize("bound", [20, 25])
def test_all_views_held_back_keep_the_bound(bound: float) -> None:
    """In rooms, the few views that stand for all while it searches tell little of the others."""
    path = orbit([[-2, -2, -2], [2, 2, 2]], 12, width=320, height=180)
    work = Simplification(generate(4000, sh_degree=0, scene="rooms"), path=path)
    work.shrink(bound)
    assert len(work.splats) < 1000
    assert work.judge(work.splats).psnr > bound - 0.01  # as far as sums of 32 bits tell


def test_refitting_looks_along_the_path(scene: Splats, path: list[Camera]) -> None:
    work = Simplification(scene, path=path)
    work.reduce(800)
    work.refine(1.0)
    before, after = work.steps[-2:]
    assert after.quality.psnr > before.quality.psnr + 0.5
    assert after.quality.worst >= before.quality.worst
    assert (work.splats.positions[:, 2] < HIGH / 2).mean() > 0.99


def test_a_trajectory_and_its_intrinsics(
    files: tuple[str, str], path: list[Camera], tmp_path: Path
) -> None:
    poses, info = tmp_path / "poses.txt", tmp_path / "camera_info.yaml"
    lines = (
        [0.1 * i, *camera.position.tolist(), *camera.orientation.tolist()]
        for i, camera in enumerate(path)
    )
    poses.write_text("\n".join(" ".join(map(str, line)) for line in lines))
    info.write_text(
        "width: 320\nheight: 180\n"
        "p: [150.0, 0.0, 159.5, 0.0, 0.0, 150.0, 89.5, 0.0, 0.0, 0.0, 1.0, 0.0]\n---\n"
    )
    reports = []
    for number, cameras in enumerate((files[1], str(info))):
        out, report = tmp_path / f"{number}.ply", tmp_path / f"{number}.json"
        arguments = [files[0], str(out), "--max-splats", "900", "--report", str(report)]
        assert main([*arguments, "--cameras", cameras, "--trajectory", str(poses)]) == 0
        reports.append(json.loads(report.read_text()))
    assert reports[0]["psnr"] == pytest.approx(reports[1]["psnr"], abs=0.01)
    assert reports[0]["views"] == reports[1]["views"]


@needs_bags
def test_the_poses_of_a_bag_are_a_trajectory(
    files: tuple[str, str], path: list[Camera], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from geometry_msgs.msg import PoseArray, PoseStamped
    from nav_msgs.msg import Odometry

    poses = [to_pose(camera.camera_to_world) for camera in path]
    odometry = [Odometry() for _ in poses]
    for message, pose in zip(odometry, poses, strict=True):
        message.pose.pose = pose
    one, several = tmp_path / "one", tmp_path / "several"
    record(one, [("/camera/pose", PoseStamped(pose=pose)) for pose in poses])
    record(several, [
        *(("/odom", each) for each in odometry), ("/poses", PoseArray(poses=poses)),
        ("/empty", PoseArray()),
    ])  # fmt: skip
    for name in (one, f"{several}:/odom", f"{several}:/poses"):
        found = along(Path(files[1]), Path(name))
        assert found is not None
        assert [camera.id for camera in found] == list(range(len(path)))
        for ours, expected in zip(found, path, strict=True):
            np.testing.assert_allclose(ours.world_to_camera, expected.world_to_camera, atol=1e-9)
            assert (ours.fx, ours.width) == (path[0].fx, path[0].width)
    out = str(tmp_path / "out.ply")
    for name, error in {
        str(several): f"Odometry? Give it as {several}:TOPIC: it has /empty, /odom, /poses",
        f"{several}:/x": "it has /empty, /odom, /poses",
        f"{several}:/empty": "/empty holds no poses",
        f"{tmp_path}:/x": "no whole bag",
    }.items():
        arguments = [files[0], out, "--psnr", "40", "--cameras", files[1], "--trajectory", name]
        assert main(arguments) == 1
        assert error in capsys.readouterr().err


CALIBRATION = """\
image_width: 640
image_height: 480
camera_name: narrow
camera_matrix: {rows: 3, cols: 3, data: [1, 0, 1, 0, 1, 1, 0, 0, 1]}
projection_matrix:
  rows: 3
  cols: 4
  data: [500, 0, 319.5, 0, 0, 510, 239.5, 0, 0, 0, 1, 0]
"""


def test_a_calibration_s_yaml(tmp_path: Path) -> None:
    info = tmp_path / "info.yaml"
    info.write_text(CALIBRATION)
    camera = load_camera_info(info)
    assert (camera.width, camera.height, camera.fx, camera.fy) == (640, 480, 500, 510)
    assert (camera.cx, camera.cy) == (320, 240)
    for text, reason in {
        "- 1": "is no camera_info",
        "a: [": "is no YAML",
        CALIBRATION.replace("image_width", "wide"): "no width or image_width",
        CALIBRATION.replace("500", "0"): "fx, fy are 0.0",
        CALIBRATION.replace("data: [500, ", "data: ["): "cannot reshape",
        CALIBRATION.replace("640", "wide"): "width is 'wide'",
    }.items():
        info.write_text(text)
        with pytest.raises(InputError, match=f"info.yaml: {reason}"):
            load_camera_info(info)


def test_a_path_that_looks_away_sees_nothing_though_its_neighbours_do(
    scene: Splats, path: list[Camera]
) -> None:
    def away(camera: Camera) -> Camera:
        return replace(camera, world_to_camera=np.diag([-1, 1, -1, 1]) @ camera.world_to_camera)

    with pytest.raises(InputError, match="no camera of the path sees a splat"):
        Simplification(scene, path=[away(camera) for camera in path])
    number = LEAST_BETWEEN // 2  # of the one that is held back: that it sees something is enough
    some = [away(camera) for camera in path[:LEAST_BETWEEN]]
    some[number] = path[number]
    work = Simplification(scene, path=some)
    np.testing.assert_array_equal(
        work.views.checked[0].world_to_camera, some[number].world_to_camera
    )


def test_paths_that_are_none(
    files: tuple[str, str], path: list[Camera], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, empty, away = (tmp_path / name for name in ("out.ply", "empty.json", "away.json"))
    save_cameras(empty, [])
    view = look_at((9000, 0, 9000), (9999, 0, 9000))
    save_cameras(away, [replace(camera, world_to_camera=view) for camera in path])
    bound = [files[0], str(out), "--psnr", "40"]
    for arguments, error in {
        ("--trajectory", str(tmp_path / "a.txt")): "--trajectory has no intrinsics",
        ("--margin", "1"): "--margin is of a path",
        ("--cameras", str(tmp_path / "a.json")): "a.json: No such file",
        ("--cameras", str(empty)): "empty.json: holds no cameras",
        ("--cameras", files[1], "--trajectory", files[1]): "cameras.json: line 1: expected time",
        ("--cameras", str(away)): "no camera of the path sees a splat",
    }.items():
        assert main([*bound, *arguments]) == 1
        assert error in capsys.readouterr().err
    assert not out.exists()
    with pytest.raises(SystemExit):
        main([*bound, "--cameras", files[1], "--margin", "-1"])
    assert "argument --margin: '-1' is no distance" in capsys.readouterr().err
