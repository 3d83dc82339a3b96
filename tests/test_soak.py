"""What `make soak` does for hours, once in small: every fault strikes, and is survived."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path


def test_every_fault_is_survived(tmp_path: Path) -> None:
    """In a process of its own, which moves to a network namespace."""
    program = Path(__file__).with_name("soak.py")
    ended = subprocess.run(
        [sys.executable, program, "--minutes", "0.1", "--out", tmp_path],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert ended.returncode == 0, ended.stdout + ended.stderr
