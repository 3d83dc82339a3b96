"""What may include what: packages, rooms of the engine in a line, no ROS in it."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
CORE = ROOT / "rosplat_core"
BELOW = {  # what each package may name; the sorter, the tools and the display stand side by side
    "rosplat_core": set(),
    "rosplat_msgs": set(),
    "rosplat_ros": {"rosplat_core", "rosplat_msgs"},
    "rosplat_sorter": {"rosplat_core", "rosplat_msgs", "rosplat_ros"},
    "rosplat_tools": {"rosplat_core", "rosplat_msgs", "rosplat_ros"},
    "rviz_gaussian_plugin": {"rosplat_core", "rosplat_msgs", "rosplat_ros"},
}
BELOW["rosplat_lab"] = set(BELOW)
PACKAGES = tuple(BELOW)
ROOMS = (
    "threads", "slots", "map", "views", "order", "occupancy", "levels", "raster", "refit",
    "painter", "python",
)  # fmt: skip
PLUGIN_ROOMS = ("splats/gl", "splats/gpu", "splats", "display")
ELSEWHERE = re.compile(
    r"#include <(?:Ogre|epoxy/|GL/|rcl|rclcpp/|rviz_|[a-z_]+_msgs/)|^\s*(?:from|import) "
    r"(?:rclpy|ament_|rviz_|[a-z_]+_msgs|OpenGL|moderngl)\b",
    re.MULTILINE,
)


ENUMERATORS = re.compile(r"enum [^{]*{([^}]*)}")


def sources(folder: Path) -> list[Path]:
    found = [p for p in folder.rglob("*") if p.suffix in (".py", ".pyi", ".cpp", ".hpp")]
    assert found
    return found


def named(path: Path) -> set[str]:
    """First names of what a source includes or imports."""
    text = path.read_text()
    return {
        *re.findall(r"#include [\"<](\w+)/", text),
        *re.findall(r"^\s*(?:from|import) (\w+)", text, re.MULTILINE),
    }


def test_the_engine_knows_no_ros_no_ogre_and_no_opengl() -> None:
    folders = (CORE / "include", CORE / "src", CORE / "rosplat_core")
    for path in (path for folder in folders for path in sources(folder)):
        assert not ELSEWHERE.search(path.read_text()), path


def test_only_the_binding_knows_python() -> None:
    for path in sources(CORE / "include") + sources(CORE / "src"):
        if path.parent.name != "python":
            assert not re.search(r"pybind11|Python\.h", path.read_text()), path


def test_what_touches_the_gpl_is_the_imu_panel_alone() -> None:
    plugin = ROOT / "rviz_gaussian_plugin/src"
    qcustomplot = re.compile(r"qcustomplot|\bQCP|\bQCustomPlot|imu_panel", re.IGNORECASE)
    touching = {path.parent for path in sources(plugin) if qcustomplot.search(path.read_text())}
    assert touching == {plugin / "imu_panel"}
    for manifest in ROOT.glob("*/package.xml"):
        assert not re.search(r"depend>[^<]*qcustomplot", manifest.read_text())


def test_releases_of_ros_are_told_apart_in_one_header() -> None:
    asked = [path for package in PACKAGES for path in (ROOT / package).rglob("*.[ch]pp")]
    version = re.compile(r"^#.*_VERSION(_MAJOR)? [<>=]", re.MULTILINE)
    telling = [path.name for path in asked if version.search(path.read_text())]
    assert telling == ["ros_versions.hpp"]


@pytest.mark.parametrize("package", PACKAGES)
def test_a_package_names_only_packages_below_it(package: str) -> None:
    """Tests may look up: they hold an engine against what draws with it."""
    others = set(PACKAGES) - BELOW[package] - {package}
    folder = ROOT / package
    for path in folder.rglob("*"):
        if path.suffix in (".py", ".cpp", ".hpp") and "test" not in path.relative_to(folder).parts:
            assert not named(path) & others, path
    manifest = (folder / "package.xml").read_text()
    needed = set(re.findall(r"<(?:build_|exec_)?depend>(\w+)<", manifest))
    assert not needed & others


@pytest.mark.parametrize("room", ROOMS)
def test_rooms_of_the_engine_stand_in_a_line(room: str) -> None:
    later = set(ROOMS[ROOMS.index(room) + 1 :])
    include = re.compile(r"#include \"(?:rosplat_core/)?(\w+)/")
    found = [p for top in ("include/rosplat_core", "src") for p in (CORE / top / room).glob("*")]
    assert found
    for path in found:
        assert not set(include.findall(path.read_text())) & later, path


@pytest.mark.parametrize("room", PLUGIN_ROOMS)
def test_rooms_of_the_plugin_stand_in_a_line(room: str) -> None:
    """The display knows no OpenGL, either."""
    source = ROOT / "rviz_gaussian_plugin/src"
    later = PLUGIN_ROOMS[PLUGIN_ROOMS.index(room) + 1 :]
    above = {header.name for name in later for header in (source / name).glob("*.hpp")}
    found = list((source / room).glob("*.[ch]pp"))
    assert found
    for path in found:
        includes = re.findall(r"#include [\"<]((?!rosplat_core/)[\w/.]+)", path.read_text())
        assert not {Path(name).name for name in includes} & above, path
        if room == "display":
            assert not {name.split("/")[0] for name in includes} & {"gl", "gpu", "epoxy"}, path


def test_constants_stand_once() -> None:
    """What the table has is defined by no other header or kernel, and by no shader that gets it."""
    table = CORE / "include/rosplat_core/slots/constants.hpp"
    shared = set(re.findall(r"^constexpr \w+(?:::\w+)? (k\w+) =", table.read_text(), re.MULTILINE))
    shared |= set(re.findall(r"\bk[A-Z]\w+", " ".join(ENUMERATORS.findall(table.read_text()))))
    handed = ROOT / "rviz_gaussian_plugin/src/splats/gl/constants.cpp"
    given = set(re.findall(r"(?:CONSTANT|MODE)\((k\w+)\);", handed.read_text()))
    assert given <= shared
    assert len(given) > 20
    defined = re.compile(r"\bconst (?:u?int|float) ([^;]*);")
    for shader in (ROOT / "rviz_gaussian_plugin/ogre_media").iterdir():
        for names in defined.findall(shader.read_text()):
            assert not given & set(re.findall(r"\b(k\w+)\s*=", names)), shader.name
    for source in sources(CORE):
        if source != table and source.suffix in (".cpp", ".hpp"):
            # At the margin: of a room, not of a function or class.
            found = re.findall(r"^constexpr [\w:]+ (k\w+) =", source.read_text(), re.MULTILINE)
            assert not shared & set(found), source


def test_a_class_of_the_engine_and_of_what_draws_has_a_name_of_its_own() -> None:
    declared = re.compile(r"^(?:struct|class) (\w+)(?: final)?(?: :[^;]*)? \{", re.MULTILINE)
    nested = re.compile(r"\b(?:struct|class) (?:View|Part|Room)\b")
    seen: dict[str, Path] = {}
    for folder in (CORE / "include", CORE / "src", ROOT / "rviz_gaussian_plugin/src"):
        for path in sources(folder):
            assert not nested.search(path.read_text()), path
            for name in set(declared.findall(path.read_text())):
                assert name not in seen, (name, path, seen[name])
                seen[name] = path
