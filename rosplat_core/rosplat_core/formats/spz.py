"""SPZ, versions 1 to 4, after github.com/nianticlabs/spz (README.md, load-spz.cc, splat-utils.h).

Header, little-endian: magic NGSP, version (4 bytes each), number of splats (4), SH degree,
fractional bits, flags (1: antialiased, 2: has extensions), number of streams (1 byte each); from
version 4 on, place of the table of contents (4) and 12 zeros. Then the attributes, splat by splat:

    positions  3 x 24 bits, signed, with so many fractional bits; version 1: 3 half floats
    alphas     8 bits, 255 is 1
    colors     3 x 8 bits: 255 (0.15 sh[0] + 0.5)
    scales     3 x 8 bits: 16 (log(scale) + 10)
    rotations  to version 2: x y z in 8 bits each, w >= 0; from version 3 on, the smallest three
               components in 10 bits each (sign and magnitude), under the largest one's index
    sh         8 bits a coefficient, RGB fastest: 128 + 128 sh

Versions 1 to 3 are one gzip stream. Version 4 begins with the plain header, then extensions (type,
length, data), the table of contents (packed and unpacked size of each stream, 8 bytes each), and
one Zstandard frame for each attribute that isn't empty.
"""

from __future__ import annotations

import gzip
import struct
import zlib
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rosplat_core.formats.bounds import claim, size_of, unpackable
from rosplat_core.formats.decoded import Axes, Floats, Into, Made, Progress, Warn, blocks
from rosplat_core.formats.quantised import largest_restored, smallest_three, to_bytes
from rosplat_core.formats.strangers import GZIP, beginning
from rosplat_core.log_text import shown
from rosplat_core.models import Model
from rosplat_core.splats import MAX_SH_DEGREE, InputError, Splats, sh_coefficients

NAME = "SPZ"
READS = ".spz"
SUFFIXES = (".spz",)
MODELS = (Model.EWA, Model.EWA_ANTIALIASED)
IN_SPACE_ORDER = True  # packs better

MAGIC = b"NGSP"
VERSION = 4  # that is written
HEADER = struct.Struct("<4sIIBBBB")
TABLE_PLACE = struct.Struct("<I12x")  # follows HEADER in version 4
TABLE_ENTRY = struct.Struct("<QQ")  # sizes of a stream: packed, unpacked
EXTENSION = struct.Struct("<II")  # type, length
FLAG_ANTIALIASED = 0x1
FLAG_EXTENSIONS = 0x2

COLOR_SCALE = 0.15  # of the first SH coefficient: room for colours outside 0..1
SH_BITS = (5, 4)  # of band 1 and of those above it, as the reference writer does
FRACTIONAL_BITS = 12  # the reference writer's: a quarter of a millimetre
STORED_DEGREE = 4  # that a file may have, at most

# Extension SPZ_ADOBE_coordinate_system: directions of x, y, z (Left, Up, Front, ...) by number.
COORDINATE_SYSTEM = 0xADBE0003
SYSTEMS = (
    "RUB", "LDB", "RDB", "LUB", "RUB", "LDF", "RDF", "LUF", "RUF",  # 0 is unspecified
    "LFD", "RFD", "LFU", "RFU", "LBD", "RBD", "LBU", "RBU",
)  # fmt: skip


class Header(NamedTuple):
    """The header of a file, without its magic."""

    version: int
    splats: int
    degree: int
    fractional_bits: int
    flags: int
    streams: int

    @property
    def widths(self) -> dict[str, int]:
        """Size of each attribute, in the file's order. [bytes/splat]"""
        return {
            "positions": 6 if self.version == 1 else 9,
            "alphas": 1,
            "colors": 3,
            "scales": 3,
            "rotations": 3 if self.version < 3 else 4,
            "sh": 3 * (sh_coefficients(self.degree) - 1),
        }


Packed = dict[str, NDArray[np.uint8]]


def recognises(path: Path, head: bytes) -> bool:
    """Whether a file begins like version 4, plain or in gzip, or is a gzip with the ending."""
    if head.startswith(GZIP):
        return path.suffix.lower() == SUFFIXES[0] or beginning(head, len(MAGIC)) == MAGIC
    return head[:4] == MAGIC


def axes(path: Path) -> Axes:
    """Where a file's axes point: right, up, back, unless an extension says otherwise."""
    with path.open("rb") as stream:
        system = _system(path, stream) if stream.read(4) == MAGIC else SYSTEMS[0]
    names = {"R": "right", "L": "left", "U": "up", "D": "down", "F": "to the front", "B": "back"}
    text = ", ".join(f"{axis} {names[way]}" for axis, way in zip("xyz", system, strict=True))
    up = [{"U": 1.0, "D": -1.0}.get(way, 0.0) for way in system]
    return Axes(f"{text} (by SPZ's rule)", (up[0], up[1], up[2]))


