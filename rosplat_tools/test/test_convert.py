"""Convert writes what it read, or says why it didn't."""

import importlib.util
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rosplat_core.formats import load, save
from rosplat_core.generated import generate
from rosplat_core.models import Model
from rosplat_core.splats import Splats
from rosplat_tools.convert import main

lacking = importlib.util.find_spec("pxr") is None
usdc = pytest.param(".usdc", marks=pytest.mark.skipif(lacking, reason="no usd-core (PyPI)"))
ENDINGS = [".ply", ".compressed.ply", ".spz", ".sog", ".splat", ".glb", usdc]


def test_a_scene_is_converted(scene: Callable[[str], Path], tmp_path: Path) -> None:
    source, target = scene("wolf.spz"), tmp_path / "wolf.ply"
    assert main([str(source), str(target)]) == 0
    before, after = load(source), load(target)
    np.testing.assert_array_equal(before.positions, after.positions)
    np.testing.assert_array_equal(before.sh, after.sh)


def test_a_scene_may_be_generated(tmp_path: Path) -> None:
    assert main(["procedural:40:7", str(tmp_path / "a.ply")]) == 0
    np.testing.assert_array_equal(load(tmp_path / "a.ply").positions, generate(40, 7).positions)


@pytest.mark.skipif(lacking, reason="no usd-core (PyPI)")
def test_the_vertical_of_the_input_is_told(
    random_splats: Callable[..., Splats], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    save(tmp_path / "y.spz", random_splats(4))
    for source, up in ((str(tmp_path / "y.spz"), (0, 1, 0)), ("procedural:4", (0, 0, 1))):
        assert main([source, str(tmp_path / "a.usda"), "--overwrite"]) == 0
        assert load(tmp_path / "a.usda").up == up
    assert "take its axes" not in capsys.readouterr().err


def test_bands_can_be_cut_off_but_not_made(
    random_splats: Callable[..., Splats], tmp_path: Path
) -> None:
    save(tmp_path / "a.ply", random_splats(4, 2))
    for wanted, written in ((1, 1), (3, 2)):
        target = tmp_path / f"{wanted}.ply"
        assert main([str(tmp_path / "a.ply"), str(target), "--sh-degree", str(wanted)]) == 0
        assert load(target).sh_degree == written


def test_a_part_is_cut_out_and_the_rest_is_kept(
    random_splats: Callable[..., Splats], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = replace(random_splats(200), channels={"label": np.arange(200, dtype=np.float32) % 4})
    source, part, rest = (str(tmp_path / f"{name}.ply") for name in ("whole", "part", "rest"))
    save(source, whole)
    low, high = np.quantile(whole.positions, [0.2, 0.7], axis=0)
    inside = ((whole.positions >= low) & (whole.positions <= high)).all(axis=1)
    for options, kept in (
        (["--box", *map(str, [*high, *low])], inside),  # corners in any order
        (["--where", "label=3"], whole.channels["label"] == 3),
        (["--where", "label=3", "--box", *map(str, [*low, *high])],
         inside & (whole.channels["label"] == 3)),
    ):  # fmt: skip
        assert main([source, part, *options, "--overwrite"]) == 0
        assert main([source, rest, *options, "--rest", "--overwrite"]) == 0
        np.testing.assert_array_equal(load(part).positions, whole.positions[kept])
        np.testing.assert_array_equal(load(rest).positions, whole.positions[~kept])
    capsys.readouterr()
    for options, why in (
        (["--rest"], "of what"),
        (["--where", "colour=3"], "has no channel colour: label"),
        (["--where", "label"], "expected label=NUMBER"),
        (["--where", "label=9"], "no splat is left"),
        (["--box", *["nan"] * 6], "finite"),
    ):
        assert main([source, part, *options, "--overwrite"]) == 1
        assert why in capsys.readouterr().err
    assert len(load(part)) < 200  # what was there stays


def test_distances_are_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    target = tmp_path / "field.npz"
    assert main(["rooms:20000", str(target), "--resolution", "0.2"]) == 0
    assert "voxels of 0.2 m, up is 0.00 0.00 1.00" in capsys.readouterr().out
    with np.load(target) as field:
        assert field["distances"].dtype == np.float32
        assert field["resolution"] == 0.2
        assert field["map_pose"].shape == (4, 4)
    assert main(["rooms:20000", str(target)]) == 1
    assert "exists" in capsys.readouterr().err


@pytest.mark.parametrize("ending", ENDINGS)
def test_the_round_trips_error_is_told(
    random_splats: Callable[..., Splats],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    ending: str,
) -> None:
    splats = random_splats(300, 1)
    splats.positions[:, 0] = np.linspace(-3, 3, 300)  # tells them apart, whatever their order
    save(tmp_path / "a.ply", splats)
    target = tmp_path / f"b{ending}"
    assert main([str(tmp_path / "a.ply"), str(target)]) == 0
    out, err = capsys.readouterr()
    lines = out.splitlines()
    assert lines[0].startswith(f"{target}: 300 splats, SH degree {0 if ending == '.splat' else 1}")
    table = {line[:18].strip(): line[18:].split() for line in lines[1:]}
    assert table.pop("read back, error") == ["median", "99", "%", "most"]
    assert list(table) == [
        "position [m]", "scale [%]", "rotation [deg]", "opacity", "color", "harmonics",
    ]  # fmt: skip
    back = load(target)
    moved = back.positions[np.argsort(back.positions[:, 0])] - splats.positions
    assert float(table["position [m]"][2]) == pytest.approx(
        np.linalg.norm(moved, axis=1).max(), rel=0.01, abs=1e-9
    )
    lossless = ending in (".ply", ".glb", ".usdc")
    assert (float(table["harmonics"][2]) == 0) == lossless
    axes = {".spz": "x right, y up", ".glb": "x left, y up", ".usdc": "z up"}.get(ending)
    assert ("take its axes for" in err) == (axes is not None)
    assert axes is None or f"take its axes for {axes}" in err


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("largest", [1e20, 3.4e38])
@pytest.mark.parametrize("field", ["positions", "scales", "sh"])
@pytest.mark.parametrize("ending", ENDINGS)
def test_numbers_at_the_end_of_float32_end_nothing(
    random_splats: Callable[..., Splats],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    ending: str,
    field: str,
    largest: float,
) -> None:
    splats = random_splats(300, 1)
    values = getattr(splats, field)
    values *= 1 / np.abs(values).max()
    values *= np.float32(largest)
    save(tmp_path / "a.ply", splats)
    if main([str(tmp_path / "a.ply"), str(tmp_path / f"b{ending}")]) == 0:
        assert "nan" not in capsys.readouterr().out
    else:
        assert "too far" in capsys.readouterr().err.splitlines()[-1]


def test_an_output_that_exists_is_kept(
    random_splats: Callable[..., Splats], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    save(tmp_path / "a.ply", random_splats(4))
    save(tmp_path / "b.ply", random_splats(5))
    arguments = [str(tmp_path / "a.ply"), str(tmp_path / "b.ply")]
    assert main(arguments) == 1
    assert "b.ply: exists already" in capsys.readouterr().err
    assert len(load(tmp_path / "b.ply")) == 5
    assert main([*arguments, "--overwrite"]) == 0
    assert len(load(tmp_path / "b.ply")) == 4


@pytest.mark.parametrize(
    ("source", "target", "reason"),
    [
        ("none.ply", "b.ply", "none.ply: No such file"),
        ("empty.ply", "b.ply", "empty.ply: holds no splats"),
        ("a.ply", "b.obj", "b.obj: can't write"),
        ("none.ply", "a.ply/b.ply", "a.ply is no folder"),
        ("none.ply", "none/b.ply", "none is no folder"),
        ("a.ply", "b" * 300 + ".ply", "b.ply: File name too long"),
    ],
)
def test_failures_are_told(
    random_splats: Callable[..., Splats],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    source: str,
    target: str,
    reason: str,
) -> None:
    save(tmp_path / "a.ply", random_splats(4))
    save(tmp_path / "empty.ply", random_splats(0))
    assert main([str(tmp_path / source), str(tmp_path / target)]) == 1
    assert reason in capsys.readouterr().err
    assert {path.name for path in tmp_path.iterdir()} == {"a.ply", "empty.ply"}


@pytest.mark.parametrize("terminal", [True, False])
def test_a_bar_is_for_a_terminal(
    terminal: bool,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: terminal)
    assert main(["procedural:40", str(tmp_path / "a.ply")]) == 0
    assert ("reading:" in capsys.readouterr().err) == terminal


def test_a_disc_s_third_scale_is_no_error(
    random_splats: Callable[..., Splats], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A compressed PLY has one, which means nothing, a PLY of discs has none."""
    source = tmp_path / "a.compressed.ply"
    save(source, replace(random_splats(20), model=Model.DISC))
    assert main([str(source), str(tmp_path / "b.ply")]) == 0
    scale = next(line for line in capsys.readouterr().out.splitlines() if "scale [%]" in line)
    assert float(scale.split()[-1]) < 0.01
