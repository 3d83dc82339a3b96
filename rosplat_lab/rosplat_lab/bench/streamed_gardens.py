"""A streamed SOG that anybody can make: gardens side by side, at three levels of detail."""

from __future__ import annotations

import io
import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from rosplat_core.formats import sog
from rosplat_core.formats.streamed_sog import META
from rosplat_core.generated import generate
from rosplat_core.splats import Splats, concatenate

SIDE = 4  # gardens along x, and along y
APART = 5.0  # distance of their middles [m]
LEVELS = (1, 4, 16)  # one in so many splats is left, the finest first


def write(folder: Path, count: int) -> Path:
    """Writes a scene of some `count` splats at its finest; returns its lod-meta.json."""
    names: list[str] = []
    chunks: list[dict[str, Any]] = []
    for number in range(SIDE * SIDE):
        quarters: list[dict[str, Any]] = [{"lods": {}} for _ in range(4)]
        for level, share in enumerate(LEVELS):
            splats = generate(max(4, count // SIDE**2 // share), seed=number, sh_degree=0)
            quarter = (splats.positions[:, 0] > 0) + 2 * (splats.positions[:, 1] > 0)
            parts = [splats[quarter == which] for which in range(4)]
            offset = 0
            for chunk, part in zip(quarters, parts, strict=True):
                part.positions[:, :2] += np.multiply(APART, divmod(number, SIDE)).astype(np.float32)
                chunk["lods"][str(level)] = {
                    "file": len(names), "offset": offset, "count": len(part),
                }  # fmt: skip
                offset += len(part)
                if level == 0:
                    low, high = part.positions.min(axis=0), part.positions.max(axis=0)
                    chunk["bound"] = {"min": low.tolist(), "max": high.tolist()}
            names.append(f"{level}_{number}/{sog.META}")
            _unpack(concatenate(parts), folder / f"{level}_{number}")
        chunks += quarters
    path = folder / META
    path.write_text(
        json.dumps(
            {
                "version": 1,
                "lodLevels": len(LEVELS),
                "filenames": names,
                "tree": {"children": chunks},
            }
        )
    )
    return path


def _unpack(splats: Splats, folder: Path) -> None:
    packed = io.BytesIO()
    sog.write(packed, folder, splats)
    with zipfile.ZipFile(packed) as bundle:
        bundle.extractall(folder)