def read(path: Path, progress: Progress, warn: Warn, into: Into[Made]) -> Made:
    """Reads an SPZ file in its own coordinates. A fourth band of harmonics is left out."""
    size = size_of(path)
    with path.open("rb") as stream:
        magic = stream.read(4)
        stream.seek(0)
        if magic == MAGIC:
            header, packed = _read_streams(path, stream, size, progress)
        else:
            try:
                header, packed = _read_gzip(path, stream, size, progress)
            except (EOFError, zlib.error, gzip.BadGzipFile) as error:
                raise InputError(f"{path}: broken gzip stream: {shown(error)}") from error
            if header.flags & FLAG_EXTENSIONS:
                warn(f"{path}: extensions left out; they may turn the axes")
    if header.degree > MAX_SH_DEGREE:
        warn(f"{path}: spherical harmonics of band {header.degree} left out")
    return _unpack(path, header, packed, warn, into)


def write(stream: BinaryIO, path: Path, splats: Splats) -> None:
    """Writes splats as version 4, coordinates as they are. Needs the Python package zstandard.

    Keeps fewer fractional bits for far positions; raises InputError where even none leave room.
    """
    zstandard = require(path)
    degree = splats.sh_degree
    bits = _fractional_bits(path, splats)
    flags = FLAG_ANTIALIASED if splats.model is Model.EWA_ANTIALIASED else 0
    header = Header(VERSION, len(splats), degree, bits, flags, 0)
    packed = {
        name: np.empty((len(splats), width), np.uint8) for name, width in header.widths.items()
    }
    for part in blocks(len(splats)):
        fixed = np.rint((splats.positions[part] + splats.origin) * (1 << bits)).astype("<i4")
        as_bytes = fixed.view(np.uint8).reshape(-1, 3, 4)
        packed["positions"][part] = as_bytes[..., :3].reshape(-1, 9)
        packed["alphas"][part, 0] = to_bytes(255 * splats.opacities[part])
        packed["colors"][part] = to_bytes(255 * (COLOR_SCALE * splats.sh[part, 0] + 0.5))
        logarithms = np.log(np.maximum(splats.scales[part], np.finfo(np.float32).tiny))
        packed["scales"][part] = to_bytes(16 * (logarithms + 10))
        packed["rotations"][part] = _packed_rotations(splats.orientations[part])
        packed["sh"][part] = _packed_sh(splats.sh[part, 1:])
    compressor = zstandard.ZstdCompressor(level=12, threads=-1)
    streams = [
        (data.nbytes, compressor.compress(data.data)) for data in packed.values() if data.nbytes
    ]
    header = header._replace(streams=len(streams))
    stream.write(HEADER.pack(MAGIC, *header))
    stream.write(TABLE_PLACE.pack(HEADER.size + TABLE_PLACE.size))
    for unpacked, data in streams:
        stream.write(TABLE_ENTRY.pack(len(data), unpacked))
    for _, data in streams:
        stream.write(data)


# --- Containers -----------------------------------------------------------------------------------


def _header(path: Path, data: bytes, versions: range) -> Header:
    if len(data) < HEADER.size:
        raise InputError(f"{path}: truncated: {len(data)} of a header's {HEADER.size} bytes")
    magic, *fields = HEADER.unpack(data)
    if magic != MAGIC:
        raise InputError(f"{path}: gzip, but not SPZ: magic {magic!r}, expected {MAGIC!r}")
    header = Header(*fields)
    if header.version not in versions:
        raise InputError(
            f"{path}: SPZ version {header.version} can't be read; so packed, only "
            f"{versions[0]} to {versions[-1]}"
        )
    if header.degree > STORED_DEGREE:
        raise InputError(f"{path}: SH degree {header.degree}, expected 0 to {STORED_DEGREE}")
    if header.fractional_bits > 24:
        raise InputError(f"{path}: {header.fractional_bits} fractional bits, expected 0 to 24")
    return header


