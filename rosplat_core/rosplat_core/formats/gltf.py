"""glTF 2.0 with KHR_gaussian_splatting: .glb, or .gltf with its buffers beside or inside it.

A mesh's primitive of points holds splats; its attributes are accessors, tables in a binary buffer:

    POSITION                                      3 floats, or whole numbers of 8 or 16 bits
    KHR_gaussian_splatting:ROTATION               quaternion x y z w: floats, or -1 to 1 in 8 or 16
                                                  bits
    KHR_gaussian_splatting:SCALE                  3 floats, linear, or in 8 or 16 bits
    KHR_gaussian_splatting:OPACITY                0 to 1: a float, or in 8 or 16 bits
    KHR_gaussian_splatting:SH_DEGREE_l_COEF_n     RGB floats of band l, the lowest order first
    COLOR_0                                       what viewers that know no splats draw; not read

Nodes of the scene say where meshes stand. Axes are glTF's: y up, z to the front, x to the left. A
.glb is a header and two chunks, JSON and the buffer. After github.com/KhronosGroup/glTF
(extensions/2.0/Khronos/KHR_gaussian_splatting; specification/2.0).
"""

from __future__ import annotations

import base64
import binascii
import json
import struct
import urllib.parse
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rosplat_core.formats.bounds import claim, refusing, size_of
from rosplat_core.formats.decoded import (
    BLOCK,
    Axes,
    Into,
    Made,
    Progress,
    Warn,
    blocks,
    one_model,
    told_as_trained,
    told_model,
)
from rosplat_core.formats.file_rows import FileRows
from rosplat_core.formats.placed import place
from rosplat_core.formats.quantised import sigmoid, to_bytes
from rosplat_core.harmonics import C0 as SH_C0
from rosplat_core.log_text import shown
from rosplat_core.models import Model
from rosplat_core.quaternions import to_matrices
from rosplat_core.slot_pages import MAX_SLOTS
from rosplat_core.splats import (
    MAX_SH_DEGREE,
    InputError,
    Splats,
    as_trained,
    sh_coefficients,
    splat_bytes,
)

NAME = "glTF"
READS = ".glb, .gltf"
SUFFIXES = (".glb",)
MODELS = tuple(Model)
FINITE = True
KEEPS_ORIGIN = True
DRAWN = "sorted by distance from the camera, cut at 3 sigma"

EXTENSION = "KHR_gaussian_splatting"
READ = {EXTENSION, "KHR_mesh_quantization"}  # extensions that a file may require
COLOUR_SPACE = "srgb_rec709_display"
SRGB = (COLOUR_SPACE, "BT.709-sRGB")  # the latter in drafts
# What the extension hints at, and the values that don't matter here: DRAWN says how its default is.
HINTS = {"projection": ("perspective",), "sortingMethod": ("cameraDistance", "zDepth")}

MAGIC = b"glTF"
HEADER = struct.Struct("<4sII")  # magic, version, length of all
CHUNK = struct.Struct("<I4s")  # length, kind
LARGEST_JSON = 1 << 26  # a .gltf may hold its buffers in its JSON [bytes]
MOST_PRIMITIVES = 10_000  # a mesh may stand in many places
MAX_BYTES = 1 << 53  # the end of JSON's exact whole numbers
LONGEST_NAME = 255  # of a file [bytes]

POINTS, TRIANGLES = 0, 4  # modes of a primitive; the latter where none is given
ARRAY_BUFFER = 34962
BYTE, UNSIGNED_BYTE, SHORT, UNSIGNED_SHORT, FLOAT = 5120, 5121, 5122, 5123, 5126
DTYPES: dict[int, np.dtype[Any]] = {
    BYTE: np.dtype("i1"),
    UNSIGNED_BYTE: np.dtype("u1"),
    SHORT: np.dtype("<i2"),
    UNSIGNED_SHORT: np.dtype("<u2"),
    FLOAT: np.dtype("<f4"),
}
WIDTHS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}


def recognises(path: Path, head: bytes) -> bool:
    """Whether a file begins like .glb, or is called .gltf."""
    return head[:4] == MAGIC or path.suffix.lower() == ".gltf"


