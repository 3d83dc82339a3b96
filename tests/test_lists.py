"""What has to stand in several places stands in all; which lacks what is the failure's text."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

import pytest

from rosplat_core.scenes import NAMES

ROOT = Path(__file__).resolve().parents[1]
CORE, PLUGIN, TOOLS = ROOT / "rosplat_core", ROOT / "rviz_gaussian_plugin", ROOT / "rosplat_tools"
VIEWS = CORE / "include/rosplat_core/views"
BINDING = CORE / "src/python/rendering.cpp"
DISPLAY = PLUGIN / "src/display/display_settings.cpp"
REFERENCE = ROOT / "docs/reference.md"


def read(path: Path) -> str:
    """A source's text, without comments."""
    return re.sub(r"//.*", "", path.read_text())


def section(title: str) -> str:
    """A section of the reference."""
    return REFERENCE.read_text().split(f"\n## {title}\n")[1].split("\n## ")[0]


def fields(path: Path, block: str) -> list[str]:
    """Names of the fields of a struct or a uniform block, in order."""
    begin = rf"\b(?:struct|uniform)\b[^;{{]*\b{block}\b[^;{{]*{{"
    (body,) = re.findall(begin + r"(.*?)\n}", read(path), re.DOTALL)
    body = re.sub(r"<[^<>]*>|alignas\(\d+\)|{}| = [^,;]*", "", body)
    declared = [statement for statement in body.split(";") if not re.search(r"\(|using", statement)]
    names = [re.sub(r"^\s*[\w:]+\s", "", statement) for statement in declared]
    return [name.strip() for each in names if each.strip() for name in each.split(",")]


def draw_modes() -> list[str]:
    (body,) = re.findall(
        r"enum class DrawMode {(.*?)}",
        read(CORE / "include/rosplat_core/slots/constants.hpp"),
        re.DOTALL,
    )
    return re.findall(r"\bk\w+", body)


def has_all(path: Path, names: Iterable[str], found: Iterable[str]) -> None:
    """Asserts that a file's names, as they were found, have all of others."""
    if lacking := sorted(set(names) - set(found)):
        pytest.fail(f"{path.relative_to(ROOT)} lacks {', '.join(lacking)}", pytrace=False)


@pytest.mark.parametrize("block", ["Map", "View"])
def test_shaders_get_the_fields_that_are_written(block: str) -> None:
    """By place: std140 knows no names."""
    shader = PLUGIN / f"ogre_media/splat_{block.lower()}.glsl"
    settings = fields(VIEWS / "splat_settings.hpp", "SplatSettings") if block == "Map" else []
    written = settings + fields(PLUGIN / "src/splats/gpu/view_block.hpp", f"{block}Block")
    assert fields(shader, block) == written, f"{shader.name} has other fields"


@pytest.mark.parametrize("struct", ["SplatSettings", "RenderSettings"])
def test_python_has_all_settings(struct: str) -> None:
    header = re.sub(r"([a-z])([A-Z])", r"\1_\2", struct).lower()
    settings = [name for name in fields(VIEWS / f"{header}.hpp", struct) if name.isidentifier()]
    assert len(settings) > 5
    has_all(BINDING, settings, re.findall(r"(?:RenderSettings::|\bs\.)(\w+)", read(BINDING)))


def test_python_and_the_display_have_all_draw_modes() -> None:
    has_all(BINDING, draw_modes(), re.findall(r'", DrawMode::(k\w+)', read(BINDING)))
    options = dict(re.findall(r'{"([\w ]+)", DrawMode::(k\w+)}', read(DISPLAY)))
    has_all(DISPLAY, draw_modes(), options.values())
    (row,) = re.findall(r"^\| Draw Mode \|[^\n]*", section("The display"), re.MULTILINE)
    has_all(REFERENCE, options, [option for option in options if option in row])


def test_the_display_s_properties_are_documented_and_saved() -> None:
    source = read(DISPLAY) + read(PLUGIN / "src/display/gaussian_display.cpp")
    names = re.findall(r'\b(?:choice(?:<\w+>)?|number|flag|\w+Property)\(\s*"([^"]+)"', source)
    assert len(names) > 25
    rows = re.findall(r"^\| (?:⤷ )?([^|]+) \|", section("The display"), re.MULTILINE)
    has_all(REFERENCE, names, ", ".join(rows).split(", "))
    saved = ROOT / "tests/test_rviz_config.py"
    has_all(saved, names, re.findall(r'[/"]([A-Z][\w ]*)(?=[/"])', saved.read_text()))


def test_files_that_are_read_are_documented_and_can_be_dropped() -> None:
    endings = re.findall(r"(?<![\w-])\.[\w.]+\w", NAMES)
    assert len(endings) > 10
    has_all(REFERENCE, endings, re.findall(r"`(\.[\w.]+)`", section("Scene files")))
    drop = PLUGIN / "src/display/scene_drop.cpp"
    last = [ending.rpartition(".")[2] for ending in endings]
    has_all(drop, last, re.findall(r'"(\w+)"', read(drop)))


def test_programs_are_installed_and_documented() -> None:
    path, cmake = TOOLS / "rosplat_tools/commands.py", TOOLS / "CMakeLists.txt"
    commands = re.findall(r"^(\w+) = partial\(", path.read_text(), re.MULTILINE)
    installed = cmake.read_text().split("foreach(program IN ITEMS")[1].split(")")[0].split()
    has_all(cmake, commands, installed)
    has_all(path, installed, commands)
    tables = section("Nodes and parameters") + section("Other programs")
    documented = re.findall(r"^\| `rosplat_tools (\w+)`", tables, re.MULTILINE)
    has_all(REFERENCE, commands, documented)
    has_all(path, documented, commands)
