"""Scenes by name: what a user may ask for, and what a machine can't hold."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rosplat_core import formats, scenes
from rosplat_core.generated import generate
from rosplat_core.splats import InputError, Splats


def load(name: str) -> Splats:
    return scenes.load_scene(name, lambda _: None, lambda _: None)


def test_count_and_seed_are_in_the_name() -> None:
    for name, made in (
        ("procedural:40", generate(40)),
        ("procedural:40:7", generate(40, 7)),
        ("rooms:40:7", generate(40, 7, scene="rooms")),
    ):
        np.testing.assert_array_equal(load(name).positions, made.positions)


@pytest.mark.parametrize("count", ["", "many", "-3", "0", "3:", "3:4:5", "33554433", "9" * 5000])
def test_a_count_that_makes_no_sense(count: str) -> None:
    with pytest.raises(InputError, match=f"^procedural:{count}: "):
        load(f"procedural:{count}")


def test_a_file_of_more_splats_than_a_map_holds(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "scene.ply"
    formats.save(path, generate(11))
    monkeypatch.setattr(scenes, "MAX_SLOTS", 10)
    with pytest.raises(InputError, match="11 splats; a map has at most 10"):
        load(str(path))


def test_what_is_no_scene_is_told_before_other_work(tmp_path: Path) -> None:
    (tmp_path / "text.ply").write_text("hello\n")
    for name, why in (("none.ply", "No such file"), ("text.ply", "not a scene"), ("\0", "no name")):
        with pytest.raises(InputError, match=why):
            scenes.check_scene(str(tmp_path / name))
    with pytest.raises(InputError, match="no scene is named"):  # else the folder one is in
        scenes.check_scene("")
    scenes.check_scene("procedural:7")


def test_a_scene_without_a_usable_splat(tmp_path: Path) -> None:
    splats = generate(3)
    splats.opacities[:] = np.nan
    for name, empty in (("no.ply", splats[:0]), ("nan.ply", splats)):
        formats.save(tmp_path / name, empty)
        with pytest.raises(InputError, match=f"{name}: holds no splats"):
            load(str(tmp_path / name))
        assert len(scenes.read_scene(str(tmp_path / name), lambda _: None, lambda _: None)) == 0


def test_counts_may_have_units() -> None:
    assert len(load("procedural:2k")) == 2000
    assert len(load("rooms:1.5k:7")) == 1500


def test_up_follows_the_format_where_it_has_one(tmp_path: Path) -> None:
    for ending, up in (
        (".spz", (0, 1, 0)),
        (".glb", (0, 1, 0)),
        (".ply", None),
        (".sog", None),
        (".splat", None),
    ):
        formats.save(tmp_path / f"a{ending}", replace(generate(3), up=None))
        assert load(str(tmp_path / f"a{ending}")).up == up
    assert load("procedural:3").up == load("rooms:3").up == (0, 0, 1)
    with pytest.raises(InputError, match="No such file"):
        formats.axes(str(tmp_path / "none.spz"))


def test_too_little_memory_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object, **__: object) -> None:
        raise MemoryError

    monkeypatch.setattr(scenes, "generate_into", full)
    with pytest.raises(InputError, match="procedural:7: too large for this machine's memory"):
        load("procedural:7")
    monkeypatch.setattr(formats.ply, "write", full)
    with pytest.raises(InputError, match="too large for this machine's memory"):
        formats.save(tmp_path / "scene.ply", generate(3))
