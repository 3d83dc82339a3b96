"""The laboratory end to end, on a small scene: the real renderer, the report, and a second run."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from rosplat_lab.lab.command import main
from rosplat_lab.lab.points import load
from rosplat_testing import PATIENCE

AGE = re.compile(r", \d+ frames old")


def test_methods_are_measured_once_and_reported(tmp_path: Path) -> None:
    command = [
        sys.executable, "-m", "rosplat_lab.lab", "procedural:3000", "--out", str(tmp_path),
        "--cameras", "1", "--width", "160", "--height", "90", "--threads", "1", "--repeats", "1",
        "--part", "chart",
    ]  # fmt: skip
    run = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert run.returncode == 0, run.stderr
    points = load(tmp_path / "lab.json")
    methods = {point.method for point in points}
    assert len(methods) >= 50
    assert len(points) == len(methods)
    by_method = {point.method: point for point in points}

    def psnr(method: str) -> float:
        return by_method[method].psnr

    # The real renderer is as good as its arithmetic, and each loss is seen for what it is.
    assert psnr("sorter native") > 70
    assert psnr("sorter native") == psnr("sorter numpy") == psnr("keys z 32 bit")
    assert psnr("keys linear 20 bit") > psnr("keys linear 12 bit") > psnr("keys linear 8 bit")
    aged = [f"rotation at 1/s, {frames} frames old" for frames in (1, 10)]
    assert psnr(aged[0]) > psnr(aged[1]) > psnr("unsorted")
    assert psnr("stochastic 64") > psnr("stochastic 1")
    assert psnr("budget 90%") > psnr("budget 25%")
    assert by_method["stochastic 1"].ms is None
    native = by_method["sorter native"]
    assert native.pose_ms and native.ms and native.draw_ms
    assert native.ms > native.draw_ms > 0
    # An order that is drawn ten frames late is ten frames old, whatever it costs.
    assert (by_method[aged[1]].pose_ms or 0) > 10_000 / 60
    assert 10 < psnr("RVizSplat 1.0.0") < 45

    page = (tmp_path / "lab.html").read_text()
    assert "http-equiv" not in page and 'src="http' not in page  # needs nothing else
    assert all(method in page for method in methods)
    assert (tmp_path / "accuracy.png").stat().st_size < 300_000

    table = (tmp_path / "accuracy.md").read_text()
    assert all(f"| {AGE.sub('', method)}" in table for method in methods)

    # Drawn again from what is kept, which is rounded: the same rows.
    drawing = [*command[:3], "--points", str(tmp_path / "lab.json"), "--out", str(tmp_path / "b")]
    subprocess.run(drawing, check=True, timeout=300)
    again_drawn = (tmp_path / "b" / "accuracy.md").read_text()
    assert _first_cells(again_drawn) == _first_cells(table)

    kept = (tmp_path / "points.jsonl").read_bytes()
    again = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert again.returncode == 0, again.stderr
    assert (tmp_path / "points.jsonl").read_bytes() == kept  # nothing was measured anew


def _first_cells(table: str) -> list[str]:
    return [line.split("|")[1] for line in table.splitlines() if line.startswith("|")]


def test_an_interrupted_run_ends_at_once_and_quietly(tmp_path: Path) -> None:
    process = subprocess.Popen(
        [sys.executable, "-m", "rosplat_lab.lab", "procedural:300000", "--out", str(tmp_path)],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True,
        env={name: value for name, value in os.environ.items() if name != "DISPLAY"},
    )  # fmt: skip
    assert process.stderr
    before = ""
    while ": reference: " not in before:  # workers begin
        before = process.stderr.readline()
        assert before
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does
    _, said = process.communicate(timeout=PATIENCE)
    assert process.returncode == 130
    assert said == ""


@pytest.mark.parametrize(
    "arguments",
    [
        ["--width", "-5"], ["--height", "99999"], ["--up", "0", "0", "0"], ["--cameras", "0"],
        ["--width", "16384", "--height", "16384"], ["--repeats", "0"], ["--threads", "-1"],
    ],
)  # fmt: skip
def test_an_option_that_makes_no_sense_is_named(
    arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        main(arguments)
    assert arguments[0] in capsys.readouterr().err.splitlines()[-1]


def test_a_scene_that_is_not_there_is_named(tmp_path: Path) -> None:
    run = subprocess.run(
        [sys.executable, "-m", "rosplat_lab.lab", "nowhere.ply", "--out", str(tmp_path)],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert run.returncode == 1
    assert run.stderr == "lab: nowhere.ply: No such file or directory\n"