def _read_gzip(
    path: Path, stream: BinaryIO, size: int, progress: Progress
) -> tuple[Header, Packed]:
    """Versions 1 to 3: header and attributes in one gzip stream."""
    unzipped = gzip.GzipFile(fileobj=stream)
    header = _header(path, unzipped.read(HEADER.size), range(1, 4))
    claim(path, header.splats, header.splats * sum(header.widths.values()), size)
    packed = {}
    for i, (name, width) in enumerate(header.widths.items()):
        data = np.empty((header.splats, width), np.uint8)
        target = data.reshape(-1).data
        found = 0
        while found < data.nbytes:
            piece = unzipped.read(min(data.nbytes - found, 1 << 20))
            if not piece:
                raise InputError(
                    f"{path}: truncated: expected {data.nbytes:,} bytes of {name}, found {found:,}"
                )
            target[found : found + len(piece)] = piece
            found += len(piece)
        packed[name] = data
        progress((i + 1) / (len(header.widths) + 1))
    # Reads on to the checksum at the end of the stream, past whatever else it holds.
    for _ in range(0, unpackable(size), 1 << 20):
        if not unzipped.read(1 << 20):
            return header, packed
    raise InputError(f"{path}: more than {unpackable(size):,} bytes behind the attributes")


def _read_streams(
    path: Path, stream: BinaryIO, size: int, progress: Progress
) -> tuple[Header, Packed]:
    """Version 4: a stream for each attribute."""
    header, table_place = _header_4(path, stream)
    claim(path, header.splats, header.splats * sum(header.widths.values()), size)
    sizes = {name: header.splats * width for name, width in header.widths.items()}
    stored = [name for name in sizes if sizes[name]]
    if header.streams != len(stored):
        raise InputError(f"{path}: {header.streams} streams, expected {len(stored)}")
    stream.seek(table_place)
    table = stream.read(TABLE_ENTRY.size * header.streams)
    if len(table) < TABLE_ENTRY.size * header.streams:
        raise InputError(f"{path}: truncated: no table of contents at {table_place:,}")
    zstandard = require(path)
    packed: Packed = {}
    for name, width in header.widths.items():
        data = b""
        if name in stored:
            held, unpacked = TABLE_ENTRY.unpack_from(table, TABLE_ENTRY.size * len(packed))
            if unpacked != sizes[name]:
                raise InputError(
                    f"{path}: {unpacked:,} bytes of {name}, expected {sizes[name]:,} for "
                    f"{header.splats:,} splats"
                )
            if held > size - stream.tell():
                raise InputError(
                    f"{path}: truncated: {held:,} bytes of {name} expected, "
                    f"{size - stream.tell():,} left"
                )
            frame = stream.read(held)
            try:
                if zstandard.frame_content_size(frame) not in (-1, unpacked):
                    raise InputError(f"{path}: {name}: its frame and the table disagree in size")
                data = zstandard.ZstdDecompressor().decompress(frame, max_output_size=unpacked)
            except zstandard.ZstdError as error:
                raise InputError(
                    f"{path}: {name}: broken Zstandard frame: {shown(error)}"
                ) from error
            if len(data) != unpacked:
                raise InputError(
                    f"{path}: {name}: {len(data):,} bytes unpacked, expected {unpacked:,}"
                )
        packed[name] = np.frombuffer(data, np.uint8).reshape(header.splats, width)
        progress(len(packed) / (len(header.widths) + 1))
    return header, packed


def _header_4(path: Path, stream: BinaryIO) -> tuple[Header, int]:
    """Header of version 4 and the place of the table of contents, from the file's beginning."""
    stream.seek(0)
    header = _header(path, stream.read(HEADER.size), range(4, 5))
    place = stream.read(TABLE_PLACE.size)
    if len(place) < TABLE_PLACE.size:
        raise InputError(f"{path}: truncated: no whole header")
    (table_place,) = TABLE_PLACE.unpack(place)
    if not stream.tell() <= table_place <= size_of(path):
        raise InputError(f"{path}: table of contents at {table_place:,}: not in the file")
    return header, table_place


def _system(path: Path, stream: BinaryIO) -> str:
    """The coordinate system that the extensions of version 4 name, or SPZ's own."""
    header, table_place = _header_4(path, stream)
    while header.flags & FLAG_EXTENSIONS and stream.tell() + EXTENSION.size <= table_place:
        kind, length = EXTENSION.unpack(stream.read(EXTENSION.size))
        if length > table_place - stream.tell():
            raise InputError(f"{path}: extension {kind:#x} is longer than what holds them")
        if kind == COORDINATE_SYSTEM and length == 4:
            number = int.from_bytes(stream.read(4), "little")
            if number >= len(SYSTEMS):
                raise InputError(f"{path}: coordinate system {number}, expected 0 to 16")
            return SYSTEMS[number]
        stream.seek(length, 1)
    return SYSTEMS[0]


def require(path: Path):  # type: ignore[no-untyped-def]  # a module
    """The package that version 4 needs. Raises InputError naming it where it is missing."""
    try:
        import zstandard
    except ImportError as error:  # rosdep has no key for it
        raise InputError(
            f"{path}: SPZ version 4 needs the Python package zstandard: pip install zstandard"
        ) from error
    return zstandard


