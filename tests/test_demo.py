"""`make demo` without a display: pictures, a line of figures, and nothing left running."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from rosplat_testing import PATIENCE


def start(scene: str, out: Path) -> subprocess.Popen[str]:
    # Without a display and without rviz2, as on a server.
    environment = {name: value for name, value in os.environ.items() if name != "DISPLAY"}
    return subprocess.Popen(
        [sys.executable, "-m", "rviz_gaussian_plugin.demo", scene, "--host", "--out", str(out)],
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


def programs_of(out: Path) -> list[str]:
    """Programs that still write their log into the folder."""
    found = []
    for descriptor in Path("/proc").glob("[0-9]*/fd/1"):
        try:
            if descriptor.readlink().is_relative_to(out):
                found.append((descriptor.parents[1] / "cmdline").read_text())
        except OSError:  # it ended meanwhile, or is another user's
            continue
    return found


def test_pictures_and_figures(tmp_path: Path) -> None:
    out = tmp_path / "pictures #2"
    output, _ = (process := start("procedural:5000", out)).communicate(timeout=PATIENCE)
    assert process.returncode == 0
    assert (out / "demo.png").stat().st_size > 10_000
    assert (out / "demo.webp").stat().st_size > 10_000
    figures = next(line for line in output.splitlines() if "splats" in line)
    assert "5,000 splats" in figures
    assert re.search(r"sorted by (processor|gpu)", figures)
    assert " in 0.0 ms" not in figures  # what nobody has measured
    assert "order age" in figures
    assert not programs_of(tmp_path)


def test_a_scene_that_is_none_is_named_in_a_line(tmp_path: Path) -> None:
    scene = "/nowhere/scene #2: it's.ply"
    output, _ = (process := start(scene, tmp_path)).communicate(timeout=PATIENCE)
    assert process.returncode == 1
    assert len(output.strip().splitlines()) == 1
    assert scene in output
    assert not programs_of(tmp_path)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_all_of_it(tmp_path: Path, number: signal.Signals) -> None:
    process = start("procedural:300000", tmp_path)
    deadline = time.monotonic() + PATIENCE
    while len(programs_of(tmp_path)) < 2:
        assert time.monotonic() < deadline
        time.sleep(0.05)
    time.sleep(1)
    process.send_signal(number)
    output, _ = process.communicate(timeout=PATIENCE)
    assert "Traceback" not in output
    assert not programs_of(tmp_path)
