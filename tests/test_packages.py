"""What each package.xml says of the package, held against its sources."""

from __future__ import annotations

import ast
import importlib
import re
import subprocess
import sys
from collections.abc import Iterable
from graphlib import TopologicalSorter
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import pytest
import yaml
from ament_index_python.packages import get_packages_with_prefixes

ROOT = Path(__file__).resolve().parents[1]
OURS = sorted(path.parent.name for path in ROOT.glob("*/package.xml"))


class Library(NamedTuple):
    """A Python library from elsewhere."""

    rosdep: str | None
    """Its key, None where rosdep has none."""
    pypi: str


LIBRARIES = {
    "PIL": Library("python3-pil", "pillow"),
    "cv2": Library("python3-opencv", "opencv-python-headless"),
    "flip_evaluator": Library(None, "flip-evaluator"),
    "matplotlib": Library("python3-matplotlib", "matplotlib"),
    "numpy": Library("python3-numpy", "numpy"),
    "pygame": Library("python3-pygame", "pygame"),
    "rich": Library("python3-rich", "rich"),
    "scipy": Library("python3-scipy", "scipy"),
    "skimage": Library("python3-skimage", "scikit-image"),
    "tqdm": Library("python3-tqdm", "tqdm"),
    "yaml": Library("python3-yaml", "pyyaml"),
    "zstandard": Library(None, "zstandard"),
}
# What some machines have and nothing demands: cupy, cuda.core with it, and torch sort on a GPU;
# gsplat, and mujoco_warp with warp, are measured beside ours; rerun shows a map; pxr (usd-core)
# reads OpenUSD; mujoco moves robots; rosbags reads bags where rosbag2_py isn't.
OPTIONAL = {
    "cuda", "cupy", "cupyx", "gsplat", "mujoco", "mujoco_warp", "pxr", "rerun", "rosbags", "torch",
    "warp",
}  # fmt: skip


def named(package: str, *kinds: str) -> set[str]:
    """What the package says it depends on, for whatever or by these kinds of elements."""
    tree = ElementTree.parse(ROOT / package / "package.xml")
    return {
        element.text or ""
        for element in tree.iter()
        if (element.tag in kinds if kinds else element.tag.endswith("depend"))
    }


