"""What `make soak` does for hours, once in small: every fault strikes, and is survived."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from line import Line, NoLine

from rviz_gaussian_plugin.offscreen import ensure_display


def test_every_fault_is_survived(tmp_path: Path) -> None:
    """In a process of its own, which moves to a network namespace."""
    program = Path(__file__).with_name("soak.py")
    ended = subprocess.run(
        [sys.executable, program, "--minutes", "0.1", "--out", tmp_path],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert ended.returncode == 0, ended.stdout + ended.stderr


def test_a_display_is_out_of_reach_of_another_machine() -> None:
    """An Xvfb there would take its number, and its socket."""
    look = ["sh", "-c", "ls /tmp/.X11-unix; echo display $DISPLAY"]
    with ensure_display():
        try:
            with Line("1gbit") as line:
                there = subprocess.run(line.at("there", look), capture_output=True, check=True)
        except NoLine as error:
            pytest.skip(str(error))
    assert there.stdout.split() == [b"display"]
