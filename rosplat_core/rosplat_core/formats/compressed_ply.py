"""PlayCanvas's compressed PLY: 16 bytes a splat, and 72 for each 256 of them; bands above 0 apart.

Element chunk has the ranges of up to 256 splats, in order: min_ and max_ x y z, scale_x .. scale_z
(logarithms) and, in newer files, r g b. Element vertex has four uint32 a splat, whose fields lie
between these ranges, the first one highest:

    packed_position  11 bits x, 10 y, 11 z
    packed_rotation  2 bits: which of w x y z is the largest; the others, 10 bits each, from
                     -sqrt(1/2) to sqrt(1/2)
    packed_scale     11, 10, 11 bits
    packed_color     8 bits each r g b, between 0 and 1 where a chunk has no ranges of them; opacity

Element sh, where there is one, has f_rest_* as in other PLYs, in bytes: 0 is -4, 255 is 4, others
are the middles of 256 steps. After github.com/playcanvas/splat-transform (decompress-ply.ts,
compressed-chunk.ts, write-compressed-ply.ts).
"""

from __future__ import annotations

from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from rosplat_core.formats.bounds import claim, size_of
from rosplat_core.formats.decoded import BLOCK, Floats, Into, Made, Progress, Warn, blocks
from rosplat_core.formats.ply import axes as axes  # of the comment, too
from rosplat_core.formats.ply import comments_of, model_in, rest_names
from rosplat_core.formats.ply_file import PlyFile, header
from rosplat_core.formats.quantised import largest_restored, smallest_three, to_bytes
from rosplat_core.harmonics import C0 as SH_C0
from rosplat_core.models import Model
from rosplat_core.splats import InputError, Splats

NAME = "compressed PLY"
READS = ".compressed.ply"
SUFFIXES = (".compressed.ply",)
MODELS = tuple(Model)
IN_SPACE_ORDER = True

CHUNK = 256  # splats
POSITION, ROTATION, SCALE, COLOR = (
    "packed_position", "packed_rotation", "packed_scale", "packed_color",
)  # fmt: skip
PACKED = [POSITION, ROTATION, SCALE, COLOR]
RANGES = [
    [f"{end}_{name}" for end in ("min", "max") for name in names]
    for names in (("x", "y", "z"), ("scale_x", "scale_y", "scale_z"), ("r", "g", "b"))
]
LOG_SCALES = (-20, 20)  # as splat-transform limits them

BITS_OF_3 = ((21, 11), (11, 10), (0, 11))  # shift and width of fields, the first one highest
BITS_OF_4 = ((24, 8), (16, 8), (8, 8), (0, 8))
BITS_OF_ROTATION = ((20, 10), (10, 10), (0, 10))
SQRT2 = np.float32(np.sqrt(2))


def recognises(path: Path, head: bytes) -> bool:
    """Whether a file begins like a PLY with packed positions."""
    end = head.find(b"end_header")
    return head[:3] == b"ply" and POSITION.encode() in head[: max(0, end)]