def imports(files: Iterable[Path]) -> set[str]:
    """First names of the modules that Python files import."""
    names: set[str] = set()
    for path in files:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                names |= {alias.name.partition(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                names.add((node.module or "").partition(".")[0])
    return names


def used(package: str) -> set[str]:
    """First names of modules and headers that the package's sources name."""
    files = list((ROOT / package).rglob("*"))
    if package == "rosplat_lab":  # whose tests those across packages are
        files += (ROOT / "tests").glob("*.py")
    names = imports(path for path in files if path.suffix == ".py")
    for path in files:
        if path.suffix in (".cpp", ".hpp"):
            names |= set(re.findall(r"#include [<\"](\w+)/", path.read_text()))
        elif path.suffix == ".rviz":  # plugins are classes of packages
            names |= set(re.findall(r"Class: (\w+)", path.read_text()))
    return names


def libraries(package: str) -> set[Library]:
    """What the package's Python imports from elsewhere when it runs."""
    names = imports((ROOT / package / package).rglob("*.py"))
    ros = set(get_packages_with_prefixes()) | named(package)  # here, or said to be elsewhere
    elsewhere = names - sys.stdlib_module_names - ros - OPTIONAL
    assert elsewhere <= LIBRARIES.keys()
    return {LIBRARIES[name] for name in elsewhere}


def required(file: str) -> set[str]:
    """The projects of PyPI that a file of requirements names."""
    lines = (ROOT / "requirements" / file).read_text().splitlines()
    return {match[0] for line in lines if (match := re.match(r"[\w-]+", line))}


@pytest.mark.parametrize("package", OURS)
def test_a_package_names_all_ros_packages_that_it_uses(package: str) -> None:
    ros_packages = set(get_packages_with_prefixes()) - {package}
    assert used(package) & ros_packages <= named(package)


@pytest.mark.parametrize("package", OURS)
def test_a_package_names_the_libraries_that_it_imports_and_no_others(package: str) -> None:
    known = {library.rosdep for library in LIBRARIES.values()}
    says = named(package, "depend", "exec_depend") & known
    assert says == {library.rosdep for library in libraries(package) if library.rosdep}


def test_requirements_are_what_is_imported() -> None:
    runtime = {
        library.pypi
        for package in OURS
        for library in libraries(package)
        if package != "rosplat_lab"
    }
    assert required("runtime.txt") == runtime | {"pybind11"}  # which builds
    assert required("lab.txt") == {library.pypi for library in libraries("rosplat_lab")} - runtime


def test_the_engine_by_itself_needs_what_it_imports() -> None:
    project = (ROOT / "rosplat_core/pyproject.toml").read_text()  # tomllib isn't in Python 3.10
    (listed,) = re.findall(r"^dependencies = (\[.*\])$", project, re.MULTILINE)
    needed = {library.pypi for library in libraries("rosplat_core")}
    assert ast.literal_eval(listed) == sorted(needed)


def test_a_robot_s_packages_need_nothing_that_draws_or_measures() -> None:
    needed = {"rosplat_tools"}
    while more := set().union(*(named(package) for package in needed & set(OURS))) - needed:
        needed |= more
    folder = ROOT / "rosplat_tools/rosplat_tools"
    names = [path.stem for path in folder.glob("*.py") if path.stem != "__init__"]
    names += [path.parent.name for path in folder.glob("*/__init__.py")]
    modules = ", ".join(f"rosplat_tools.{name}" for name in names)
    code = f"import sys, {modules}; print(*sys.modules)"
    imported = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True)
    loaded = set(imported.stdout.decode().split())
    assert "rosplat_ros.map_publisher" in loaded
    assert not [name for name in needed | loaded if name.startswith(("rviz", "rosplat_lab"))]


def test_no_module_is_called_like_one_of_python_s_own() -> None:
    """Else it hides that one from all that runs with the module's folder on the path."""
    modules = [path for package in OURS for path in (ROOT / package / package).rglob("*.py")]
    assert not [path for path in modules if path.stem in sys.stdlib_module_names]


def test_no_package_depends_on_one_that_depends_on_it() -> None:
    TopologicalSorter({package: named(package) & set(OURS) for package in OURS}).prepare()


@pytest.mark.parametrize("package", OURS)
def test_a_package_is_fit_for_release(package: str) -> None:
    """It brings licence and changelog, has the version of all, and needs nothing from pip."""
    folder = ROOT / package
    manifest = ElementTree.parse(folder / "package.xml")
    version = manifest.findtext("version")
    core = (ROOT / "rosplat_core/pyproject.toml").read_text()
    assert f'version = "{version}"' in core
    headings = re.findall(r"^(\d+\.\d+\.\d+) \(", (folder / "CHANGELOG.rst").read_text(), re.M)
    assert headings[0] == version
    assert (folder / "LICENSE").read_bytes() == (ROOT / "LICENSE").read_bytes()
    kinds = {url.get("type") for url in manifest.iter("url")}
    assert kinds == {"website", "repository", "bugtracker"}
    assert not [key for key in named(package) if key.endswith("-pip")]  # bloom refuses them


PUBLIC = ("rosplat_core", "rosplat_ros", "rosplat_sorter", "rosplat_tools", "rviz_gaussian_plugin")


@pytest.mark.parametrize("package", PUBLIC)
def test_a_public_interface_has_what_it_names(package: str) -> None:
    module = importlib.import_module(package)
    assert module.__all__ == sorted(module.__all__)
    assert set(module.__all__) <= set(dir(module))  # whose names are loaded at first use, too
    for name in module.__all__:
        assert getattr(module, name).__doc__
    assert not hasattr(module, "anything_else")
    assert (Path(module.__file__ or "").parent / "py.typed").exists()


def test_the_api_s_page_has_the_public_interface_and_nothing_else() -> None:
    page = (ROOT / "docs/api/python.md").read_text()
    shown = re.findall(r"^\.\. auto\w+:: (\S+)$", page, re.MULTILINE)
    public = {
        f"{package}.{name}"
        for package in PUBLIC
        for name in importlib.import_module(package).__all__
    }
    assert set(shown) == public
    assert len(shown) == len(public)


def test_readme_and_guides_use_the_public_interface_alone() -> None:
    pages = [ROOT / "README.md", *(ROOT / "docs/guides").glob("*.md")]
    used = re.compile(r"^(?:from|import) (rosplat_(?:core|ros|sorter|tools)\.\w+)", re.MULTILINE)
    assert not [found for page in pages for found in used.findall(page.read_text())]
    headers = re.compile(r"#include <(rosplat_\S+)>")
    for page in pages:
        for header in headers.findall(page.read_text()):
            assert f"`{header}`" in (ROOT / "CONTRIBUTING.md").read_text()


def test_readme_and_quality_declaration_name_the_releases_of_ros_that_are_tested() -> None:
    """Those of the workflows, and no others."""
    workflow = yaml.safe_load((ROOT / ".github/workflows/ci.yml").read_text())["jobs"]
    debian = workflow["make"]["strategy"]["matrix"]["ros"]
    assert debian == ["wheels", "kilted-wheels"]
    releases = set(workflow["ros"]["strategy"]["matrix"]["ros"])
    rows = [
        line
        for page in ("README.md", "QUALITY_DECLARATION.md")
        for line in (ROOT / page).read_text().splitlines()
        if re.match(r"\| (ROS 2|6 Platforms) \|", line)
    ]
    assert len(rows) == 2
    known = "Foxy|Galactic|Humble|Iron|Jazzy|Kilted|Lyrical|Rolling"
    for row in rows:
        assert {name.lower() for name in re.findall(rf"\b({known})\b", row)} == releases
