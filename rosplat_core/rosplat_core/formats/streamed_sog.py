"""Streamed SOG (PlayCanvas): levels of detail of each of many chunks of space, in a lod-meta.json.

    lodLevels   how many levels there are at most; 0 is the finest
    filenames   SOG scenes, relative to lod-meta.json, that the levels are parts of
    tree        nodes with `children`, or chunks: `bound` {min, max} of its splats [m], and `lods`
                {level: {file, offset, count}}: which splats of which file
    environment a SOG scene around it all: a chunk of one level, where there is one

As splat-transform writes it (read-lod.ts, write-lod.ts).
"""

from __future__ import annotations

import json
import threading
from collections import OrderedDict
from concurrent.futures import CancelledError
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rosplat_core.formats import sog
from rosplat_core.formats.bounds import naming_the_file, refusing, size_of
from rosplat_core.formats.decoded import Into, IntoSplats, Made, Progress, Warn, one_model
from rosplat_core.log_text import shown
from rosplat_core.models import Model
from rosplat_core.slot_pages import MAX_SLOTS
from rosplat_core.splats import InputError, Splats, concatenate, sh_coefficients

NAME = "streamed SOG"
READS = "lod-meta.json"

META = "lod-meta.json"
LARGEST_META = 1 << 25  # [bytes]
MOST_FILES = 100_000
DEEPEST = 64  # of a tree; it halves space
FARTHEST = 1e15  # that a bound may be [m]


@dataclass(frozen=True)
class FileRange:
    """Splats [offset, offset + count) of one of a scene's files."""

    file: int
    offset: int
    count: int


@dataclass(frozen=True)
class Chunk:
    """A part of space: its bounds, (3,) each [m], and its levels, the coarsest first."""

    low: NDArray[np.float64]
    high: NDArray[np.float64]
    levels: tuple[FileRange, ...]


@dataclass(frozen=True)
class Streamed:
    """The contents of a lod-meta.json."""

    path: Path
    files: tuple[Path, ...]
    chunks: tuple[Chunk, ...]
    sh_degree: int
    """The highest of its files."""
    model: Model

    @property
    def splats(self) -> int:
        """Number of splats of all chunks at their finest."""
        return sum(chunk.levels[-1].count for chunk in self.chunks)


def recognises(path: Path, head: bytes) -> bool:
    """Whether a path is a lod-meta.json, or a folder with one but without a SOG's meta.json."""
    folder = (path / META).is_file() and not (path / sog.META).is_file()
    return folder or path.name == META


def read(path: Path, progress: Progress, warn: Warn, into: Into[Made]) -> Made:
    """Reads all chunks at their finest, where they fit into a map."""
    scene = open_streamed(path)
    if scene.splats > MAX_SLOTS:
        raise InputError(
            f"{scene.path}: {scene.splats:,} splats; a map has at most {MAX_SLOTS:,}, "
            "stream_publisher shows more"
        )
    pieces = Pieces(scene, warn)
    parts = sorted((chunk.levels[-1] for chunk in scene.chunks), key=lambda p: (p.file, p.offset))
    counts, k = [part.count for part in parts], sh_coefficients(scene.sh_degree)
    for source, rows, columns in into.blocks_of(counts, k, progress):
        first = parts[source].offset
        packed = pieces.packed(parts[source].file)
        packed.decode(slice(first + rows.start, first + rows.stop), columns)
    return into.made(scene.path, warn, scene.model)


def read_coarsest(scene: Streamed, warn: Warn) -> Splats:
    """The coarsest level of every chunk. Raises InputError for a file that can't be read."""
    pieces = Pieces(scene, warn)
    parts = sorted((chunk.levels[0] for chunk in scene.chunks), key=lambda p: (p.file, p.offset))
    return concatenate([pieces.read(part) for part in parts if part.count])


def open_streamed(path: Path) -> Streamed:
    """Reads a lod-meta.json, and checks its claims against its files' own meta.json.

    Raises InputError naming a file that is missing, can't be read or has fewer splats than a level
    takes from it, and for a scene without a chunk.
    """
    path = path / META if path.is_dir() else path
    if path.exists() and not recognises(path, b""):
        raise InputError(f"{path}: not a {META}, which a streamed SOG has")
    with naming_the_file(path):
        if size_of(path) > LARGEST_META:
            raise InputError(f"{path}: more than {LARGEST_META:,} bytes")
        with refusing(f"{path}: broken {META}"):
            return _scene(path, json.loads(path.read_bytes()))