def read(path: Path, progress: Progress, warn: Warn, into: Into[Made]) -> Made:
    """Reads a compressed PLY, with or without ranges of colours, with or without higher bands."""
    file = PlyFile(path)
    for name in ("vertex", "chunk"):
        if name not in file.elements:
            raise InputError(f"{path}: no element {name}")
    n = file.elements["vertex"].length
    claim(path, n, 0, size_of(path))
    rows, chunks = file.rows("vertex"), file.rows("chunk")[:]
    for name in PACKED:
        if name not in (rows.dtype.names or ()) or rows.dtype[name] != np.dtype("u4"):
            raise InputError(f"{path}: no property uint {name} of element vertex")
    if len(chunks) != -(-n // CHUNK):
        raise InputError(f"{path}: {len(chunks):,} chunks of {CHUNK} for {n:,} splats")
    position_range, scale_range = (_range(path, chunks, names) for names in RANGES[:2])
    colored = RANGES[2][0] in (chunks.dtype.names or ())
    color_range = _range(path, chunks, RANGES[2]) if colored else None
    names: list[str] = []
    if "sh" in file.elements and file.elements["sh"].dtype.names:  # gsplat's has none at degree 0
        rest = file.rows("sh")
        names = rest_names(path, rest, warn)
        if len(rest) != n or any(rest.dtype[name] != np.dtype("u1") for name in names):
            raise InputError(f"{path}: element sh: expected bytes, for {n:,} splats")

    bands = len(names) // 3
    for part, columns in into.blocks(n, 1 + bands, progress):
        positions, orientations, scales, opacities, sh = columns
        block = rows[part]
        chunk = np.arange(part.start, part.stop) // CHUNK
        positions[:] = _between(_fields(block[POSITION], BITS_OF_3), position_range, chunk)
        scales[:] = np.exp(_between(_fields(block[SCALE], BITS_OF_3), scale_range, chunk))
        others = (_fields(block[ROTATION], BITS_OF_ROTATION) - np.float32(0.5)) * SQRT2
        wxyz = largest_restored(block[ROTATION] >> 30, others)
        orientations[:] = np.roll(wxyz, -1, axis=1)
        rgba = _fields(block[COLOR], BITS_OF_4)
        rgb = rgba[:, :3] if color_range is None else _between(rgba[:, :3], color_range, chunk)
        sh[:, 0] = (rgb - 0.5) / SH_C0
        opacities[:] = rgba[:, 3]
        if bands:
            block = rest[part]
            by_channel = _COEFFICIENTS[np.stack([block[name] for name in names], axis=1)]
            sh[:, 1:] = by_channel.reshape(-1, 3, bands).transpose(0, 2, 1)
    return into.made(path, warn, model_in(file.comments) or Model.EWA)


def write(stream: BinaryIO, path: Path, splats: Splats) -> None:
    """Writes splats, with ranges of colours; neighbours in order must be neighbours in space."""
    n, bands = len(splats), splats.sh.shape[1] - 1
    ranges = np.empty((-(-n // CHUNK), 18), "<f4")
    packed = np.empty((n, 4), "<u4")
    for part in blocks(n):
        chunks = slice(part.start // CHUNK, -(-part.stop // CHUNK))
        fields = (
            splats.positions[part] + splats.origin,
            np.log(np.maximum(splats.scales[part], np.finfo(np.float32).tiny)).clip(*LOG_SCALES),
            SH_C0 * splats.sh[part, 0] + 0.5,
        )
        found = [_ranges_of(values.astype(np.float32)) for values in fields]
        ranges[chunks] = np.concatenate([ends for ends, _ in found], axis=1)
        position, scale, color = (fractions for _, fractions in found)
        packed[part, 0] = _packed(position, BITS_OF_3)
        packed[part, 2] = _packed(scale, BITS_OF_3)
        opacity = splats.opacities[part, None]
        packed[part, 3] = _packed(np.concatenate([color, opacity], axis=1), BITS_OF_4)
        largest, others = smallest_three(np.roll(splats.orientations[part], 1, axis=1))
        packed[part, 1] = _packed(others / SQRT2 + 0.5, BITS_OF_ROTATION)
        packed[part, 1] |= largest.astype(np.uint32) << 30
    elements = {
        "chunk": (len(ranges), np.dtype([(name, "<f4") for names in RANGES for name in names])),
        "vertex": (n, np.dtype([(name, "<u4") for name in PACKED])),
    }
    if bands:
        elements["sh"] = (n, np.dtype([(f"f_rest_{i}", "u1") for i in range(3 * bands)]))
    stream.write(header(elements, comments_of(splats)))
    stream.write(ranges.data)
    stream.write(packed.data)
    for part in blocks(n if bands else 0):
        by_channel = splats.sh[part, 1:].transpose(0, 2, 1).reshape(-1, 3 * bands)
        stream.write(to_bytes(np.floor(by_channel * 32 + 128)).tobytes())


def _coefficients() -> NDArray[np.float32]:
    middles = (np.arange(256) + 0.5) / 256
    middles[[0, 255]] = 0, 1
    return ((middles - 0.5) * 8).astype(np.float32)


_COEFFICIENTS = _coefficients()  # what a byte of element sh stands for


def _range(path: Path, chunks: NDArray[np.void], names: list[str]) -> Floats:
    """(chunks, 2, 3) least and greatest values."""
    missing = [name for name in names if name not in (chunks.dtype.names or ())]
    if missing:
        raise InputError(f"{path}: no property {', '.join(missing)} of element chunk")
    columns = [chunks[name].astype(np.float32) for name in names]
    return np.stack(columns, axis=1).reshape(-1, 2, 3)


def _fields(packed: NDArray[np.uint32], bits: tuple[tuple[int, int], ...]) -> Floats:
    """(n,) packed numbers to (n, fields) fractions of 1."""
    widest = [np.uint32((1 << width) - 1) for _, width in bits]
    columns = [
        (packed >> np.uint32(shift) & most) / np.float32(most)
        for (shift, _), most in zip(bits, widest, strict=True)
    ]
    return np.stack(columns, axis=1).astype(np.float32)


def _packed(fractions: Floats, bits: tuple[tuple[int, int], ...]) -> NDArray[np.uint32]:
    """The inverse of _fields: each field is the nearest that there is."""
    packed = np.zeros(len(fractions), np.uint32)
    for i, (shift, width) in enumerate(bits):
        most = (1 << width) - 1
        field = np.clip(np.rint(fractions[:, i] * most), 0, most).astype(np.uint32)
        packed |= field << np.uint32(shift)
    return packed


def _between(fractions: Floats, ends: Floats, chunk: NDArray[np.intp]) -> Floats:
    """Values at fractions of the ranges of their chunks."""
    least, greatest = ends[chunk, 0], ends[chunk, 1]
    values: Floats = least * (1 - fractions) + greatest * fractions
    return values


def _ranges_of(values: Floats) -> tuple[Floats, Floats]:
    """(n, 3) values to the ranges (chunks, 6) of their chunks, and (n, 3) fractions of these."""
    starts = np.arange(0, len(values), CHUNK)
    least = np.minimum.reduceat(values, starts)
    greatest = np.maximum.reduceat(values, starts)
    chunk = np.arange(len(values)) // CHUNK
    # Differences may be beyond float32.
    span = np.maximum(greatest.astype(np.float64) - least, np.finfo(np.float32).tiny)
    fractions = (values.astype(np.float64) - least[chunk]) / span[chunk]
    return np.concatenate([least, greatest], axis=1), fractions


assert BLOCK % CHUNK == 0  # so that blocks are whole chunks
