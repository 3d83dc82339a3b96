"""What each package.xml says of the package, held against its sources."""

from __future__ import annotations

import ast
import re
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


@pytest.mark.parametrize("package", OURS)
def test_a_package_names_all_ros_packages_that_it_uses(package: str) -> None:
    ros_packages = set(get_packages_with_prefixes()) - {package}
    assert used(package) & ros_packages <= named(package)


def test_no_package_depends_on_one_that_depends_on_it() -> None:
    TopologicalSorter({package: named(package) & set(OURS) for package in OURS}).prepare()
