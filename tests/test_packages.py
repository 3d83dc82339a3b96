"""What each package.xml says of the package, held against its sources."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from graphlib import TopologicalSorter
from pathlib import Path
from xml.etree import ElementTree

import pytest
from ament_index_python.packages import get_packages_with_prefixes

ROOT = Path(__file__).resolve().parents[1]
OURS = sorted(path.parent.name for path in ROOT.glob("*/package.xml"))


def named(package: str) -> set[str]:
    """What the package says it depends on, for whatever."""
    tree = ElementTree.parse(ROOT / package / "package.xml")
    return {element.text or "" for element in tree.iter() if element.tag.endswith("depend")}


def used(package: str) -> set[str]:
    """First names of modules and headers that the package's sources name."""
    names: set[str] = set()
    for path in (ROOT / package).rglob("*"):
        if path.suffix == ".py":
            for node in ast.walk(ast.parse(path.read_text())):
                if isinstance(node, ast.Import):
                    names |= {alias.name.partition(".")[0] for alias in node.names}
                elif isinstance(node, ast.ImportFrom):
                    names.add((node.module or "").partition(".")[0])
        elif path.suffix in (".cpp", ".hpp"):
            names |= set(re.findall(r"#include [<\"](\w+)/", path.read_text()))
        elif path.name.endswith((".launch.xml", ".rviz")):  # plugins are classes of packages
            names |= set(re.findall(r"(?:pkg=\"|Class: )(\w+)", path.read_text()))
    return names


# What draws in the first works where the second is, which depends on it.
OPTIONAL = {"rosplat_tools": "rviz_gaussian_plugin"}

# Parts of rosplat_tools for a robot without a screen.
HEADLESS = ["convert", "demo_sensors", "inspect", "map_publisher", "ply_publisher", "slam_emulator"]


@pytest.mark.parametrize("package", OURS)
def test_a_package_names_all_ros_packages_that_it_uses(package: str) -> None:
    ros_packages = set(get_packages_with_prefixes()) - {package}
    named_for_it = named(package)
    if package in OPTIONAL:
        named_for_it |= {OPTIONAL[package]} | named(OPTIONAL[package])
    assert used(package) & ros_packages <= named_for_it


def test_a_robot_s_packages_need_no_rviz() -> None:
    needed = {"rosplat_tools"}
    while more := set().union(*(named(package) for package in needed & set(OURS))) - needed:
        needed |= more
    modules = ", ".join(f"rosplat_tools.{name}" for name in HEADLESS)
    code = f"import sys, {modules}; print(*sys.modules)"
    imported = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True)
    needed |= set(imported.stdout.decode().split())
    assert "rosplat_tools.map_publisher" in needed
    assert not [name for name in needed if name.startswith("rviz")]


def test_no_package_depends_on_one_that_depends_on_it() -> None:
    TopologicalSorter({package: named(package) & set(OURS) for package in OURS}).prepare()
