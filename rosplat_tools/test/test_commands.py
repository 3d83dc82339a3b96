"""Every executable is a module, too: what runs where no `ros2 run` is."""

import subprocess
import sys
from importlib.metadata import entry_points

import pytest

EXECUTABLES = {
    entry.name: entry.module
    for entry in entry_points(group="console_scripts")
    if entry.module.startswith("rosplat_tools.")
}
DRAWING = {"lab", "viewer"}  # need rviz_gaussian_plugin to begin


@pytest.mark.parametrize("name", EXECUTABLES)
def test_its_module_runs(name: str) -> None:
    if name in DRAWING:
        pytest.importorskip("rviz_gaussian_plugin")
    command = [sys.executable, "-m", EXECUTABLES[name], "--help"]
    helped = subprocess.run(command, capture_output=True, text=True, check=True)
    assert helped.stdout.startswith(f"usage: {name} ")
