"""What users attach to an issue: that it names the driver, and finds pictures right."""

from __future__ import annotations

import os
import re
import subprocess
import sys

import pytest

pytest.importorskip("rviz_gaussian_plugin._offscreen", reason="the renderer is not built")

COMMAND = [sys.executable, "-m", "rviz_gaussian_plugin.graphics_report"]


def test_names_the_driver_and_draws_right() -> None:
    ran = subprocess.run(COMMAND, capture_output=True, text=True, timeout=120, check=False)
    if "X display" in ran.stderr:
        pytest.skip(ran.stderr.strip())
    assert ran.returncode == 0, ran.stderr
    for what in ("vendor", "renderer", "version", "GLSL", "extensions", "subgroups"):
        assert re.search(rf"^{what}.*: .", ran.stdout, re.MULTILINE), what
    assert "unknown" not in re.findall(r"^most .*: (\w+)$", ran.stdout, re.MULTILINE)
    found = re.search(r"^  tiles: tiles, .* (\d+) dB$", ran.stdout, re.MULTILINE)
    assert found and int(found[1]) >= 60, ran.stdout


def test_says_in_a_line_why_nothing_is_drawn() -> None:
    nowhere = {k: v for k, v in os.environ.items() if k != "DISPLAY"} | {"PATH": "/nowhere"}
    ran = subprocess.run(
        COMMAND, capture_output=True, text=True, timeout=60, check=False, env=nowhere
    )
    assert ran.returncode == 1 and not ran.stdout
    assert re.fullmatch(r"graphics_report: .*Xvfb.*\n", ran.stderr), ran.stderr
