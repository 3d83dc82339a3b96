"""Streamed SOG (PlayCanvas): a tree of levels of detail over many SOG scenes, in a lod-meta.json.

As splat-transform writes it (read-lod.ts, write-lod.ts). It is named here, not read: its parts are
SOG scenes that can be.
"""

from __future__ import annotations

import json
from pathlib import Path

from rosplat_tools.formats.bounds import size_of
from rosplat_tools.formats.decoded import AS_TRAINED, Axes, Progress, Warn
from rosplat_tools.splats import SceneError, Splats

NAME = "streamed SOG"

META = "lod-meta.json"
LARGEST_META = 1 << 25  # [bytes]


def recognises(path: Path, head: bytes) -> bool:
    """Whether a path is a lod-meta.json, or a folder that has only that."""
    folder = (path / META).is_file() and not (path / "meta.json").is_file()
    return folder or path.name == META


def axes(path: Path) -> Axes:
    """Where a scene's axes point."""
    return AS_TRAINED


def read(path: Path, progress: Progress, warn: Warn) -> Splats:
    """Raises SceneError that says what the scene is and what of it can be read."""
    path = path / META if path.is_dir() else path
    if size_of(path) > LARGEST_META:
        raise SceneError(f"{path}: more than {LARGEST_META:,} bytes")
    try:
        meta = json.loads(path.read_bytes())
        levels, parts = meta["lodLevels"], meta["filenames"]
        found = f"{int(levels)} levels of detail in {len(parts):,} parts"
        example = next((str(part) for part in parts), "none")[:80]
    except (ValueError, KeyError, TypeError, RecursionError, OverflowError) as error:
        raise SceneError(f"{path}: broken {META}: {type(error).__name__}: {error}") from error
    raise SceneError(
        f"{path}: a streamed SOG, {found}: it can't be read whole yet, only its parts, such as "
        f"{example!r}"
    )
