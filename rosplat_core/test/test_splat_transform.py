"""Our readers and writers against PlayCanvas's splat-transform, both ways, where it is installed.

npm install -g @playcanvas/splat-transform
"""

import json
import shutil
import subprocess
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ksplat_file import ksplat

from rosplat_core.formats import load, save
from rosplat_core.splats import Splats

PROGRAM = shutil.which("splat-transform")
pytestmark = pytest.mark.skipif(PROGRAM is None, reason="no splat-transform (npm) in PATH")

Make = Callable[..., Splats]


def transform(*arguments: str | Path) -> None:
    """Runs splat-transform; its error, if any, is the test's."""
    run = subprocess.run(
        [str(PROGRAM), "-w", *map(str, arguments)], capture_output=True, text=True, timeout=300
    )
    assert run.returncode == 0, run.stdout + run.stderr


def made(make: Make, degree: int = 3) -> Splats:
    """Splats that every format can hold."""
    splats = make(1500, degree)
    splats.sh[:, 0] = np.clip(splats.sh[:, 0], -1.7, 1.7)
    splats.sh[:, 1:] = np.clip(0.3 * splats.sh[:, 1:], -0.9, 0.9)
    splats.opacities[:] = np.clip(splats.opacities, 0.01, 0.99)
    return splats


def turned(splats: Splats) -> Splats:
    """Half a turn about x: from SPZ's axes (y up, z back) to most PLYs' (y down, z ahead)."""
    signs = [1, -1, -1, 1, -1, 1, 1, -1, 1, -1, 1, -1, -1, 1, -1, 1]
    k = splats.sh.shape[1]
    return replace(
        splats,
        positions=splats.positions * np.float32([1, -1, -1]),
        orientations=splats.orientations * np.float32([1, -1, -1, 1]),
        sh=splats.sh * np.float32(signs[:k])[:, None],
    )


def turned_about_z(splats: Splats) -> Splats:
    """Half a turn about z: from most PLYs' axes to glTF's (y up, z to the front)."""
    signs = [1, -1, 1, -1, 1, -1, 1, -1, 1, -1, 1, -1, 1, -1, 1, -1]
    x, y, z, w = splats.orientations.T
    return replace(
        splats,
        positions=splats.positions * np.float32([-1, -1, 1]),
        orientations=np.column_stack([-y, x, w, -z]),
        sh=splats.sh * np.float32(signs[: splats.sh.shape[1]])[:, None],
    )


def read_by_both(path: Path, scratch: Path) -> tuple[Splats, Splats]:
    """What we read of a file, and what splat-transform does."""
    transform(path, scratch)
    ours, theirs = load(path), load(scratch)
    if np.allclose(ours.positions[:, 1], -theirs.positions[:, 1]):
        return turned(ours), theirs  # its versions before 3 do so to SPZ
    return ours, theirs


def assert_same(ours: Splats, theirs: Splats, degrees: float = 0.2) -> None:
    """Both have decoded the same bytes; what is left is rounding, and theirs of tiny opacities."""
    assert len(ours) == len(theirs)
    np.testing.assert_allclose(ours.positions, theirs.positions, atol=1e-5)
    np.testing.assert_allclose(ours.scales, theirs.scales, rtol=1e-4)
    np.testing.assert_allclose(ours.opacities, theirs.opacities, atol=1e-5)
    np.testing.assert_allclose(ours.sh, theirs.sh, atol=2e-5)
    cosine = np.abs((ours.orientations.astype(float) * theirs.orientations).sum(axis=1))
    assert np.degrees(2 * np.arccos(np.minimum(cosine, 1))).max() < degrees


