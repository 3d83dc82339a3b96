"""compare --bag: a flight in a bag, held against its map, and against a map that lacks a part."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header

from rosplat_core import formats
from rosplat_core.cameras import look_at
from rosplat_core.generated import generate
from rosplat_core.lens_pictures import take_picture
from rosplat_core.lens_warps import Warp
from rosplat_core.lenses import Lens
from rosplat_core.maps import PublishedMap
from rosplat_core.rendering import CpuRenderer
from rosplat_core.splats import Splats
from rosplat_ros.images import to_bytes, to_image
from rosplat_ros.map_publisher import as_message
from rosplat_ros.poses import to_pose
from rosplat_testing.bags import needs_bags, record
from rosplat_tools.cameras import compare_bag
from rosplat_tools.cameras.calibrations import of_lens
from rosplat_tools.cameras.pose_history import SECOND, PoseHistory
from rosplat_tools.cameras.taken_pictures import PictureReader

SPLATS = generate(2000, seed=2)
EYES = [look_at((6 * np.cos(a), 6 * np.sin(a), 2.0), (0, 0, 0.5)) for a in (0.0, 0.4, 0.8)]
LENS = Lens(160, 120, 150.0, 150.0, 80.0, 60.0, "plumb_bob", (-0.2, 0.03, 1e-3, 0, 0))


def batches(splats: Splats) -> list[Any]:
    """As a publisher would send them."""
    sent: list[Any] = []
    published = PublishedMap(100_000, "none", sent.append, lambda text: None, lambda: None)
    published.replace(splats, None, None)
    return [as_message(batch, Header(frame_id="map")) for batch in sent]


def flight() -> Iterator[tuple[str, Any]]:
    renderer = CpuRenderer(SPLATS)
    info = of_lens(LENS)
    info.header.frame_id = "optical"
    yield "/cam/camera_info", info
    for second, eye in enumerate(EYES, 1):
        colour = take_picture(renderer, Warp(LENS), eye).colour
        image = to_image(to_bytes(colour), "rgb8")
        image.header.stamp.sec, image.header.frame_id = second, "optical"
        yield "/cam/image_raw", image  # before its pose, as TF mostly has it
        pose = PoseStamped(pose=to_pose(np.linalg.inv(eye)))
        pose.header.stamp.sec, pose.header.frame_id = second, "map"
        yield "/cam/pose", pose


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    path = tmp_path / "flight"
    maps = [("/gaussians", batch) for batch in batches(SPLATS)]
    assert len(maps) > 1
    record(path, [*maps, *flight()])
    return path


def compare(capsys: pytest.CaptureFixture[str], *words: object) -> tuple[int, list[str], str]:
    code = compare_bag.main([*map(str, words)])
    out, error = capsys.readouterr()
    return code, out.splitlines(), error


@needs_bags
def test_a_bag_s_map_explains_its_pictures(bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, lines, error = compare(capsys, "--bag", bag, "--pose", "/cam/pose")
    assert (code, error) == (0, "")
    head, *rows, last = lines
    assert head.split()[:4] == ["time", "[s]", "PSNR", "SSIM"]
    assert sorted(float(row.split()[0]) for row in rows) == [1, 2, 3]
    assert all(float(row.split()[1]) >= 60 for row in rows)
    assert re.fullmatch(r"3 pictures: PSNR \S+ dB in the mean, \S+ at worst", last)


@needs_bags
def test_the_worst_picture_is_first(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The scene's file lacks splats that the first camera has near to it."""
    eye = np.linalg.inv(EYES[0])[:3, 3]
    away = np.linalg.norm(SPLATS.positions + SPLATS.origin - eye, axis=1)
    scene = tmp_path / "scene.ply"
    formats.save(scene, SPLATS[np.sort(np.argsort(away)[100:])])
    code, lines, _ = compare(capsys, "--bag", bag, "--pose", "/cam/pose", "--scene", scene)
    assert code == 0
    rows = [[float(word) for word in line.split()] for line in lines[1:-1]]
    psnr = [row[1] for row in rows]
    assert psnr == sorted(psnr)
    assert rows[0][0] == 1
    assert psnr[0] < 40


