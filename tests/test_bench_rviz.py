"""What `bench rviz` measures in a real rviz2: frames that were drawn, of the right picture."""

import math
import shutil
import time
from collections import Counter
from itertools import product
from pathlib import Path

import pytest

from rosplat_lab.bench.command import main
from rosplat_lab.bench.records import load
from rviz_harness import Rviz, configuration, map_display, needs_rviz

pytestmark = needs_rviz

# As rviz saves them, and one that isn't there.
DISPLAYS = """\
- Class: rviz_gaussian_plugin/GaussianMap
  Name: exact
  Enabled: true
  Value: true
  SH Degree: "{sh_degree}"
  Topic: {Value: "{topic}", Depth: 5}
- Class: nowhere/Nothing
  Name: nothing
"""


def test_displays_are_measured_beside_each_other(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "displays.yaml"
    file.write_text(DISPLAYS)
    arguments = ["rviz", "--quick", "--sizes", "2k", "--displays", str(file)]
    assert main([*arguments, "--out", str(tmp_path)]) == 0
    assert "no nowhere/Nothing" in capsys.readouterr().out
    records = load([tmp_path / "rviz.json"])
    frames = {(r.parameters["display"], r.parameters["camera"]): r for r in records
              if r.name == "frame"}  # fmt: skip
    assert set(frames) == {
        (display, camera) for display in ("ROSplat", "exact") for camera in ("standing", "moving")
    }
    assert all(record.n >= 3 and record.least > 0 for record in frames.values())
    accuracy = {r.parameters["display"]: r.value for r in records if r.name == "PSNR"}
    assert accuracy.keys() == {"ROSplat", "exact"} and min(accuracy.values()) > 55

    # With the mouse, where no graphics card draws.
    if "llvmpipe" not in records[0].gpu or not shutil.which("xdotool"):
        return
    dragged = [r for r in records if r.name == "frame by mouse"]
    cases = Counter((r.parameters["map"], r.parameters["grid"]) for r in dragged)
    assert cases == dict.fromkeys(product((False, True), repeat=2), 2)  # of both displays
    ages = [r for r in records if r.name == "age by mouse"]
    assert ages and all(r.parameters["map"] for r in ages)  # so the view did turn
    spent = {(r.parameters["threads"], r.parameters["map"]): r.value for r in records
             if r.name == "processor time by mouse"}  # fmt: skip
    assert spent["painter", True] > 1 > spent.get(("painter", False), 0)
    assert spent["render thread", False] > 0 and spent["llvmpipe", True] > 0


def test_a_watch_counts_frames_and_turns_the_camera(running_rviz: Rviz) -> None:
    running_rviz.load(configuration(map_display(), view="{Class: rviz_default_plugins/Orbit}"))
    began = time.monotonic()
    running_rviz.ask("start watch", turn=0.1)
    before = running_rviz.properties(root="view")["Yaw"]
    while running_rviz.ask("frames") < 5:
        time.sleep(0.05)
    seen = running_rviz.ask("stop watch")
    passed = time.monotonic() - began
    turned = math.remainder(running_rviz.properties(root="view")["Yaw"] - before, 2 * math.pi)
    assert len(seen["frame"]) >= 4 and len(seen["drawing"]) == len(seen["frame"]) + 1
    assert 0 < sum(seen["frame"]) < 1e3 * passed
    assert 0 < turned < 0.1 * passed
