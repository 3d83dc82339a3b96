"""What inspect says about a scene is what is in it."""

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from streamed_scene import write_scene

from rosplat_core.formats import save
from rosplat_core.models import Model
from rosplat_core.splats import Splats
from rosplat_tools.inspect_scene import describe, main

Make = Callable[..., Splats]


def rows(report: str) -> dict[str, str]:
    return {line[:12].strip(): line[13:] for line in report.splitlines()}


def test_a_report(random_splats: Make, tmp_path: Path) -> None:
    splats = random_splats(1234, 1, model=Model.RAY).with_sh_degree(3)
    splats.positions[:, 0] = np.linspace(-2, 5, 1234)
    splats.scales[7] = 0.5
    save(tmp_path / "a.ply", splats)
    report = rows(describe(tmp_path / "a.ply"))
    assert report["splats"] == "1,234"
    assert report["format"] == f"PLY, {(tmp_path / 'a.ply').stat().st_size / 1000:.3g} kB"
    assert report["SH degree"] == "3, but the bands above 1 are all zero"
    assert report["model"] == "ray"
    assert report["axes"].startswith("the trainer's")
    assert report["in memory"] == f"{1.234 * 4 * (11 + 12):.3g} kB, 92 bytes per splat"
    assert report["from"].startswith("-2 ")
    assert report["to"].startswith("5 ")
    assert report["scale [m]"].split()[-1] == "0.5"
    assert "note" not in report


def test_what_is_left_out_is_told(random_splats: Make, tmp_path: Path) -> None:
    splats = random_splats(10)
    splats.sh[4, 2, 1] = np.nan
    save(tmp_path / "a.ply", splats)
    report = rows(describe(tmp_path / "a.ply"))
    assert "dropped 1 of 10" in report["note"]
    assert report["model"] == "ewa, as the file tells of no other"


def test_channels_are_named(random_splats: Make, tmp_path: Path) -> None:
    channels = {"label": np.arange(10), "seen": np.where(np.arange(10) < 3, np.nan, 0.5)}
    save(tmp_path / "a.ply", replace(random_splats(10), channels=channels))
    assert rows(describe(tmp_path / "a.ply"))["channels"] == "label (10 values), seen (7 values)"


def test_a_far_map_tells_its_origin(random_splats: Make, tmp_path: Path) -> None:
    save(tmp_path / "a.ply", replace(random_splats(10), origin=np.array([3e5, 0, 0])))
    assert rows(describe(tmp_path / "a.ply"))["origin"].startswith("300")


@pytest.mark.parametrize("name", ["procedural:40", "rooms:40"])
def test_a_generated_scene(name: str) -> None:
    report = rows(describe(name))
    assert (report["format"], report["splats"]) == ("made by generate", "40")
    assert report["axes"] == "z up"


def test_axes_that_a_format_fixes(random_splats: Make, tmp_path: Path) -> None:
    save(tmp_path / "a.spz", random_splats(3))
    assert rows(describe(tmp_path / "a.spz"))["axes"] == "x right, y up, z back (by SPZ's rule)"


def test_buffers_beside_a_scene_count(random_splats: Make, tmp_path: Path) -> None:
    save(tmp_path / "a.glb", random_splats(20))
    binary = (tmp_path / "a.glb").read_bytes()
    begin = 20 + int.from_bytes(binary[12:16], "little")
    asset = json.loads(binary[20:begin])
    asset["buffers"][0]["uri"] = "a.bin"
    (tmp_path / "a.bin").write_bytes(binary[begin + 8 :])
    (tmp_path / "a.gltf").write_text(json.dumps(asset))
    size = sum((tmp_path / name).stat().st_size for name in ("a.bin", "a.gltf"))
    assert rows(describe(tmp_path / "a.gltf"))["format"] == f"glTF, {size / 1000:.3g} kB"


def test_what_a_format_s_rule_of_drawing_changes(random_splats: Make, tmp_path: Path) -> None:
    splats = random_splats(10)
    splats.opacities[:] = [0.35, *[0.36] * 9]  # 3 sigma is where alpha is 1/255: at exp(4.5) / 255
    save(tmp_path / "a.glb", splats)
    report = rows(describe(tmp_path / "a.glb"))
    assert "by distance from the camera, cut at 3 sigma" in report["drawn"]
    assert report["cut"] == "90 % of the splats reach beyond 3 sigma"
    assert re.fullmatch(
        r"pictures in either order agree to \S+ dB, \S+ dB at worst of 8 views from around",
        report["order"],
    )
    save(tmp_path / "a.ply", splats)
    assert "drawn" not in rows(describe(tmp_path / "a.ply"))


@pytest.mark.parametrize("width", [1e12, 1e18, 3e38])
def test_no_scene_is_too_wide(random_splats: Make, tmp_path: Path, width: float) -> None:
    splats = random_splats(50, 0)
    splats.positions[:] *= np.float32(width) / np.abs(splats.positions).max()
    save(tmp_path / "a.glb", splats)
    assert rows(describe(tmp_path / "a.glb"))["order"]


def test_control_codes_of_a_name_are_shown(random_splats: Make, tmp_path: Path) -> None:
    save(tmp_path / "a\x1b[31m.ply", random_splats(3))
    assert "\x1b" not in describe(tmp_path / "a\x1b[31m.ply")


def test_a_streamed_scene_is_as_large_as_its_parts(tmp_path: Path) -> None:
    path = write_scene(tmp_path / "scene")
    size = sum(part.stat().st_size for part in path.parent.rglob("*") if part.is_file())
    assert rows(describe(path))["format"] == f"streamed SOG, {size / 1000:.3g} kB"
    assert rows(describe(path.parent))["format"] == f"streamed SOG, {size / 1000:.3g} kB"


def test_an_empty_map(random_splats: Make, tmp_path: Path) -> None:
    save(tmp_path / "a.ply", random_splats(0))
    assert rows(describe(tmp_path / "a.ply"))["splats"] == "0"


def test_the_command_goes_on_after_a_bad_file(
    random_splats: Make, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    save(tmp_path / "a.ply", random_splats(3))
    assert main([str(tmp_path / "none.ply"), str(tmp_path / "a.ply")]) == 1
    out, err = capsys.readouterr()
    assert rows(out)["splats"] == "3"
    assert "none.ply" in err
    assert main([str(tmp_path / "a.ply")]) == 0
