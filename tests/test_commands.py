"""Commands run by their names; the lab's and the plugin's as modules, too."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from ament_index_python.packages import get_package_prefix

COMMANDS = [
    (package, path)
    for package in ("rosplat_tools", "rviz_gaussian_plugin", "rosplat_lab")
    for path in sorted((Path(get_package_prefix(package)) / "lib" / package).iterdir())
    if path.read_bytes().startswith(b"#!")
]


@pytest.mark.parametrize(("package", "path"), COMMANDS, ids=[path.name for _, path in COMMANDS])
def test_it_runs(package: str, path: Path) -> None:
    calls = [[str(path)]]
    if package != "rosplat_tools":
        calls.append([sys.executable, "-m", f"{package}.{path.name}"])
    for command in calls:
        helped = subprocess.run([*command, "--help"], capture_output=True, text=True, check=True)
        assert helped.stdout.startswith(f"usage: {path.name} ")


def test_bench_measures_in_processes_of_its_own(tmp_path: Path) -> None:
    """Each of which runs the script once more."""
    (bench,) = (path for _, path in COMMANDS if path.name == "bench")
    arguments = ["frame", "--variants", "cpu", "--sizes", "1000", "--quick"]
    subprocess.run([bench, *arguments, "--out", str(tmp_path)], check=True)
    assert json.loads((tmp_path / "frame.json").read_text())


@pytest.mark.parametrize(
    "module",
    [f"{package}.{path.name}.__main__" for package, path in COMMANDS if package != "rosplat_tools"],
)
def test_what_takes_long_to_load_is_loaded_where_an_interrupt_is_quiet(module: str) -> None:
    """As run_module does it, which rosplat_tools.commands are made of."""
    loaded = f"import sys, {module}; sys.exit('numpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", loaded], check=False).returncode == 0


@pytest.mark.parametrize(
    "module", ["rosplat_tools.cameras.camera", "rviz_gaussian_plugin.viewer.command"]
)
def test_scipy_is_loaded_where_it_is_needed(module: str) -> None:
    """It takes as long as all else that these programs load at their start."""
    loaded = (
        f"import sys, {module}; sys.exit(any(name.startswith('scipy.') for name in sys.modules))"
    )
    assert subprocess.run([sys.executable, "-c", loaded], check=False).returncode == 0
