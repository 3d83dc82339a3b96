"""The whole chain over real DDS: publisher, sorter and renderer in processes of their own."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from rosplat_core.cameras import Camera, look_at
from rosplat_core.splats import InputError
from rosplat_lab import metrics
from rosplat_lab.render import command as render

VIAS = ["host", pytest.param("rviz", marks=pytest.mark.rviz)]


@pytest.fixture
def report(
    data_folder: Path, reference_folder: Path, tmp_path: Path
) -> Callable[[str, str, str], dict]:
    """Draws a scene's reference cameras as `make render` does."""

    def draw(scene: str, file: str, via: str) -> dict:
        if via == "rviz" and not shutil.which("rviz2"):
            pytest.skip("no rviz2 here: the Display is not tested")
        cameras = reference_folder / scene / "cameras.json"
        files = [str(data_folder / file), str(cameras), str(tmp_path)]
        code = render.main([*files, "--via", via, "--sidecar", "native"])
        assert code == 0
        return json.loads((tmp_path / "report.json").read_text())

    return draw


@pytest.mark.parametrize("via", VIAS)
@pytest.mark.parametrize(("scene", "file"), [("wolf", "wolf.spz"), ("playbot", "playbot")])
def test_pictures_match_another_renderers(
    report: Callable[[str, str, str], dict], scene: str, file: str, via: str
) -> None:
    """gsplat's pictures, through 16-bit blending, with the sidecar's order."""
    cameras = report(scene, file, via)["cameras"]
    assert len(cameras) == 2
    for camera in cameras:
        assert camera["order_source"].startswith("sidecar (native")
        assert camera["psnr"] >= 50
        assert camera["ssim"] >= 0.999
        assert camera["flip"] <= 0.02


def test_a_map_that_grew_looks_like_one_that_was_loaded(tmp_path: Path) -> None:
    """1,000 splats a message, some moved, deleted and added again: in the end the same picture."""
    scene = "procedural:20000"
    camera = Camera(
        id=0, width=320, height=240, fx=280.0, fy=280.0, cx=160.0, cy=120.0,
        world_to_camera=look_at((4, 3, 2.5), (0, 0, 0.4)),
    )  # fmt: skip
    pictures = []
    for publisher in (
        ("ply_publisher", "-p", f"path:={scene}"),
        ("slam_emulator", "-p", f"path:={scene}", "-p", "rate:=100.0"),
    ):
        render.render(
            publisher, [camera], log_folder=tmp_path,
            on_picture=lambda _, color, answer: pictures.append((color, answer)),
        )  # fmt: skip
    (loaded, _), (grown, answer) = pictures
    assert answer.revision > 20
    assert metrics.psnr(grown[..., :3], loaded[..., :3]) >= 60
    assert loaded.max() > 0.5


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"id": 4}, "camera 1: id 4 is that of camera 0"),
        ({"width": 8192, "height": 8192}, "camera 1: 8192x8192, expected"),
        ({"image": "none.png"}, "camera 1: .*none.png: No such file"),
        ({"image": "cameras.json"}, "camera 1: .*cameras.json: not a picture"),
        ({"image": "small.png"}, "camera 1: small.png is 6x4, expected 64x48"),
        ({"image": "a\0b"}, "camera 1: .*no name of a file"),
    ],
)
def test_cameras_are_checked_before_anything_starts(
    tmp_path: Path, change: dict[str, object], reason: str
) -> None:
    file = tmp_path / "cameras.json"
    file.write_text("[]")
    cv2.imwrite(str(tmp_path / "small.png"), np.zeros((4, 6, 3), np.uint8))
    good = Camera(4, 64, 48, 60.0, 60.0, 32.0, 24.0, np.eye(4))
    render.check(file, [good])
    with pytest.raises(InputError, match=f"cameras.json: {reason}"):
        render.check(file, [good, replace(good, **({"id": 5} | change))])


def test_what_cannot_be_drawn_is_said_in_a_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cameras = tmp_path / "cameras.json"
    cameras.write_text(
        json.dumps([{"id": 0, "width": 8, "height": 8, "fx": 8, "fy": 8, "cx": 4, "cy": 4,
                     "world_to_camera": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]}])
    )  # fmt: skip
    broken = tmp_path / "broken #2: it's.ply"
    broken.write_bytes(b"ply\nformat binary_little_endian 1.0\nelement vertex 5\n")
    out = str(tmp_path / "out")
    assert render.main([str(tmp_path / "no.ply"), str(cameras), out]) == 1
    assert "no.ply" in capsys.readouterr().err
    assert render.main([str(broken), str(cameras), out]) == 1
    assert str(broken) in capsys.readouterr().err
    cameras.write_text("[]")
    assert render.main([str(broken), str(cameras), out]) == 1
    assert "cameras.json" in capsys.readouterr().err