def _scene(path: Path, meta: Any) -> Streamed:
    if meta.get("version", 1) != 1:
        raise InputError(f"{path}: version {shown(repr(meta['version']))} can't be read, only 1")
    names = meta["filenames"]
    if not isinstance(names, list) or len(names) > MOST_FILES:
        raise InputError(f"{path}: filenames: expected a list of {MOST_FILES:,} names at most")
    files = [_inside(path, name) for name in names]
    chunks: list[Chunk] = []
    nodes = [(meta["tree"], 0)]
    while nodes:
        node, depth = nodes.pop()
        if depth > DEEPEST:
            raise InputError(f"{path}: tree: deeper than {DEEPEST}")
        nodes += [(child, depth + 1) for child in node.get("children") or ()]
        levels = [_part(path, level, node["lods"], len(names)) for level in _levels(node)]
        levels = [part for part in levels if part.count]
        if levels:
            low, high = (np.array(node["bound"][end], np.float64) for end in ("min", "max"))
            if low.shape != (3,) or high.shape != (3,) or not (low <= high).all():
                raise InputError(f"{path}: bound: expected min and max of three numbers")
            if not (np.abs([low, high]) < FARTHEST).all():
                raise InputError(f"{path}: bound: a number is not finite, or beyond {FARTHEST:g} m")
            chunks.append(Chunk(low, high, tuple(levels)))
    if not chunks:
        raise InputError(f"{path}: holds no splats")
    claims = _claims(files, chunks)
    if meta.get("environment") is not None:
        files.append(_inside(path, meta["environment"]))
        claims.append(sog.claims(files[-1]))
        low = np.min([chunk.low for chunk in chunks], axis=0)
        high = np.max([chunk.high for chunk in chunks], axis=0)
        if claims[-1].splats:
            chunks.append(Chunk(low, high, (FileRange(len(files) - 1, 0, claims[-1].splats),)))
    model = one_model(path, [claim.model for claim in claims])
    degree = max(claim.sh_degree for claim in claims)
    return Streamed(path, tuple(files), tuple(chunks), degree, model)


def _claims(files: list[Path], chunks: list[Chunk]) -> list[sog.Claims]:
    """Claims of the files that chunks use. Raises InputError for one with too few splats."""
    ends = dict.fromkeys(range(len(files)), 0)
    for chunk in chunks:
        for part in chunk.levels:
            ends[part.file] = max(ends[part.file], part.offset + part.count)
    found = []
    for file, end in ends.items():
        if not end:
            continue
        claims = sog.claims(files[file])
        if claims.splats < end:
            raise InputError(
                f"{files[file]}: holds {claims.splats:,} splats, {META} wants {end:,} of it"
            )
        found.append(claims)
    return found


def _levels(node: Any) -> list[str]:
    """Names of a node's levels, the coarsest first."""
    return sorted(node.get("lods") or (), key=int, reverse=True)


def _part(path: Path, level: str, lods: Any, files: int) -> FileRange:
    numbers = {name: lods[level][name] for name in ("file", "offset", "count")}
    for name, number in numbers.items():
        most = files - 1 if name == "file" else MAX_SLOTS
        if type(number) is not int or not 0 <= number <= most:  # true is an int, too
            raise InputError(
                f"{path}: {name} of level {shown(level)} is {shown(repr(number))}, "
                f"expected 0 to {most:,}"
            )
    return FileRange(**numbers)


def _inside(path: Path, name: Any) -> Path:
    """A file below lod-meta.json's folder. Raises InputError for any other name."""
    relative = Path(name)
    outside = relative.is_absolute() or ".." in relative.parts
    if outside or "\0" in name or len(name) > sog.LONGEST_NAME:
        raise InputError(f"{path}: {shown(repr(name))} is not a file below {META}")
    return path.parent / relative


class Pieces:
    """Reads levels of chunks as splats; keeps the files that were used last, packed.

    Safe from any thread; several threads decode several files at a time.
    """

    KEPT_BYTES = 1 << 28  # of files, but always one

    def __init__(self, scene: Streamed, warn: Warn) -> None:
        self._scene = scene
        self._warn = warn
        self._kept: OrderedDict[int, sog.Packed] = OrderedDict()
        self._lock = threading.Lock()
        self._decoding = [threading.Lock() for _ in scene.files]
        self._closed = False

    def read(self, part: FileRange) -> Splats:
        """A level of a chunk, without splats that can't be drawn.

        Raises InputError that names the file that can't be read, and CancelledError after close().
        """
        which = slice(part.offset, part.offset + part.count)
        with naming_the_file(self._scene.files[part.file]):
            return self.packed(part.file).splats(which, self._warn, IntoSplats())

    def packed(self, file: int) -> sog.Packed:
        """A file's splats, packed. Raises as read does."""
        path = self._scene.files[file]

        def go_on(_: float) -> None:
            if self._closed:
                raise CancelledError

        with naming_the_file(path), self._decoding[file]:
            with self._lock:
                found = self._kept.get(file)
            found = found or sog.unpack(path, go_on)
            with self._lock:
                self._kept[file] = found
                self._kept.move_to_end(file)
                room = self.KEPT_BYTES - sum(kept.nbytes for kept in self._kept.values())
                while room < 0 and len(self._kept) > 1:
                    room += self._kept.popitem(last=False)[1].nbytes
            return found

    def close(self) -> None:
        """Ends decoding, also in other threads, which get CancelledError."""
        self._closed = True
