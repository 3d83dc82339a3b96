"""A file that another program writes again and again."""

import os
from pathlib import Path

import pytest

from rosplat_tools.following.watched_file import WatchedFile


def test_a_version_is_told_once_it_rests(tmp_path: Path) -> None:
    path = tmp_path / "map.ply"
    watched = WatchedFile(str(path))
    assert watched.poll() is None
    path.write_bytes(b"begun")
    assert watched.poll() is None
    path.write_bytes(b"begun and ended")
    assert watched.poll() is None
    version = watched.poll()
    assert version
    assert watched.is_still(version)
    assert watched.poll() is None
    path.unlink()
    assert not watched.is_still(version)
    assert watched.poll() is None
    path.write_bytes(b"another")
    assert watched.poll() is None
    assert watched.poll()


def test_a_name_may_have_brackets(tmp_path: Path) -> None:
    path = tmp_path / "run[1].ply"
    path.write_bytes(b"ply")
    watched = WatchedFile(str(path))
    watched.poll()
    version = watched.poll()
    assert version and version.path == path


def test_of_a_pattern_the_newest_counts(tmp_path: Path) -> None:
    watched = WatchedFile(str(tmp_path / "iteration_*" / "point_cloud.ply"))
    for written, iteration in [(30, 7000), (40, 30000), (20, 100)]:
        path = tmp_path / f"iteration_{iteration}" / "point_cloud.ply"
        path.parent.mkdir()
        path.write_bytes(b"ply")
        os.utime(path, (written, written))
    watched.poll()
    version = watched.poll()
    assert version
    assert version.path.parent.name == "iteration_30000"


@pytest.mark.parametrize(
    ("path", "other"),
    [
        ("scene/meta.json", "scene/sh0.webp"),
        ("scene", "scene/sh0.webp"),
        ("scene/lod-meta.json", "scene/0_0/means_l.webp"),
        ("scene.gltf", "scene.bin"),
        ("scene.gltf", "buffers/scene.bin"),
    ],
)
def test_files_that_a_scene_s_file_names_count(tmp_path: Path, path: str, other: str) -> None:
    buffer = tmp_path / other
    buffer.parent.mkdir(parents=True, exist_ok=True)
    if "." in path:
        (tmp_path / path).write_bytes(b"{}")
    watched = WatchedFile(str(tmp_path / path))
    watched.poll()
    first = watched.poll()
    assert first
    for content in (b"begun", b"begun and ended", b"in the same place"):
        buffer.write_bytes(content)
        assert not watched.is_still(first)
        assert watched.poll() is None
        assert watched.poll()
        assert watched.poll() is None
