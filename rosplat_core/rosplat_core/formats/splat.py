"""The .splat of antimatter15's viewer: 32 bytes a splat, one after the other, and nothing else.

    0   3 float32   position x y z
    12  3 float32   scales, linear
    24  4 bytes     R G B, opacity; 255 is 1
    28  4 bytes     quaternion w x y z; 128 + 128 q

All is little-endian. There are no spherical harmonics above band 0. After convert.py and main.js of
github.com/antimatter15/splat. The file has no signature: its ending tells the format.
"""

from __future__ import annotations

from pathlib import Path
from typing import BinaryIO

import numpy as np

from rosplat_core.formats.bounds import claim, size_of
from rosplat_core.formats.decoded import Into, Made, Progress, Warn, blocks
from rosplat_core.formats.file_rows import FileRows
from rosplat_core.formats.quantised import to_bytes
from rosplat_core.formats.strangers import packed
from rosplat_core.harmonics import C0 as SH_C0
from rosplat_core.splats import InputError, Splats

NAME = ".splat"
READS = ".splat"
SUFFIXES = (".splat",)

RECORD = np.dtype(
    [("position", "<f4", 3), ("scale", "<f4", 3), ("rgba", "u1", 4), ("rotation", "u1", 4)]
)


def recognises(path: Path, head: bytes) -> bool:
    """Whether a path has the ending, and is no archive."""
    return path.suffix.lower() in SUFFIXES and not packed(head)


def read(path: Path, progress: Progress, warn: Warn, into: Into[Made]) -> Made:
    """Reads a .splat file; its splats have SH degree 0."""
    size = size_of(path)
    n, rest = divmod(size, RECORD.itemsize)
    if rest:
        raise InputError(f"{path}: {size:,} bytes are no whole number of splats, 32 bytes each")
    claim(path, n, size, size)
    rows = FileRows(path, RECORD, 0, n)
    for part, columns in into.blocks(n, 1, progress):
        positions, orientations, scales, opacities, sh = columns
        block = rows[part]
        positions[:] = block["position"]
        scales[:] = block["scale"]
        rgba = block["rgba"] / np.float32(255)
        opacities[:] = rgba[:, 3]
        sh[:, 0] = (rgba[:, :3] - 0.5) / SH_C0
        wxyz = block["rotation"] / np.float32(128) - 1
        orientations[:] = np.roll(wxyz, -1, axis=1)
    return into.made(path, warn)


def write(stream: BinaryIO, path: Path, splats: Splats) -> None:
    """Writes splats without their higher bands; their model is lost, too."""
    for part in blocks(len(splats)):
        rows = np.empty(part.stop - part.start, RECORD)
        rows["position"] = splats.positions[part] + splats.origin
        rows["scale"] = splats.scales[part]
        rows["rgba"][:, :3] = to_bytes(255 * (SH_C0 * splats.sh[part, 0] + 0.5))
        rows["rgba"][:, 3] = to_bytes(255 * splats.opacities[part])
        rows["rotation"] = to_bytes(128 + 128 * np.roll(splats.orientations[part], 1, axis=1))
        stream.write(rows.tobytes())