def axes(path: Path) -> Axes:
    """Where a file's axes point."""
    return Axes("x left, y up, z to the front (by glTF's rule)", (0.0, 1.0, 0.0))


def read(path: Path, progress: Progress, warn: Warn, into: Into[Made]) -> Made:
    """Reads all splats of a file's scene, where its nodes place them."""
    with refusing(f"{path}: broken glTF"):
        asset = _Asset(path)
        return _splats(asset, list(asset.primitives()), progress, warn, into)


def size(path: Path) -> int:
    """Size of a file and of the buffers beside it that hold its splats. [bytes]"""
    with refusing(f"{path}: broken glTF"):
        asset = _Asset(path)
        for _ in asset.primitives():  # which opens the buffers
            pass
        return asset.size


def write(stream: BinaryIO, path: Path, splats: Splats) -> None:
    """Writes a .glb of floats, coordinates as they are; the origin is its node's translation.

    Raises InputError for more than the 4 GiB that a .glb can have.
    """
    columns = _written(splats)
    asset: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": "ROSplat"},
        "extensionsUsed": [EXTENSION],
        "scene": 0,
        "scenes": [{"nodes": [0]} if len(splats) else {}],
    }
    size = sum(column.size(len(splats)) for column in columns)
    if len(splats):
        asset |= _described(splats, columns, size)
    text = json.dumps(asset, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    length = HEADER.size + CHUNK.size + len(text) + (CHUNK.size + size if size else 0)
    if length >= 1 << 32:
        raise InputError(f"{path}: {len(splats):,} splats take more than the 4 GiB of a .glb")
    stream.write(HEADER.pack(MAGIC, 2, length) + CHUNK.pack(len(text), b"JSON") + text)
    if size:
        stream.write(CHUNK.pack(size, b"BIN\0"))
    for column in columns:
        for part in blocks(len(splats)):
            stream.write(column.values(part).astype(column.dtype).tobytes())


# --- Writing --------------------------------------------------------------------------------------


class _Column(NamedTuple):
    """An attribute as it is written."""

    name: str
    component: int
    kind: str
    values: Callable[[slice], NDArray[Any]]
    """(n, width) numbers of the splats in a slice."""

    @property
    def dtype(self) -> np.dtype[Any]:
        return DTYPES[self.component]

    def size(self, count: int) -> int:
        """Size for so many splats, a multiple of four. [bytes]"""
        return count * WIDTHS[self.kind] * self.dtype.itemsize


def _written(splats: Splats) -> list[_Column]:
    columns = [
        _Column("POSITION", FLOAT, "VEC3", lambda part: splats.positions[part]),
        _Column("COLOR_0", UNSIGNED_BYTE, "VEC4", lambda part: _colours(splats[part])),
        _Column(f"{EXTENSION}:ROTATION", FLOAT, "VEC4", lambda part: splats.orientations[part]),
        _Column(f"{EXTENSION}:SCALE", FLOAT, "VEC3", lambda part: splats.scales[part]),
        _Column(f"{EXTENSION}:OPACITY", FLOAT, "SCALAR", lambda part: splats.opacities[part]),
    ]
    for k, name in enumerate(_coefficients(splats.sh_degree)):
        columns.append(_Column(name, FLOAT, "VEC3", splats.sh[:, k].__getitem__))
    return columns


def _coefficients(degree: int) -> list[str]:
    """Names of the attributes of harmonics up to a degree."""
    bands = [(band, order) for band in range(degree + 1) for order in range(2 * band + 1)]
    return [f"{EXTENSION}:SH_DEGREE_{band}_COEF_{order}" for band, order in bands]


def _colours(splats: Splats) -> NDArray[np.uint8]:
    """(n, 4) for COLOR_0: linear colours of band 0, and opacities."""
    encoded = np.clip(SH_C0 * splats.sh[:, 0] + 0.5, 0, 1)
    linear = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
    return to_bytes(255 * np.column_stack([linear, splats.opacities]))


def _described(splats: Splats, columns: list[_Column], size: int) -> dict[str, Any]:
    """The fields of the JSON that describe splats, at least one."""
    views, accessors, offset = [], [], 0
    for index, column in enumerate(columns):
        length = column.size(len(splats))
        views.append(
            {"buffer": 0, "byteOffset": offset, "byteLength": length, "target": ARRAY_BUFFER}
        )
        accessor = {
            "bufferView": index,
            "componentType": column.component,
            "count": len(splats),
            "type": column.kind,
        }
        if column.component != FLOAT:
            accessor["normalized"] = True
        accessors.append(accessor)
        offset += length
    accessors[0]["min"] = splats.positions.min(axis=0).tolist()
    accessors[0]["max"] = splats.positions.max(axis=0).tolist()
    told: dict[str, Any] = {"kernel": "ellipse", "colorSpace": COLOUR_SPACE}
    if splats.model is not Model.EWA:
        told["extras"] = {"model": str(splats.model)}
    primitive = {
        "attributes": {column.name: index for index, column in enumerate(columns)},
        "mode": POINTS,
        "extensions": {EXTENSION: told},
    }
    node: dict[str, Any] = {"mesh": 0}
    if splats.origin.any():
        node["translation"] = splats.origin.tolist()
    return {
        "nodes": [node],
        "meshes": [{"primitives": [primitive]}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": size}],
    }


# --- Reading --------------------------------------------------------------------------------------


class _Attribute(NamedTuple):
    """(n, width) numbers in a buffer."""

    buffer: NDArray[np.uint8] | FileRows
    begin: int
    """Of the first stride that holds numbers. [bytes]"""
    skip: int
    """Place of a splat's numbers in its stride. [bytes]"""
    stride: int
    shape: tuple[int, int]
    dtype: np.dtype[Any]
    divisor: float

    def numbers(self, part: slice) -> NDArray[np.float32]:
        """Those of the splats in a slice."""
        count, width = part.stop - part.start, self.shape[1]
        begin = self.begin + part.start * self.stride
        # Whole strides: attributes that are interleaved share what is read.
        last = max(self.stride, self.skip + width * self.dtype.itemsize)
        held = self.buffer[begin : begin + (count - 1) * self.stride + last]
        strides = self.stride, self.dtype.itemsize
        stored: NDArray[Any] = np.ndarray((count, width), self.dtype, held, self.skip, strides)
        numbers = stored.astype(np.float32)
        return np.maximum(numbers / np.float32(self.divisor), -1) if self.divisor != 1 else numbers


class _Primitive(NamedTuple):
    """Splats of a mesh, as the file has them, and the mesh's pose."""

    pose: NDArray[np.float64]
    """(4, 4), finite."""
    degree: int
    model: Model
    attributes: dict[str, _Attribute]
    log_scales: bool
    """Whether scales are logarithms; logits: opacities logits."""
    logits: bool

    def __len__(self) -> int:
        return self.attributes["POSITION"].shape[0]


def _splats(
    asset: _Asset,
    primitives: list[_Primitive],
    progress: Progress,
    warn: Warn,
    into: Into[Made],
) -> Made:
    n = sum(map(len, primitives))
    degree = max((primitive.degree for primitive in primitives), default=0)
    claim(asset.path, n, n * splat_bytes(degree), asset.size)
    model = one_model(asset.path, [primitive.model for primitive in primitives])
    for text in dict.fromkeys(asset.warnings):
        warn(f"{asset.path}: {text}")
    counts = [len(primitive) for primitive in primitives]
    for source, part, columns in into.blocks_of(counts, sh_coefficients(degree), progress):
        primitive = primitives[source]
        stored = primitive.attributes
        columns.positions[:] = stored["POSITION"].numbers(part)
        columns.orientations[:] = stored[f"{EXTENSION}:ROTATION"].numbers(part)
        scales = stored[f"{EXTENSION}:SCALE"].numbers(part)
        columns.scales[:] = np.exp(scales) if primitive.log_scales else np.abs(scales)
        opacities = stored[f"{EXTENSION}:OPACITY"].numbers(part)[:, 0]
        columns.opacities[:] = sigmoid(opacities) if primitive.logits else np.clip(opacities, 0, 1)
        columns.sh[:] = 0  # where a primitive has fewer bands
        for k, name in enumerate(_coefficients(primitive.degree)):
            columns.sh[:, k] = stored[name].numbers(part)
        place(columns, primitive.pose)
    return into.made(asset.path, warn, model)


class _Asset:
    """A file's JSON and buffers."""

    def __init__(self, path: Path) -> None:
        """Reads the JSON. Raises InputError for a version or required extension that isn't read."""
        self.path = path
        self.size = size_of(path)
        """Size of the file, and of the buffers beside it that were opened. [bytes]"""
        self.warnings: list[str] = []
        self._buffers: dict[int, NDArray[np.uint8] | FileRows] = {}
        with path.open("rb") as stream:
            binary = stream.read(4) == MAGIC
            stream.seek(0)
            text = self._chunks(stream) if binary else self._text(stream, self.size)
        try:
            self._json = json.loads(text)
        except (ValueError, RecursionError) as error:
            raise InputError(f"{path}: broken JSON: {shown(error)}") from error
        version = self._json["asset"]["version"]
        if version != "2.0":
            raise InputError(f"{path}: glTF {shown(repr(version))} can't be read, only 2.0")
        for name in self._json.get("extensionsRequired", []):
            if name not in READ:
                raise InputError(f"{path}: requires {shown(repr(name))}, which isn't read")

    def primitives(self) -> Iterator[_Primitive]:
        """The splats of the scene. Raises InputError for a file that doesn't use the extension."""
        count, used = 0, EXTENSION in self._json.get("extensionsUsed", [])
        for mesh, pose in self._meshes():
            for primitive in self._item("meshes", mesh)["primitives"]:
                count += 1
                if count > MOST_PRIMITIVES:
                    raise InputError(f"{self.path}: more than {MOST_PRIMITIVES:,} primitives")
                told = primitive.get("extensions", {}).get(EXTENSION)
                if told is not None:
                    used = True  # whatever extensionsUsed says
                    yield self._primitive(primitive, told, pose)
        if not used:
            raise InputError(f"{self.path}: holds no splats: it doesn't use {EXTENSION}")

    # --- Containers

    def _chunks(self, stream: BinaryIO) -> bytes:
        """The JSON of a .glb; the chunk behind it, if any, becomes buffer 0."""
        head = stream.read(HEADER.size)
        if len(head) < HEADER.size:
            raise InputError(f"{self.path}: truncated: no whole header")
        _, version, length = HEADER.unpack(head)
        if version != 2:
            raise InputError(f"{self.path}: version {version} of .glb can't be read, only 2")
        if length > self.size:
            raise InputError(
                f"{self.path}: truncated: {length:,} bytes expected, {self.size:,} found"
            )
        text = self._text(stream, self._chunk(stream, b"JSON", length))
        if stream.tell() + CHUNK.size <= length:
            held = self._chunk(stream, b"BIN\0", length)
            self._buffers[0] = FileRows(self.path, np.uint8, stream.tell(), held)
        return text

    def _chunk(self, stream: BinaryIO, kind: bytes, end: int) -> int:
        """Size of the chunk that begins here. [bytes]"""
        head = stream.read(CHUNK.size)
        if len(head) < CHUNK.size:
            raise InputError(f"{self.path}: truncated: no chunk {kind!r}")
        length, found = CHUNK.unpack(head)
        if found != kind:
            raise InputError(f"{self.path}: chunk {found!r}, expected {kind!r}")
        if length > end - stream.tell():
            raise InputError(f"{self.path}: truncated: a chunk of {length:,} bytes is cut off")
        return int(length)

    def _text(self, stream: BinaryIO, length: int) -> bytes:
        if length > LARGEST_JSON:
            raise InputError(f"{self.path}: {length:,} bytes of JSON, at most {LARGEST_JSON:,}")
        return stream.read(length)

    def _buffer(self, index: int) -> tuple[NDArray[np.uint8] | FileRows, int]:
        """A buffer, and how many of its bytes count."""
        buffer = self._item("buffers", index)
        if index not in self._buffers:
            uri = buffer.get("uri")
            if not isinstance(uri, str):
                raise InputError(f"{self.path}: buffer {index} isn't there")
            self._buffers[index] = self._opened(uri)
        found = self._buffers[index]
        length = self._whole(buffer, "byteLength", 1, MAX_BYTES)
        if length > len(found):
            raise InputError(
                f"{self.path}: truncated: buffer {index} has {len(found):,} bytes, "
                f"{length:,} expected"
            )
        return found, length

    def _opened(self, uri: str) -> NDArray[np.uint8] | FileRows:
        if uri.startswith("data:"):
            try:
                data = base64.b64decode(uri.partition(";base64,")[2], validate=True)
                return np.frombuffer(data, np.uint8)
            except binascii.Error as error:
                raise InputError(f"{self.path}: broken data URI: {shown(error)}") from error
        name = urllib.parse.unquote(uri)
        relative = Path(name)
        outside = relative.is_absolute() or ".." in relative.parts or ":" in uri
        if outside or "\0" in name or not 0 < len(name) < LONGEST_NAME:
            raise InputError(f"{self.path}: buffer {shown(repr(uri))} is no file below the scene")
        beside = self.path.parent / relative
        try:
            size = size_of(beside)
            self.size += size
            return FileRows(beside, np.uint8, 0, size)
        except OSError as error:
            raise InputError(f"{self.path}: {beside}: {error.strerror or error}") from error

    # --- Nodes

    def _meshes(self) -> Iterator[tuple[int, NDArray[np.float64]]]:
        """Meshes of the scene, or without one of all root nodes, and their poses (4, 4)."""
        nodes = self._json.get("nodes", [])
        if "scenes" in self._json:
            roots = self._item("scenes", self._json.get("scene", 0)).get("nodes", [])
        else:
            held = {child for node in nodes for child in node.get("children", [])}
            roots = [index for index in range(len(nodes)) if index not in held]
        seen: set[int] = set()
        stack = [(root, np.eye(4)) for root in reversed(roots)]
        while stack:
            index, above = stack.pop()
            node = self._item("nodes", index)
            if index in seen:
                raise InputError(f"{self.path}: node {index} stands in two places")
            seen.add(index)
            pose = above @ self._local(node)
            if "mesh" in node:
                if not np.isfinite(pose).all():
                    raise InputError(f"{self.path}: node {index}: a number is not finite")
                yield node["mesh"], pose
            stack += [(child, pose) for child in reversed(node.get("children", []))]

    def _local(self, node: Any) -> NDArray[np.float64]:
        """(4, 4) a node's transform into its parent."""
        if "matrix" in node:
            pose = np.array(node["matrix"], np.float64).reshape(4, 4).T
            pose[3] = 0, 0, 0, 1
            return pose
        pose = np.eye(4)
        if "rotation" in node:
            quaternion = np.array(node["rotation"], np.float64)
            if quaternion.shape != (4,) or not quaternion.any():
                raise InputError(f"{self.path}: a node's rotation is no quaternion")
            pose[:3, :3] = to_matrices(quaternion)
        pose[:3, :3] *= np.array(node.get("scale", (1, 1, 1)), np.float64)
        pose[:3, 3] = node.get("translation", (0, 0, 0))
        return pose

    # --- Attributes

    def _primitive(self, primitive: Any, told: Any, pose: NDArray[np.float64]) -> _Primitive:
        mode = primitive.get("mode", TRIANGLES)
        if mode != POINTS:
            raise InputError(f"{self.path}: splats in mode {shown(repr(mode))}, not as points")
        if told.get("kernel", "ellipse") != "ellipse":
            raise InputError(f"{self.path}: kernel {shown(repr(told['kernel']))} isn't read")
        for name, drawn in HINTS.items():
            if (hint := told.get(name, drawn[0])) not in drawn:
                self.warnings.append(f"{name} is {shown(repr(hint))}; drawn as {drawn[0]}")
        colours = told.get("colorSpace", COLOUR_SPACE)
        if colours not in SRGB:
            self.warnings.append(f"colours of {shown(repr(colours))} are taken for sRGB")
        accessors = primitive["attributes"]
        degree = self._degree(accessors)
        kinds = {
            "POSITION": "VEC3",
            f"{EXTENSION}:ROTATION": "VEC4",
            f"{EXTENSION}:SCALE": "VEC3",
            f"{EXTENSION}:OPACITY": "SCALAR",
        } | dict.fromkeys(_coefficients(degree), "VEC3")
        attributes = {}
        for name, kind in kinds.items():
            if name not in accessors:
                raise InputError(f"{self.path}: not a Gaussian splat: no attribute {name}")
            if "bufferView" not in self._item("accessors", accessors[name]):
                packed = next(iter(told.get("extensions", {})), "a sparse accessor, or none")
                raise InputError(
                    f"{self.path}: {name} is packed by {shown(packed)}, which isn't read"
                )
            attributes[name] = self._accessor(name, accessors[name], kind)
        counts = {attribute.shape[0] for attribute in attributes.values()}
        if len(counts) > 1:
            raise InputError(f"{self.path}: attributes of different lengths: {sorted(counts)}")
        model = told_model(self.path, told.get("extras", {}).get("model"))
        some = slice(0, min(BLOCK, *counts))
        scales = attributes[f"{EXTENSION}:SCALE"].numbers(some)
        opacities = attributes[f"{EXTENSION}:OPACITY"].numbers(some)
        # splat-transform wrote such files until June 2026, and JSplat until February.
        log_scales, logits = as_trained(scales, opacities)
        self.warnings += told_as_trained(log_scales, logits)
        return _Primitive(pose, degree, model, attributes, log_scales, logits)

    def _degree(self, accessors: Any) -> int:
        """The highest degree that is there; its band and all below then have to be whole."""
        names = {name for name in accessors if name.startswith(f"{EXTENSION}:SH_")}
        known = _coefficients(MAX_SH_DEGREE)
        if names - set(known):
            self.warnings.append(f"{shown(repr(min(names - set(known))))} left out")
        for degree in range(MAX_SH_DEGREE, 0, -1):
            if set(known[sh_coefficients(degree - 1) : sh_coefficients(degree)]) & names:
                return degree
        return 0

    def _accessor(self, name: str, index: int, kind: str) -> _Attribute:
        accessor = self._item("accessors", index)
        if "sparse" in accessor:
            raise InputError(f"{self.path}: {name}: a sparse accessor isn't read")
        if accessor["type"] != kind:
            raise InputError(
                f"{self.path}: {name} is a {shown(repr(accessor['type']))}, expected {kind}"
            )
        dtype = DTYPES.get(accessor["componentType"])
        if dtype is None:
            raise InputError(
                f"{self.path}: {name} of type {shown(repr(accessor['componentType']))} isn't read"
            )
        view = self._item("bufferViews", accessor["bufferView"])
        width = WIDTHS[kind]
        element = width * dtype.itemsize
        count = self._whole(accessor, "count", 1, MAX_SLOTS)
        stride = self._whole(view, "byteStride", element, 252, element)
        within = self._whole(accessor, "byteOffset", 0, MAX_BYTES, 0)
        begin = self._whole(view, "byteOffset", 0, MAX_BYTES, 0)
        length = self._whole(view, "byteLength", 1, MAX_BYTES)
        buffer, held = self._buffer(view["buffer"])
        if within + stride * (count - 1) + element > min(length, held - begin):
            raise InputError(f"{self.path}: truncated: {name} of {count:,} splats isn't all there")
        normalized = accessor.get("normalized", False) is True and dtype.kind != "f"
        divisor = float(np.iinfo(dtype).max) if normalized else 1.0
        skip = within % stride
        shape = count, width
        return _Attribute(buffer, begin + within - skip, skip, stride, shape, dtype, divisor)

    def _item(self, kind: str, index: Any) -> Any:
        """An item of one of the JSON's lists."""
        items = self._json[kind]
        if type(index) is not int or not 0 <= index < len(items):  # true is an int, too
            raise InputError(f"{self.path}: no {kind}[{shown(repr(index))}]")
        return items[index]

    def _whole(
        self, holder: Any, name: str, least: int, most: int, default: int | None = None
    ) -> int:
        """A whole number, least to most, of an object in the JSON."""
        number = holder[name] if default is None else holder.get(name, default)
        if type(number) is not int or not least <= number <= most:
            raise InputError(
                f"{self.path}: {name} is {shown(repr(number))}, expected {least:,} to {most:,}"
            )
        return number
