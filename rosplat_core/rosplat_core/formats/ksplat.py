"""KSPLAT, the binary of mkkellogg's GaussianSplats3D, at its compression levels 0, 1 and 2.

A header of 4,096 bytes, headers of 1,024 bytes for as many sections as there is room for, and the
sections. In each: the number of splats in each bucket that isn't full (uint32), the centres of all
buckets (3 float32), the full ones first, and the splats, bucket by bucket:

    level 0   position, scales (3 float32 each), quaternion w x y z (4 float32)
    level 1   position (3 uint16: offsets from the bucket's centre), scales and quaternion in halves
    both      R G B, opacity (bytes); then harmonics of bands 1 and 2, each band channel by channel,
              in floats (level 0) or halves (1); level 2 is level 1 with bytes, between the header's
              least and greatest coefficient

All is little-endian. After src/loaders/SplatBuffer.js of github.com/mkkellogg/GaussianSplats3D and
splat-transform's read-ksplat.ts. The file has no signature: its ending tells the format.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rosplat_core.formats.bounds import claim, size_of
from rosplat_core.formats.decoded import Floats, Into, Made, Progress, Warn
from rosplat_core.formats.file_rows import FileRows
from rosplat_core.formats.strangers import packed
from rosplat_core.harmonics import C0 as SH_C0
from rosplat_core.splats import MAX_SH_DEGREE, InputError, sh_coefficients

NAME = ".ksplat"
READS = ".ksplat"
SUFFIX = NAME

VERSION = (0, 1)
HEADER = np.dtype(
    {
        "names": ["major", "minor", "sections", "count", "level", "least", "greatest"],
        "formats": ["u1", "u1", "<u4", "<u4", "<u2", "<f4", "<f4"],
        "offsets": [0, 1, 4, 16, 20, 36, 40],
        "itemsize": 4096,
    }
)
SECTION = np.dtype(
    {
        "names": [
            "count", "room", "bucket_size", "buckets", "block_size", "bucket_bytes", "steps",
            "full", "partial", "degree",
        ],
        "formats": ["<u4", "<u4", "<u4", "<u4", "<f4", "<u2", "<u4", "<u4", "<u4", "<u2"],
        "offsets": [0, 4, 8, 12, 16, 20, 24, 32, 36, 40],
        "itemsize": 1024,
    }
)  # fmt: skip
CENTRE_BYTES = 12
STEPS = 32767  # half the range of positions where a section names none
HARMONICS = 1.5  # and of harmonics, where the header names none
# By level: types of positions, of scales and rotations, of harmonics.
TYPES = (("<f4", "<f4", "<f4"), ("<u2", "<f2", "<f2"), ("<u2", "<f2", "u1"))


class Section(NamedTuple):
    """One section: its header, and where its parts begin in the file. [bytes]"""

    header: np.void
    counts: int
    centres: int
    splats: int


def recognises(path: Path, head: bytes) -> bool:
    """Whether a path has the ending, and is no archive."""
    return path.suffix.lower() == SUFFIX and not packed(head)


def read(path: Path, progress: Progress, warn: Warn, into: Into[Made]) -> Made:
    """Reads all sections; splats of one with fewer bands than others get zeros."""
    size = size_of(path)
    if size < HEADER.itemsize:
        raise InputError(f"{path}: truncated: {size:,} of a header's {HEADER.itemsize:,} bytes")
    data = FileRows(path, np.uint8, 0, size)
    header = data[: HEADER.itemsize].view(HEADER)[0]
    if (header["major"], header["minor"]) != VERSION:
        version = f"{header['major']}.{header['minor']}"
        raise InputError(f"{path}: KSPLAT version {version} can't be read, only 0.1")
    level = int(header["level"])
    if level >= len(TYPES):
        raise InputError(f"{path}: compression level {level}, expected 0 to {len(TYPES) - 1}")
    sections = _sections(path, data, header)
    n = sum(int(section.header["count"]) for section in sections)
    claim(path, n, 0, size)
    if n != header["count"]:
        raise InputError(f"{path}: {header['count']:,} splats, but {n:,} in its sections")

    degree = max((int(section.header["degree"]) for section in sections), default=0)
    counts = [int(section.header["count"]) for section in sections]
    centres = [_centres(path, data, section, level) for section in sections]
    for source, part, columns in into.blocks_of(counts, sh_coefficients(degree), progress):
        positions, orientations, scales, opacities, sh = columns
        section, centre = sections[source], centres[source]
        layout = _layout(level, int(section.header["degree"]))
        begin, end = (section.splats + i * layout.itemsize for i in (part.start, part.stop))
        block = data[begin:end].view(layout)
        positions[:] = block["position"]
        if centre is not None:
            steps = int(section.header["steps"]) or STEPS
            step = float(section.header["block_size"]) / 2 / steps
            positions[:] = (positions - steps) * step + centre[part]
        scales[:] = block["scale"]
        orientations[:] = np.roll(block["rotation"].astype(np.float32), -1, axis=1)
        rgba = block["rgba"] / np.float32(255)
        opacities[:] = rgba[:, 3]
        sh[:] = 0  # where a section has fewer bands
        sh[:, 0] = (rgba[:, :3] - 0.5) / SH_C0
        for band in range(1, int(section.header["degree"]) + 1):
            values = _harmonics(block[f"band_{band}"], header, level)
            first = sh_coefficients(band - 1)
            sh[:, first : first + 2 * band + 1] = values.transpose(0, 2, 1)
    return into.made(path, warn)


def _sections(path: Path, data: FileRows, header: np.void) -> list[Section]:
    """The sections, each of which lies within the file."""
    first = HEADER.itemsize
    place = first + int(header["sections"]) * SECTION.itemsize
    if place > len(data):
        raise InputError(f"{path}: truncated: no room for {header['sections']:,} sections")
    sections = []
    for i, section in enumerate(data[first:place].view(SECTION)):
        count, room, degree = (int(section[name]) for name in ("count", "room", "degree"))
        if degree > MAX_SH_DEGREE:
            raise InputError(f"{path}: section {i}: SH degree {degree}, expected 0 to 3")
        if count > room:
            raise InputError(f"{path}: section {i}: {count:,} splats, room for {room:,}")
        centres = place + 4 * int(section["partial"])
        splats = centres + int(section["bucket_bytes"]) * int(section["buckets"])
        place = splats + room * _layout(int(header["level"]), degree).itemsize
        if place > len(data):
            raise InputError(
                f"{path}: truncated: section {i} ends at {place:,}, the file at {len(data):,}"
            )
        sections.append(Section(section, centres - 4 * int(section["partial"]), centres, splats))
    return sections


def _layout(level: int, degree: int) -> np.dtype[Any]:
    """How a splat is laid out."""
    position, number, harmonic = TYPES[level]
    fields: list[Any] = [
        ("position", position, 3),
        ("scale", number, 3),
        ("rotation", number, 4),
        ("rgba", "u1", 4),
    ]
    fields += [(f"band_{band}", harmonic, (3, 2 * band + 1)) for band in range(1, degree + 1)]
    return np.dtype(fields)


def _centres(
    path: Path, data: FileRows, section: Section, level: int
) -> NDArray[np.float32] | None:
    """(splats, 3) centre of each splat's bucket, where positions are offsets from it."""
    if level == 0:
        return None
    header = section.header
    names = ("count", "bucket_size", "full", "partial", "buckets")
    count, bucket_size, full, partial, buckets = (int(header[name]) for name in names)
    counts = data[section.counts : section.centres].view("<u4").astype(np.int64)
    if (
        full + partial > buckets
        or header["bucket_bytes"] != CENTRE_BYTES
        or full * bucket_size + int(counts.sum()) != count
    ):
        raise InputError(f"{path}: the buckets of a section don't hold its {count:,} splats")
    centres = data[section.centres : section.splats].view("<f4").reshape(-1, 3)
    every = np.concatenate([np.full(full, bucket_size), counts])
    return np.repeat(centres[: full + partial], every, axis=0)


def _harmonics(stored: NDArray[Any], header: np.void, level: int) -> Floats:
    values: Floats = stored.astype(np.float32)
    if level == 2:
        least = header["least"] or np.float32(-HARMONICS)
        greatest = header["greatest"] or np.float32(HARMONICS)
        values = least + values / np.float32(255) * (greatest - least)
    return values
