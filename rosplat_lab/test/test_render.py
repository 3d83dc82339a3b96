"""The report of `render`, where pictures are equal and where there is no git."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from rosplat_core.cameras import Camera, save_cameras
from rosplat_core.rendering import MOST_PSNR
from rosplat_core.splats import InputError
from rosplat_lab.render.command import check, main, write_picture, write_report


def test_a_report_is_json_for_whoever_reads_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", "")  # without git
    monkeypatch.setenv("ROSPLAT_COMMIT", "abc")
    rows: list[dict[str, object]] = [{"camera": 3}, {"camera": 4, "psnr": MOST_PSNR}]
    write_report(tmp_path / "report.json", {"via": "host"}, rows)
    report = json.loads((tmp_path / "report.json").read_text(), parse_constant=pytest.fail)
    assert (report["via"], report["commit"]) == ("host", "abc")
    assert report["cameras"] == [{"camera": 3}, {"camera": 4, "psnr": MOST_PSNR}]


@pytest.mark.parametrize("form", ["png16", "png8", "npy"])
def test_a_picture_is_written_whole_or_not_at_all(tmp_path: Path, form: str) -> None:
    color = np.random.default_rng(0).uniform(size=(4, 5, 4)).astype(np.float32)
    path = write_picture(tmp_path / "3", color, form)
    assert list(tmp_path.iterdir()) == [path]
    if form == "npy":
        read = np.load(path)
    else:
        read = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)[..., ::-1].astype(np.float32)
        read /= 65535 if form == "png16" else 255
    np.testing.assert_allclose(read, color[..., : read.shape[2]], atol=1 / 255)
    with pytest.raises(OSError, match=f"none/3.{form[:3]}'"):
        write_picture(tmp_path / "none" / "3", color, form)


def test_a_picture_that_is_too_small_to_compare_is_refused_before_drawing(tmp_path: Path) -> None:
    cameras = [
        Camera(height, 16, height, 20.0, 20.0, 8.0, height / 2, np.eye(4), image=f"{height}.png")
        for height in (11, 10)
    ]
    for camera in cameras:
        cv2.imwrite(str(tmp_path / f"{camera.height}.png"), np.zeros((camera.height, 16), np.uint8))
    check(tmp_path / "cameras.json", cameras[:1])
    with pytest.raises(
        InputError, match=r"camera 1: 10\.png is 16x10, expected sides of at least 11"
    ):
        check(tmp_path / "cameras.json", cameras)


def test_rviz_s_display_is_not_asked_for_panoramas(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    panorama = Camera(0, 64, 32, 10.0, 10.0, 32.0, 16.0, np.eye(4), model="equirectangular")
    save_cameras(tmp_path / "cameras.json", [panorama])
    files = ["procedural:10", str(tmp_path / "cameras.json"), str(tmp_path / "out")]
    assert main([*files, "--via", "rviz"]) == 1
    assert "camera 0: equirectangular has no pinhole picture" in capsys.readouterr().err