@pytest.mark.parametrize("ending", [".ply", ".compressed.ply", ".spz", ".sog", ".splat"])
def test_it_reads_what_we_write(random_splats: Make, tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"a{ending}"
    save(path, made(random_splats))
    # Of .splat, it takes 127.5, not 128, for the middle of a quaternion's bytes.
    assert_same(*read_by_both(path, tmp_path / "b.ply"), 1.0 if ending == ".splat" else 0.2)


@pytest.mark.parametrize("ending", [".ply", ".compressed.ply", ".sog", ".spz", ".3.spz"])
def test_we_read_what_it_writes(random_splats: Make, tmp_path: Path, ending: str) -> None:
    splats = made(random_splats)
    save(tmp_path / "a.ply", splats)
    path = tmp_path / f"b{ending}"
    version = ["--spz-version", "3"] if ending == ".3.spz" else []
    transform("-g", "cpu", *version, tmp_path / "a.ply", path)
    back, theirs = read_by_both(path, tmp_path / "c.ply")
    assert_same(back, theirs)
    # And it is the scene that it was given, in some order.
    np.testing.assert_allclose(
        back.positions.mean(axis=0), splats.positions.mean(axis=0), atol=1e-3
    )
    np.testing.assert_allclose(back.sh.mean(axis=0), splats.sh.mean(axis=0), atol=0.03)


@pytest.mark.parametrize("degree", range(4))
def test_its_glb_is_ours(random_splats: Make, tmp_path: Path, degree: int) -> None:
    """It writes glTF, and turns a PLY to glTF's axes; none of its versions to 3.7 reads any."""
    splats = made(random_splats, degree)
    save(tmp_path / "a.ply", splats)
    transform(tmp_path / "a.ply", tmp_path / "theirs.glb")
    save(tmp_path / "ours.glb", turned_about_z(splats))
    ours, theirs = (load(tmp_path / f"{who}.glb") for who in ("ours", "theirs"))
    assert_same(ours, theirs)
    told = [described(tmp_path / f"{who}.glb") for who in ("ours", "theirs")]
    for asset in told:
        del asset["asset"]["generator"]
        told_of = asset["meshes"][0]["primitives"][0]["extensions"]["KHR_gaussian_splatting"]
        assert told_of.pop("sortingMethod", "cameraDistance") == "cameraDistance"
        assert told_of.pop("projection", "perspective") == "perspective"
        for accessor in asset["accessors"]:
            accessor.pop("byteOffset", None)  # 0, where they tell it
    assert told[0] == told[1]


def described(path: Path) -> Any:
    """The JSON of a .glb."""
    data = path.read_bytes()
    return json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")])


@pytest.mark.parametrize("level", [0, 1, 2])
def test_it_reads_ksplat_as_we_do(random_splats: Make, tmp_path: Path, level: int) -> None:
    splats = made(random_splats, 2)
    splats.positions[:] = np.clip(splats.positions, -2.4, 2.4)
    parts = [splats[:700], splats[700:]]
    (tmp_path / "a.ksplat").write_bytes(ksplat(parts, level))
    assert_same(*read_by_both(tmp_path / "a.ksplat", tmp_path / "b.ply"))


def test_it_reads_version_1_of_sog_as_we_do(random_splats: Make, tmp_path: Path) -> None:
    save(tmp_path / "a.sog", made(random_splats))
    folder = tmp_path / "a"
    with zipfile.ZipFile(tmp_path / "a.sog") as bundle:
        bundle.extractall(folder)
    meta = json.loads((folder / "meta.json").read_text())
    meta["means"]["shape"] = [meta.pop("count"), 3]
    del meta["version"]
    for field, mins, maxs in (
        ("scales", [-7, -6, -5], [-1, -2, -3]),
        ("sh0", [-2, -1.5, -1, -4], [2, 1.5, 1, 4]),
        ("shN", -0.8, 0.7),
    ):
        meta[field] = {"mins": mins, "maxs": maxs, "files": meta[field]["files"]}
    (folder / "meta.json").write_text(json.dumps(meta))
    assert_same(*read_by_both(folder / "meta.json", tmp_path / "b.ply"))


def test_a_trained_scene(scene: Callable[[str], Path], tmp_path: Path) -> None:
    for name in ("wolf.spz", "playbot"):
        source = scene(name) / "meta.json" if scene(name).is_dir() else scene(name)
        assert_same(*read_by_both(source, tmp_path / "a.ply"))
