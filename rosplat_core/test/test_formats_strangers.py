"""Files that are taken for scenes are named as what they are."""

import gzip
import tarfile
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from rosplat_core.formats import InputError, load, save
from rosplat_core.splats import Splats

POINTER = "version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 123\n"


@pytest.mark.parametrize("ending", [".ply", ".splat", ".ksplat", ".spz", ".sog", ".npz", ""])
@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (POINTER, "a pointer of Git LFS"),
        ("\n<!DOCTYPE html><html>404</html>", "a web page"),
        ('<?xml version="1.0"?><Error>AccessDenied</Error>', "a web page"),
    ],
)
def test_what_a_download_got_instead(tmp_path: Path, ending: str, text: str, reason: str) -> None:
    (tmp_path / f"a{ending}").write_text(text)
    with pytest.raises(InputError, match=reason):
        load(tmp_path / f"a{ending}")


def test_archives_are_named(random_splats: Callable[..., Splats], tmp_path: Path) -> None:
    save(tmp_path / "a.ply", random_splats(4))
    with zipfile.ZipFile(tmp_path / "scenes.zip", "w") as archive:
        for name in "abcd":
            archive.write(tmp_path / "a.ply", f"{name}/point_cloud.ply")
    with zipfile.ZipFile(tmp_path / "model.pth", "w") as archive:
        archive.writestr("model/data.pkl", "")
    with tarfile.open(tmp_path / "a.tar", "w") as tar:
        tar.add(tmp_path / "a.ply")
    (tmp_path / "a.ply.gz").write_bytes(gzip.compress((tmp_path / "a.ply").read_bytes()))
    (tmp_path / "b.gz").write_bytes(gzip.compress(b"whatever"))
    (tmp_path / "cut.zip").write_bytes((tmp_path / "scenes.zip").read_bytes()[:100])
    for ending in (".splat", ".ksplat", ".ply"):
        (tmp_path / f"renamed{ending}").write_bytes((tmp_path / "scenes.zip").read_bytes())
    (tmp_path / "a.json").write_text("[1]")
    for name, reason in (
        ("scenes.zip", r"a zip with a/point_cloud\.ply, .*, …: unpack it first"),
        ("renamed.splat", "a zip with"),
        ("renamed.ksplat", "a zip with"),
        ("renamed.ply", "a zip with"),
        ("model.pth", "a checkpoint of PyTorch"),
        ("a.tar", "a tar archive"),
        ("a.ply.gz", "a PLY packed by gzip"),
        ("b.gz", "packed by gzip"),
        ("cut.zip", "a zip that is cut short"),
        ("a.json", "JSON"),
    ):
        with pytest.raises(InputError, match=rf"{name}: {reason}"):
            load(tmp_path / name)


@pytest.mark.parametrize(
    ("name", "data", "reason"),
    [
        ("a.las", b"LASF" + bytes(300), r"a point cloud \(LAS\)"),
        ("a.pcd", b"# .PCD v0.7 - Point Cloud Data file format\n", r"a point cloud \(PCD\)"),
        ("a.e57", b"ASTM-E57" + bytes(40), r"a point cloud \(E57\)"),
        ("a.h5", b"\x89HDF\r\n\x1a\n", "HDF5"),
        ("a.pth", b"\x80\x02}q\x00.", "a pickle of Python"),
        ("b.pth", b"\x80\x05\x95" + bytes(40), "a pickle of Python"),
        ("a.npy", b"\x93NUMPY" + bytes(40), "an array of NumPy"),
        ("a.mcap", b"\x89MCAP0\r\n" + bytes(40), "a bag of ROS"),
        ("a.splat", b'{"error": "not found"}', "JSON"),
        ("a.ksplat", b"404: Not Found", "not a scene, but text that begins '404: Not Found'"),
        ("a.spz", b"Entry not found\n", "not a scene, but text that begins 'Entry not found'"),
        ("a.obj", b"# mesh\nv 0 0 0\n", "not a scene, but text that begins '# mesh v 0 0 0'"),
        ("a.ply", "ply\nformat ascii 1.0\n".encode("utf-16"), "a PLY in another text than ASCII"),
        ("b.ply", b"\xef\xbb\xbfply\nformat ascii 1.0\n", "a PLY in another text than ASCII"),
        ("a.lcc", b'{"version": "5.0"}', "LCC of XGRIDS"),
    ],
)
def test_what_others_keep_is_named(tmp_path: Path, name: str, data: bytes, reason: str) -> None:
    (tmp_path / name).write_bytes(data)
    with pytest.raises(InputError, match=f"{name}: {reason}"):
        load(tmp_path / name)
