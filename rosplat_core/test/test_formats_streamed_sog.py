"""Streamed SOG: read whole, and refused with a word that names the file that is wrong."""

import json
import shutil
from concurrent.futures import CancelledError, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from streamed_scene import ABOVE, APART, ENVIRONMENT, LEVELS, edited, garden, write_scene

from rosplat_core import formats
from rosplat_core.formats import sog
from rosplat_core.formats.streamed_sog import FileRange, Pieces, open_streamed
from rosplat_core.splats import InputError


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_scene(tmp_path_factory.mktemp("made"))


@pytest.fixture
def scene(made: Path, tmp_path: Path) -> Path:
    """A lod-meta.json that may be damaged."""
    return Path(shutil.copytree(made.parent, tmp_path / "scene")) / made.name


def test_a_level_of_a_chunk_is_what_its_tree_says(made: Path) -> None:
    streamed = open_streamed(made)
    assert streamed.splats == 4 * LEVELS[0]
    pieces = Pieces(streamed, pytest.fail)
    for chunk in streamed.chunks:
        number = round(chunk.low[0] / APART)
        assert [part.count for part in chunk.levels] == sorted(LEVELS)
        for part in chunk.levels:
            splats = pieces.read(part)
            expected = garden(number, part.count)
            np.testing.assert_allclose(splats.positions, expected.positions, atol=0.01)


def test_the_finest_levels_are_read_whole(made: Path) -> None:
    told: list[float] = []
    for path in (made, made.parent):
        splats = formats.load(path, told.append)
        assert len(splats) == 4 * LEVELS[0]
    assert told[-1] == 1
    every = np.concatenate([garden(chunk, LEVELS[0]).positions for chunk in range(4)])
    np.testing.assert_allclose(splats.positions, every, atol=0.01)


def test_few_decoded_files_are_kept(made: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    decoded = []
    unpack = sog.unpack
    monkeypatch.setattr(sog, "unpack", lambda *given: decoded.append(given[0]) or unpack(*given))
    streamed = open_streamed(made)
    coarse, _, fine = (part.file for part in streamed.chunks[0].levels)
    for kept, reads in ((1 << 28, 2), (1, 4)):
        decoded.clear()
        monkeypatch.setattr(Pieces, "KEPT_BYTES", kept)
        pieces = Pieces(streamed, pytest.fail)
        for file in (coarse, coarse, fine, coarse, fine):
            pieces.read(FileRange(file, 0, 10))
        assert len(decoded) == reads


def test_threads_decode_a_file_once(made: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    decoded = []
    unpack = sog.unpack
    monkeypatch.setattr(sog, "unpack", lambda *given: decoded.append(given[0]) or unpack(*given))
    streamed = open_streamed(made)
    pieces = Pieces(streamed, pytest.fail)
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda chunk: pieces.read(chunk.levels[-1]), streamed.chunks))
    assert len(decoded) == 1
    for chunk, splats in zip(streamed.chunks, found, strict=True):
        expected = garden(round(chunk.low[0] / APART), len(splats))
        np.testing.assert_allclose(splats.positions, expected.positions, atol=0.01)
    pieces.close()
    with pytest.raises(CancelledError):
        pieces.read(streamed.chunks[0].levels[0])


def test_the_environment_is_a_chunk_as_large_as_the_scene(tmp_path: Path) -> None:
    streamed = open_streamed(write_scene(tmp_path, environment=True))
    *chunks, around = streamed.chunks
    np.testing.assert_array_equal(around.low, np.min([chunk.low for chunk in chunks], axis=0))
    np.testing.assert_array_equal(around.high, np.max([chunk.high for chunk in chunks], axis=0))
    splats = Pieces(streamed, pytest.fail).read(around.levels[0])
    assert len(splats) == ENVIRONMENT
    assert splats.positions[:, 2].min() > ABOVE / 2
    assert streamed.splats == 4 * LEVELS[0] + ENVIRONMENT
    shutil.rmtree(tmp_path / "env")
    with pytest.raises(InputError, match=r"env/meta\.json: can't read"):
        open_streamed(tmp_path)


def test_splats_that_cannot_be_drawn_are_left_out_alone(scene: Path) -> None:
    meta = scene.parent / "0_0" / "meta.json"
    fields = json.loads(meta.read_text())
    fields["scales"]["codebook"][120:140] = 20 * [1e9]  # e to that is no number
    meta.write_text(json.dumps(fields))
    told: list[str] = []
    streamed = open_streamed(scene)
    part = streamed.chunks[0].levels[-1]
    splats = Pieces(streamed, told.append).read(part)
    assert 0 < len(splats) < part.count
    assert np.isfinite(splats.scales).all()
    assert "0_0/meta.json: dropped" in told[0]


TREE: dict[str, Any] = {
    "bound": {"min": [0, 0, 0], "max": [1, 1, 1]},
    "lods": {"0": {"file": 0, "offset": 0, "count": 5}},
}


