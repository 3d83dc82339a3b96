"""What users attach to an issue: that it names the driver, and finds pictures right."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rviz_gaussian_plugin._offscreen", reason="the renderer is not built")

COMMAND = [sys.executable, "-m", "rviz_gaussian_plugin.graphics_report"]


def _report(**environment: str) -> str:
    ran = subprocess.run(
        COMMAND,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        env=os.environ | environment,
    )
    if "X display" in ran.stderr:
        pytest.skip(ran.stderr.strip())
    assert ran.returncode == 0, ran.stderr
    return ran.stdout


def test_names_the_driver_and_draws_right() -> None:
    report = _report()
    for what in ("vendor", "renderer", "version", "GLSL", "extensions", "subgroups"):
        assert re.search(rf"^{what}.*: .", report, re.MULTILINE), what
    assert "unknown" not in re.findall(r"^most .*: (\w+)$", report, re.MULTILINE)
    found = re.search(r"^  tiles: tiles, .* (\d+) dB$", report, re.MULTILINE)
    assert found and int(found[1]) >= 60, report


def test_draws_right_with_a_second_driver(tmp_path: Path) -> None:
    """Zink translates OpenGL to Vulkan, which lavapipe draws with the processor."""
    drivers = list(Path("/usr/share/vulkan/icd.d").glob("lvp_icd.*.json"))
    if not drivers:
        pytest.skip("lavapipe is not installed")
    report = _report(
        MESA_LOADER_DRIVER_OVERRIDE="zink",
        LIBGL_ALWAYS_SOFTWARE="1",
        VK_ICD_FILENAMES=str(drivers[0]),
        XDG_RUNTIME_DIR=str(tmp_path),
    )
    assert re.search(r"^renderer: zink", report, re.MULTILINE), report
    found = re.search(r"^  tiles: tiles, .* (\d+) dB$", report, re.MULTILINE)
    assert found and int(found[1]) >= 60, report


def test_a_picture_of_no_numbers_equals_none() -> None:
    from rviz_gaussian_plugin.graphics_report.command import _drawn

    drawn = {"rasterizer": "tiles", "order_source": "gpu"}
    picture = np.full((2, 2, 4), np.nan, np.float32)
    renderer: Any = SimpleNamespace(
        draw=lambda *_, **__: drawn, read_color=lambda: picture, error="", warning=""
    )
    assert _drawn(renderer, np.zeros_like(picture)) == "tiles, order of gpu, nan dB"
    picture = np.zeros_like(picture)
    assert _drawn(renderer, picture) == "tiles, order of gpu, equal"


def test_says_why_the_processor_draws() -> None:
    report = _report(GALLIUM_DRIVER="softpipe")
    if "renderer: softpipe" not in report:
        pytest.skip("Mesa's softpipe is not installed")
    assert re.search(r"^  tiles: processor, .*; .*OpenGL 4\.4 is needed", report, re.MULTILINE), (
        report
    )


def test_says_in_a_line_why_nothing_is_drawn() -> None:
    nowhere = {k: v for k, v in os.environ.items() if k != "DISPLAY"} | {"PATH": "/nowhere"}
    ran = subprocess.run(
        COMMAND, capture_output=True, text=True, timeout=60, check=False, env=nowhere
    )
    assert ran.returncode == 1 and not ran.stdout
    assert re.fullmatch(r"graphics_report: .*Xvfb.*\n", ran.stderr), ran.stderr
