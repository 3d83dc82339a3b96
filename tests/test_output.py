"""Commands whose output is a pipe that closes, as `head` closes it, end quietly."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest


def _program(name: str) -> tuple[str, str]:
    """What Python is told to run a program of rosplat_tools."""
    return "-c", f"import sys; from rosplat_tools.commands import {name}; sys.exit({name}())"


@pytest.mark.parametrize(
    "command",
    [(*_program("inspect"), "procedural:10"), (*_program("generate"), "made.ply", "--count", "9"),
     ("-m", "rosplat_lab.bench", "sort", "--sizes", "9", "--seconds", "0", "--backends", "numpy")],
)  # fmt: skip
def test_nothing_is_said_where_nobody_reads(command: tuple[str, ...], tmp_path: Path) -> None:
    reading, writing = os.pipe()
    os.close(reading)
    ended = subprocess.run(
        [sys.executable, *command],
        stdout=writing, stderr=subprocess.PIPE, text=True, cwd=tmp_path, check=False,
    )  # fmt: skip
    os.close(writing)
    assert (ended.stderr, ended.returncode) == ("", 1)


@pytest.mark.parametrize("command", ["inspect procedural:10", "inspect --help", "generate --help"])
def test_a_full_disk_is_a_line_and_code_1(command: str) -> None:
    program, *arguments = command.split()
    with Path("/dev/full").open("w") as full:
        ended = subprocess.run(
            [sys.executable, *_program(program), *arguments],
            stdout=full, stderr=subprocess.PIPE, text=True, check=False,
            env={name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"},
        )  # fmt: skip
    assert ended.stderr == "can't print: No space left on device\n"
    assert ended.returncode == 1
