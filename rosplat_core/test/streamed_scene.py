"""Writes small streamed SOG scenes, as splat-transform lays them out."""

import io
import json
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from rosplat_core.formats import sog
from rosplat_core.generated import generate
from rosplat_core.splats import Splats, concatenate

LEVELS = (3000, 700, 100)  # splats of a chunk, the finest first
APART = 10.0  # chunks, along x [m]
ENVIRONMENT, ABOVE = 500, 100.0  # splats, and where they are [m]


def write_scene(
    folder: Path,
    chunks: int = 4,
    environment: bool = False,
    levels: Sequence[int] = LEVELS,
) -> Path:
    """A row of gardens, each a chunk, with a file for each level; returns its lod-meta.json.

    environment: another garden, high above them.
    """
    children: list[dict[str, Any]] = [{"lods": {}} for _ in range(chunks)]
    for level, count in enumerate(levels):
        parts = [garden(chunk, count) for chunk in range(chunks)]
        for chunk, part in enumerate(parts):
            low, high = part.positions.min(axis=0), part.positions.max(axis=0)
            children[chunk]["bound"] = {"min": low.tolist(), "max": high.tolist()}
            children[chunk]["lods"][str(level)] = {
                "file": level, "offset": count * chunk, "count": count,
            }  # fmt: skip
        unpack(concatenate(parts), folder / f"{level}_0")
    meta: dict[str, Any] = {
        "version": 1,
        "lodLevels": len(levels),
        "filenames": [f"{level}_0/meta.json" for level in range(len(levels))],
        "tree": {"bound": children[0]["bound"], "children": children},
    }
    if environment:
        above = garden(0, ENVIRONMENT)
        above.positions[:, 2] += np.float32(ABOVE)
        unpack(above, folder / "env")
        meta["environment"] = "env/meta.json"
    path = folder / "lod-meta.json"
    path.write_text(json.dumps(meta))
    return path


def garden(chunk: int, count: int) -> Splats:
    splats = generate(count, seed=chunk, sh_degree=0)
    splats.positions[:, 0] += np.float32(APART * chunk)
    return splats


def unpack(splats: Splats, folder: Path) -> None:
    """Writes a SOG scene as a folder."""
    packed = io.BytesIO()
    sog.write(packed, folder, splats)
    with zipfile.ZipFile(packed) as bundle:
        bundle.extractall(folder)


def edited(path: Path, **changes: Any) -> None:
    """Changes fields of a lod-meta.json."""
    path.write_text(json.dumps(json.loads(path.read_text()) | changes))