# --- Attributes -----------------------------------------------------------------------------------


def _unpack(path: Path, header: Header, packed: Packed, warn: Warn, into: Into[Made]) -> Made:
    n, k = header.splats, sh_coefficients(min(header.degree, MAX_SH_DEGREE))
    for part, (positions, orientations, scales, opacities, sh) in into.blocks(n, k):
        raw = packed["positions"][part]
        if header.version == 1:
            positions[:] = np.ascontiguousarray(raw).view("<f2")
        else:
            positions[:] = _fixed24(raw) / (1 << header.fractional_bits)
        rotations = packed["rotations"][part]
        orientations[:] = (_first_three if header.version < 3 else _smallest_three)(rotations)
        scales[:] = np.exp(packed["scales"][part] / np.float32(16) - 10)
        opacities[:] = packed["alphas"][part, 0] / np.float32(255)
        sh[:, 0] = (packed["colors"][part] / 255 - 0.5) / COLOR_SCALE
        bands = packed["sh"][part, : 3 * (k - 1)].reshape(part.stop - part.start, k - 1, 3)
        sh[:, 1:] = bands / np.float32(128) - 1
    flagged = header.flags & FLAG_ANTIALIASED
    return into.made(path, warn, Model.EWA_ANTIALIASED if flagged else Model.EWA)


def _fixed24(raw: NDArray[np.uint8]) -> NDArray[np.int32]:
    """(n, 9) bytes to (n, 3) little-endian signed integers of 24 bits."""
    padded = np.zeros((len(raw), 3, 4), np.uint8)
    padded[..., 1:] = raw.reshape(-1, 3, 3)
    return padded.view("<i4")[..., 0] >> 8  # the shift carries the sign down


def _fractional_bits(path: Path, splats: Splats) -> int:
    farthest = float(np.abs(splats.positions + splats.origin).max(initial=0))
    for bits in range(FRACTIONAL_BITS, -1, -1):
        if farthest * (1 << bits) < (1 << 23) - 1:
            return bits
    raise InputError(f"{path}: a splat {farthest:,.0f} m from the origin: too far for SPZ")


def _first_three(raw: NDArray[np.uint8]) -> Floats:
    """(n, 3) bytes x, y, z of quaternions with w >= 0, to (n, 4) x, y, z, w."""
    xyz = raw / np.float32(127.5) - 1
    w = np.sqrt(np.maximum(0, 1 - (xyz**2).sum(axis=1)))
    return np.column_stack([xyz, w])


def _smallest_three(raw: NDArray[np.uint8]) -> Floats:
    """(n, 4) bytes to (n, 4) x, y, z, w: 2 bits index the largest, the others are 10 bits each.

    A component is a sign bit and 9 bits of magnitude over sqrt(1/2); the last sits lowest.
    """
    packed = np.ascontiguousarray(raw).view("<u4")
    fields = packed >> np.array([20, 10, 0], np.uint32) & 1023
    magnitudes = (fields & 511) * np.float32(np.sqrt(0.5) / 511)
    return largest_restored(packed[:, 0] >> 30, np.where(fields & 512, -magnitudes, magnitudes))


def _packed_rotations(quaternions: Floats) -> NDArray[np.uint8]:
    """(n, 4) unit quaternions to the bytes of _smallest_three."""
    largest, others = smallest_three(quaternions)
    magnitudes = np.rint(np.abs(others) * np.float32(511 / np.sqrt(0.5))).astype(np.uint32)
    fields = np.minimum(magnitudes, 511) | (others < 0).astype(np.uint32) << 9
    packed = largest.astype("<u4") << 30
    for i, shift in enumerate((20, 10, 0)):
        packed |= fields[:, i] << shift
    return packed.view(np.uint8).reshape(-1, 4)


def _packed_sh(bands: Floats) -> NDArray[np.uint8]:
    """(n, k - 1, 3) coefficients to (n, 3 (k - 1)) bytes, the last bits of each zero or nearly so.

    Steps are wider than a byte's so that they pack better; zero is always one of them.
    """
    steps = np.full((bands.shape[1], 1), 1 << 8 - SH_BITS[1], np.int32)
    steps[:3] = 1 << 8 - SH_BITS[0]
    values = np.rint(np.clip(bands, -2, 2) * 128).astype(np.int32) + 128
    quantised = (values + steps // 2) // steps * steps
    clipped: NDArray[np.uint8] = np.clip(quantised, 0, 255).astype(np.uint8)
    return clipped.reshape(len(bands), -1)