@needs_bags
def test_what_a_bag_lacks_is_said_in_a_line(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pose = ("--pose", "/cam/pose")
    for words, said in (
        (("--bag", tmp_path / "none", *pose), "none: No such file or directory"),
        (("--bag", bag, *pose, "--image", "/x"), "no Image on /x: it has /cam/image_raw"),
        (("--bag", bag, *pose, "--info", "/x"), "no CameraInfo on /x: it has /cam/camera_info"),
        (("--bag", bag, "--pose", "/x"), "no PoseStamped on /x: it has /cam/pose"),
        (("--bag", bag, *pose, "--mask", "/none.png"), "mask /none.png: No such file"),
    ):
        code, lines, error = compare(capsys, *words)
        assert (code, lines) == (1, [])
        assert error.startswith("compare: ")
        assert error.count("\n") == 1
        assert said in error
    two = tmp_path / "two"
    odd = Image(header=Header(frame_id="optical"), width=3, height=3, encoding="rgb8")
    record(two, [*flight(), ("/other/image_raw", odd), ("/other/camera_info", CameraInfo())])
    code, _, error = compare(capsys, "--bag", two, *pose)
    assert (code, "which Image? Give --image" in error) == (1, True)
    code, _, error = compare(
        capsys, "--bag", two, *pose, "--image", "/other/image_raw", "--scene", "procedural:100"
    )
    assert code == 1
    assert "left out 1 picture: 1.000 s before all poses that are known" in error
    assert "no picture could be compared" in error


@needs_bags
def test_a_map_that_lacks_a_part_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    first, *later = (("/gaussians", batch) for batch in batches(SPLATS))
    assert later
    record(tmp_path / "late", [*later, *flight()])
    code, lines, error = compare(capsys, "--bag", tmp_path / "late", "--pose", "/cam/pose")
    assert (code, lines, error.count("\n")) == (1, [], 1)
    assert "the map lacks 1 batch: record it from its beginning" in error
    record(tmp_path / "ended", [first, *later[:-1], *flight()])
    code, _, error = compare(capsys, "--bag", tmp_path / "ended", "--pose", "/cam/pose")
    assert (code, error.count("\n")) == (0, 1)
    assert "more of the map was to come than" in error
    begun_anew = [*later, first, *later]  # as a recorder that came late has it after a repeat
    record(tmp_path / "repeated", [*begun_anew, *flight()])
    code, _, error = compare(capsys, "--bag", tmp_path / "repeated", "--pose", "/cam/pose")
    assert (code, error) == (0, "")


def test_pictures_left_out_count_by_the_words_of_the_reason(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    poses, images = PoseHistory(), [Image() for _ in range(3)]
    poses.add(SECOND, np.eye(4))
    for second, image in enumerate(images, 3):
        image.header.stamp.sec = second
    monkeypatch.setattr(compare_bag.bags, "messages", lambda *_: [("", each) for each in images])
    bag: Any = SimpleNamespace(
        path="", image="", info=None, pose=lambda image: poses.at(image.header.stamp.sec * SECOND)
    )
    _, left_out = compare_bag.compare_all(bag, PictureReader(Warp))
    assert left_out == {"2.000 s after all poses that are known": 3}


@needs_bags
def test_poses_come_by_tf(bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("tf2_ros")
    from tf2_msgs.msg import TFMessage

    from rosplat_testing.studio import transform

    shift = np.eye(4)
    shift[0, 3] = 0.3
    messages: list[tuple[str, Any]] = [
        ("/tf_static", TFMessage(transforms=[transform("body", "optical", shift)]))
    ]
    for second, eye in enumerate(EYES, 1):
        pose = np.linalg.inv(eye) @ np.linalg.inv(shift)
        messages.append(("/tf", TFMessage(transforms=[transform("map", "body", pose, second)])))
    path = tmp_path / "tf"
    scene = tmp_path / "scene.ply"
    formats.save(scene, SPLATS)
    record(path, [*messages, *(each for each in flight() if each[0] != "/cam/pose")])
    code, lines, error = compare(capsys, "--bag", path, "--scene", scene)
    assert (code, error) == (0, "")
    assert len(lines) == 5
    assert all(float(line.split()[1]) >= 55 for line in lines[1:-1])


def test_without_a_library_bags_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("rosbag2_py", "rosbags", "rosbags.rosbag2"):
        monkeypatch.setitem(sys.modules, name, None)
    code, _, error = compare(capsys, "--bag", tmp_path)
    assert code == 1
    assert "to read bags, install rosbag2_py (of ROS 2) or rosbags (of PyPI)" in error
