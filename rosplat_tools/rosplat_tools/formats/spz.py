"""SPZ, versions 2 and 3, after github.com/nianticlabs/spz (load-spz.cc, splat-utils.h).

One gzip stream: a header of 16 bytes, then the attributes one after the other, quantised.
"""

from __future__ import annotations

import gzip
import struct
import zlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rosplat_tools.formats.decoded import Floats, Progress, Warn, decoded
from rosplat_tools.splats import MAX_SH_DEGREE, SceneError, Splats, sh_coefficients

NAME = "SPZ"

MAGIC = b"NGSP"
HEADER = struct.Struct("<4sIIBBBx")  # magic, version, points, SH degree, fractional bits, flags
FLAG_ANTIALIASED = 0x1

COLOR_SCALE = 0.15  # of the first SH coefficient: room for colours outside 0..1
MAX_DEFLATE_RATIO = 1032  # zlib's limit: what claims more is a broken header, or a bomb


def recognises(path: Path, head: bytes) -> bool:
    """Whether a file begins like gzip, or like SPZ 4, which is told apart when it is read."""
    return head[:2] == b"\x1f\x8b" or head[:4] == MAGIC


def read(path: Path, progress: Progress, warn: Warn) -> Splats:
    """Reads an SPZ file in its own coordinates (by convention x right, y up, z back)."""
    with path.open("rb") as stream:
        if stream.read(4) == MAGIC:
            raise SceneError(f"{path}: SPZ version 4 and later can't be read, only 2 and 3")
        stream.seek(0)
        try:
            return _read(path, gzip.GzipFile(fileobj=stream), progress, warn)
        except (EOFError, zlib.error, gzip.BadGzipFile) as error:
            raise SceneError(f"{path}: broken gzip stream: {error}") from error


def _read(path: Path, stream: gzip.GzipFile, progress: Progress, warn: Warn) -> Splats:
    header = stream.read(HEADER.size)
    if header[:4] != MAGIC or len(header) < HEADER.size:
        raise SceneError(f"{path}: gzip, but not SPZ: magic {header[:4]!r}, expected {MAGIC!r}")
    _, version, n, degree, fractional_bits, flags = HEADER.unpack(header)
    if version not in (2, 3):
        raise SceneError(f"{path}: SPZ version {version} can't be read, only 2 and 3")
    if degree > MAX_SH_DEGREE:
        raise SceneError(f"{path}: SH degree {degree}, expected 0 to {MAX_SH_DEGREE}")
    if fractional_bits > 24:
        raise SceneError(f"{path}: {fractional_bits} fractional bits, expected 0 to 24")

    bands = sh_coefficients(degree) - 1
    widths = {
        "positions": 9,
        "opacities": 1,
        "colors": 3,
        "scales": 3,
        "rotations": 3 if version == 2 else 4,
        "sh": 3 * bands,
    }
    expected = n * sum(widths.values())
    if expected > path.stat().st_size * MAX_DEFLATE_RATIO:
        raise SceneError(f"{path}: {n:,} splats can't be packed in {path.stat().st_size:,} bytes")
    raw: dict[str, NDArray[np.uint8]] = {}
    for i, (name, width) in enumerate(widths.items()):
        data = stream.read(n * width)
        if len(data) < n * width:
            raise SceneError(
                f"{path}: truncated: expected {n * width:,} bytes of {name}, found {len(data):,}"
            )
        raw[name] = np.frombuffer(data, np.uint8).reshape(n, width)
        progress((i + 1) / (len(widths) + 1))
    while stream.read(1 << 20):  # to the checksum, which is behind whatever else there is
        pass

    sh = np.empty((n, 1 + bands, 3), np.float32)
    sh[:, 0] = (raw["colors"] / 255 - 0.5) / COLOR_SCALE
    sh[:, 1:] = raw["sh"].reshape(n, bands, 3)
    sh[:, 1:] -= 128  # in place: they are most of a scene
    sh[:, 1:] /= 128
    return decoded(
        path,
        warn,
        positions=_fixed24(raw["positions"]) / (1 << fractional_bits),
        orientations=(_first_three if version == 2 else _smallest_three)(raw["rotations"]),
        scales=np.exp(raw["scales"] / np.float32(16) - 10),
        opacities=raw["opacities"][:, 0] / np.float32(255),
        sh=sh,
        antialiased=bool(flags & FLAG_ANTIALIASED),
    )


def _fixed24(raw: NDArray[np.uint8]) -> NDArray[np.int32]:
    """(n, 9) bytes to (n, 3) little-endian signed integers of 24 bits."""
    padded = np.zeros((len(raw), 3, 4), np.uint8)
    padded[..., 1:] = raw.reshape(-1, 3, 3)
    return padded.view("<i4")[..., 0] >> 8  # the shift carries the sign down


def _first_three(raw: NDArray[np.uint8]) -> Floats:
    """(n, 3) bytes x, y, z of quaternions with w >= 0, to (n, 4) x, y, z, w."""
    xyz = raw / np.float32(127.5) - 1
    w = np.sqrt(np.maximum(0, 1 - (xyz**2).sum(axis=1)))
    return np.column_stack([xyz, w])


def _smallest_three(raw: NDArray[np.uint8]) -> Floats:
    """(n, 4) bytes to (n, 4) x, y, z, w: 2 bits index the largest, the others are 10 bits each.

    A component is a sign bit and 9 bits of magnitude over sqrt(1/2); the last sits lowest.
    """
    packed = np.ascontiguousarray(raw).view("<u4")[:, 0]
    largest = packed >> 30
    quaternions = np.zeros((len(raw), 4), np.float32)
    for component in (3, 2, 1, 0):
        stored = largest != component
        bits = packed[stored]
        magnitude = (bits & 511) / np.float32(511) * np.float32(np.sqrt(0.5))
        quaternions[stored, component] = np.where(bits & 512, -magnitude, magnitude)
        packed = np.where(stored, packed >> 10, packed)
    rest = np.maximum(0, 1 - (quaternions**2).sum(axis=1))
    quaternions[np.arange(len(raw)), largest] = np.sqrt(rest)
    return quaternions
