"""What a folder stands for: a trainer's newest model, or tiles that are one scene together.

A trainer keeps a file for each of several iterations, INRIA's in point_cloud/iteration_N, gsplat's
in ply. Tiles are all files of one ending in a folder; a scene that is there in two formats has to
be named.
"""

from __future__ import annotations

import math
import re
from pathlib import Path
from types import ModuleType

import numpy as np

from rosplat_core.formats import compressed_ply, ply, sog, splat, spz
from rosplat_core.formats.decoded import (
    AS_TRAINED,
    Axes,
    Columns,
    Into,
    IntoSplats,
    Made,
    Progress,
    Warn,
    share,
)
from rosplat_core.splats import InputError, concatenate

NAME = "a folder of tiles"
READS = "a folder of tiles, a trainer's folder"

READERS = (compressed_ply, ply, spz, sog, splat)
ENDINGS = (".ply", ".splat", ".spz", ".sog")
MODELS = (
    "point_cloud/*/point_cloud.ply", "iteration_*/point_cloud.ply", "ply/point_cloud_*.ply",
    "*_shutdown/ply/point_cloud/*/point_cloud.ply",  # Photo-SLAM
)  # fmt: skip
# Brush's export_N, gsplat's point_cloud_N, LichtFeld's splat_N: one scene, trained for so long.
TRAINED = re.compile(r"(?:export|point_cloud|splat|step|iteration)_?\d+\.(?:ply|spz|splat)")


def newest(path: Path) -> tuple[Path, int]:
    """The file of a model's folder that was trained longest, and how many there are of them.

    Any other path stands for itself.
    """
    if not path.is_dir():
        return path, 1
    for pattern in MODELS:
        if found := list(path.glob(pattern)):
            return max(found, key=_iteration), len(found)
    found = _tiles(path)
    if found and all(TRAINED.fullmatch(file.name) for file in found):
        return max(found, key=_iteration), len(found)
    return path, 1


def recognises(path: Path, head: bytes) -> bool:
    """Whether a path is a folder with tiles."""
    return path.is_dir() and bool(_tiles(path))


def axes(path: Path) -> Axes:
    """Where the axes of the first tile point."""
    first = _tiles(path)[0]
    reader = _reader(first)
    return reader.axes(first) if hasattr(reader, "axes") else AS_TRAINED


def read(path: Path, progress: Progress, warn: Warn, into: Into[Made]) -> Made:
    """Reads all tiles, in the order of their names."""
    tiles = _tiles(path)
    endings = sorted({tile.suffix.lower() for tile in tiles})
    if len(endings) > 1:
        raise InputError(f"{path}: holds {' and '.join(endings)}: name a file")
    parts = []
    for number, tile in enumerate(tiles):
        part = share(progress, 0.9 * number / len(tiles), 0.9 * (number + 1) / len(tiles))
        parts.append(_reader(tile).read(tile, part, warn, IntoSplats()))
    try:
        joined = concatenate(parts)
    except ValueError as error:
        raise InputError(f"{path}: {error}") from error
    columns = Columns(
        joined.positions.astype(np.float64) + joined.origin,
        joined.orientations, joined.scales, joined.opacities, joined.sh,
    )  # fmt: skip
    return into.make(path, warn, columns, joined.model, joined.channels)


def _tiles(path: Path) -> list[Path]:
    """Without hidden files, which macOS lays beside others."""
    seen = (file for file in path.iterdir() if not file.name.startswith("."))
    return sorted(file for file in seen if file.suffix.lower() in ENDINGS and file.is_file())


def _reader(tile: Path) -> ModuleType:
    with tile.open("rb") as file:
        head = file.read(1 << 16)
    for reader in READERS:
        if reader.recognises(tile, head):
            return reader
    raise InputError(f"{tile}: no tile that can be read")


def _iteration(file: Path) -> tuple[float, str]:
    """The number in a file's name, or its folder's, and that name.

    MonoGS calls its last ones `final` and, refined, `final_after_opt`.
    """
    numbers = re.findall(r"\d+", file.stem) or re.findall(r"\d+", file.parent.name)
    return float(numbers[-1]) if numbers else math.inf, file.parent.name