def changed(**changes: Any) -> dict[str, Any]:
    return {"tree": TREE | changes}


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"version": 2}, "version 2 can't be read"),
        ({"filenames": "0_0"}, "filenames: expected a list"),
        ({"filenames": ["/etc/passwd"]} | changed(), "'/etc/passwd' is not a file below"),
        ({"filenames": ["../x/meta.json"]} | changed(), "is not a file below"),
        ({"tree": None}, "broken lod-meta.json"),
        ({"tree": {}}, "holds no splats"),
        (changed(lods={"0": {"file": 3, "offset": 0, "count": 5}}), "file of level 0 is 3"),
        (changed(lods={"0": {"file": 0, "offset": -1, "count": 5}}), "offset of level 0 is -1"),
        (changed(lods={"0": {"file": 0, "offset": 0, "count": True}}), "count of level 0 is True"),
        (changed(lods={"fine": {}}), "broken lod-meta.json"),
        (changed(lods=[0]), "broken lod-meta.json"),
        (changed(bound={"min": [0, 0], "max": [1, 1]}), "bound: expected"),
        (changed(bound={"min": [2, 0, 0], "max": [1, 1, 1]}), "bound: expected"),
        (changed(bound={"min": [0, 0, 0], "max": [1, 1, 1e999]}), "bound: a number"),
        (changed(bound={"min": [-1e308, 0, 0], "max": [1, 1, 1]}), "bound: a number"),
        (changed(lods={"0": {"file": 0, "offset": 11_999, "count": 9}}), "0_0/meta.json: holds 12"),
        ({"environment": "../env/meta.json"}, "'../env/meta.json' is not a file below"),
        ({"environment": "a" * 300}, "'a{1,100}….? is not a file below"),
        ({"environment": "env/meta.json"}, "env/meta.json: can't read"),
        ({"environment": 5}, "broken lod-meta.json"),
    ],
)
def test_a_meta_that_lies(scene: Path, changes: dict[str, Any], reason: str) -> None:
    edited(scene, **changes)
    with pytest.raises(InputError, match=reason):
        open_streamed(scene)


WRONG = [
    None, True, -1, 0, 1, 2999, 3000, 2**63, 10**400, 1.5, float("nan"), float("inf"), -1e308, "",
    "x", "../x", "0_0/meta.json", [], {}, [0], [[]],
]  # fmt: skip


def places(values: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """The keys that lead to each value in another."""
    keys = values if isinstance(values, dict) else range(len(values))
    found = [(*path, key) for key in keys]
    for key in keys:
        if isinstance(values[key], (dict, list)):
            found += places(values[key], (*path, key))
    return found


@settings(deadline=None)
@given(data=st.data())
def test_any_field_may_be_anything(made: Path, data: st.DataObject) -> None:
    meta = json.loads(made.read_text())
    *way, last = data.draw(st.sampled_from(places(meta)))
    there = meta
    for key in way:
        there = there[key]
    there[last] = data.draw(st.sampled_from(WRONG))
    path = made.with_name("wrong.json")
    path.write_text(json.dumps(meta))
    try:
        scene = open_streamed(path)
    except InputError as error:
        assert made.parent.name in str(error)
    else:
        assert scene.splats > 0


def test_a_tree_without_end(scene: Path) -> None:
    tree: dict[str, Any] = TREE
    for _ in range(70):
        tree = {"children": [tree]}
    edited(scene, tree=tree)
    with pytest.raises(InputError, match="tree: deeper than 64"):
        open_streamed(scene)


def test_files_that_are_filtered_differently(scene: Path) -> None:
    meta = scene.parent / "0_0" / "meta.json"
    meta.write_text(json.dumps(json.loads(meta.read_text()) | {"antialias": True}))
    with pytest.raises(InputError, match="several models: ewa, ewa_antialiased"):
        open_streamed(scene)


def test_files_that_are_missing_cut_or_lie(scene: Path) -> None:
    streamed = open_streamed(scene)
    coarse, _, fine = streamed.chunks[0].levels
    picture = scene.parent / "0_0" / "means_l.webp"
    picture.write_bytes(picture.read_bytes()[:100])
    with pytest.raises(InputError, match=r"0_0/meta.json: means_l.webp is"):
        Pieces(streamed, pytest.fail).read(fine)
    assert len(Pieces(streamed, pytest.fail).read(coarse)) == coarse.count
    meta = scene.parent / "1_0" / "meta.json"
    meta.write_text(json.dumps(json.loads(meta.read_text()) | {"count": 5}))
    with pytest.raises(InputError, match=r"1_0/meta.json: holds 5 splats, lod-meta.json wants 2,8"):
        open_streamed(scene)
    meta.unlink()
    with pytest.raises(InputError, match=r"1_0/meta\.json: can't read"):
        open_streamed(scene)
    scene.write_bytes(scene.read_bytes()[:200])
    with pytest.raises(InputError, match=r"lod-meta\.json: broken"):
        open_streamed(scene)
    with pytest.raises(InputError, match=r"nowhere.*: No such file"):
        open_streamed(scene.parent / "nowhere")
