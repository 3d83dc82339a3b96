"""A scene that another program writes again and again."""

from __future__ import annotations

import glob
import os
from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

FOLDERS = ("meta.json", "lod-meta.json")  # files that name others in their folder


class Version(NamedTuple):
    """A scene as it was at one time."""

    path: Path
    written: int
    """Time of the last change. [ns]"""
    files: tuple[tuple[int, int, int], ...]
    """Inode, size [bytes] and time of the last change [ns] of each of its files."""


class WatchedFile:
    """The newest scene of a path or glob pattern, each time that one of its files was written."""

    def __init__(self, pattern: str) -> None:
        """Nothing is looked at yet."""
        self._pattern = pattern
        self._seen: Version | None = None
        self._told: Version | None = None

    def poll(self) -> Version | None:
        """The newest version, once, if it is the same as at the poll before; else None."""
        newest = self._newest()
        rests, self._seen = newest == self._seen, newest
        if newest is None or not rests or newest == self._told:
            return None
        self._told = newest
        return newest

    def is_there(self) -> bool:
        """Whether a file matches now."""
        return self._newest() is not None

    def is_still(self, version: Version) -> bool:
        """Whether nobody has written since: if so, what was read meanwhile is whole."""
        return _version(version.path) == version

    def _newest(self) -> Version | None:
        pattern = self._pattern
        # A name may have brackets.
        paths = [pattern] if os.path.exists(pattern) else glob.glob(pattern, recursive=True)
        found = [version for path in paths if (version := _version(Path(path)))]
        return max(found, key=lambda version: version.written, default=None)


def _version(path: Path) -> Version | None:
    try:
        found = [path.stat(), *_stats(_parts(path))]
    except OSError:  # it is being replaced
        return None
    files = sorted((each.st_ino, each.st_size, each.st_mtime_ns) for each in found)
    return Version(path, max(each.st_mtime_ns for each in found), tuple(files))


def _parts(path: Path) -> Iterator[Path]:
    """The files beside a scene's own that it may consist of."""
    if path.suffix.lower() == ".gltf":
        for buffers in ("*.bin", "*/*.bin"):
            yield from path.parent.glob(buffers)
    folder = path.parent if path.name in FOLDERS else path
    if folder.is_dir():
        for suffix in (".json", ".webp"):
            yield from folder.rglob(f"*{suffix}")


def _stats(paths: Iterable[Path]) -> Iterator[os.stat_result]:
    for path in paths:
        with suppress(OSError):  # it is gone by now
            yield path.stat()
