"""SOG (PlayCanvas), versions 1 and 2: pictures and a meta.json, in a folder or in a .sog zip.

Each pixel of a picture, row by row, belongs to one splat; in meta.json each field names its files:

    means   two pictures: low and high bytes of x y z between mins and maxs, of
            sign(x) log(1 + |x|)
    quats   three components of w x y z, from -sqrt(1/2) to sqrt(1/2); alpha is 252 and the index of
            the largest one, which is left out
    scales  logarithms: version 2 by a codebook, version 1 between mins and maxs
    sh0     band 0, and opacity in alpha; version 2 by a codebook and as it is, version 1 between
            four mins and maxs and as a logit
    shN     bands above 0, where there are any: a palette of up to 65,536 vectors, 64 a row, whose
            numbers are coded as those of scales, and the palette's index for each splat

After developer.playcanvas.com/user-manual/gaussian-splatting/formats/sog and splat-transform's
read-sog.ts and read-sog-v1.ts. The specification has y up, but programs that write SOG keep the
axes of their input.
"""

from __future__ import annotations

import io
import json
import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from rosplat_core.formats.bounds import claim, size_of, unpackable
from rosplat_core.formats.codebook import codebook, nearest, palette
from rosplat_core.formats.decoded import Columns, Floats, Into, Made, Progress, Warn, blocks
from rosplat_core.formats.quantised import largest_restored, sigmoid, smallest_three, to_bytes
from rosplat_core.log_text import shown
from rosplat_core.models import Model
from rosplat_core.splats import MAX_SH_DEGREE, InputError, Splats, sh_coefficients

NAME = "SOG"
READS = ".sog, a SOG folder"
SUFFIXES = (".sog",)
MODELS = tuple(Model)
IN_SPACE_ORDER = True
KEEPS_ORIGIN = True  # as ranges in doubles

# splat-transform's; those of other models are ours.
WORDS = {Model.EWA_ANTIALIASED: "antialiased", Model.DISC: "2dgs"}

META = "meta.json"
LARGEST_META = 1 << 20  # of meta.json, which usually takes 15,000 [bytes]
LONGEST_NAME = 255  # of a file, as most file systems have it
LARGEST_TAG = 252  # alpha of a quaternion's pixel: 252 + index of the component left out
PALETTE_PER_ROW = 64
LARGEST_PALETTE = 1 << 16
SQRT2 = np.float32(np.sqrt(2))


def recognises(path: Path, head: bytes) -> bool:
    """Whether a path is a folder with a meta.json, that file itself, or a zip with one."""
    if head[:4] == b"PK\x03\x04":
        return path.suffix.lower() == SUFFIXES[0] or META in _names(path)
    return (path / META).is_file() or path.name == META


def read(path: Path, progress: Progress, warn: Warn, into: Into[Made]) -> Made:
    """Reads an unbundled (folder or its meta.json) or a bundled (zip) SOG scene."""
    if path.is_dir() or path.name == META:
        folder = path if path.is_dir() else path.parent
        return _Reader(folder / META, folder).read(progress, warn, into)
    try:
        with zipfile.ZipFile(path) as bundle:
            return _Reader(path, bundle).read(progress, warn, into)
    except (zipfile.BadZipFile, NotImplementedError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path}: broken or truncated zip: {shown(error)}") from error


def _names(path: Path) -> list[str]:
    """Of the files in a zip; none of one that is damaged."""
    try:
        with zipfile.ZipFile(path) as bundle:
            return bundle.namelist()
    except (zipfile.BadZipFile, NotImplementedError, ValueError):
        return []


class Claims(NamedTuple):
    """What a meta.json says of the scene beside it."""

    splats: int
    sh_degree: int
    model: Model


def claims(path: Path) -> Claims:
    """What a scene's meta.json says of it; its pictures are not decoded. Raises InputError."""
    return _Reader(path, path.parent).claims()


def unpack(path: Path, progress: Progress) -> Packed:
    """Decodes the pictures beside a meta.json. Raises InputError, and MemoryError."""
    return _Reader(path, path.parent).unpack(progress)


@dataclass(frozen=True, eq=False)
class Packed:
    """A scene of n splats as its pictures have it: a third of the memory that splats take."""

    path: Path
    model: Model
    lowest: Floats
    """(3,) logarithms of the lowest coordinates; highest: of the highest."""
    highest: Floats
    steps: NDArray[np.uint16]
    """(n, 3) positions, from lowest to highest."""
    quaternions: NDArray[np.uint8]
    """(n, 4) the smallest three components, and LARGEST_TAG plus the index of the largest."""
    scales: NDArray[np.uint8]
    """(n, 3) rows of scale_table, (256, 3) [m]."""
    scale_table: NDArray[np.float32]
    colours: NDArray[np.uint8]
    """(n, 4) rows of colour_table, (256, 3), and of opacity_table, (256,)."""
    colour_table: NDArray[np.float32]
    opacity_table: Floats
    labels: NDArray[np.uint16] | None
    """(n,) rows of bands, (m, k - 1, 3); both None without bands above 0."""
    bands: Floats | None

    def __len__(self) -> int:
        return len(self.steps)

    @property
    def nbytes(self) -> int:
        """Memory that the arrays take. [bytes]"""
        arrays = (self.steps, self.quaternions, self.scales, self.colours, self.labels, self.bands)
        return sum(array.nbytes for array in arrays if array is not None)

    def splats(self, which: slice, warn: Warn, into: Into[Made]) -> Made:
        """Some of the splats; those that can't be drawn are left out, and warn is told."""
        first, last, _ = which.indices(len(self))
        n = last - first
        k = 1 if self.bands is None else 1 + self.bands.shape[1]
        for part, columns in into.blocks(n, k):
            self.decode(slice(first + part.start, first + part.stop), columns)
        return into.made(self.path, warn, self.model)

    def decode(self, rows: slice, columns: Columns) -> None:
        """Writes some of the splats to columns; bands that they lack are zero."""
        logarithms = self.lowest + (self.highest - self.lowest) * (self.steps[rows] / 65535)
        columns.positions[:] = np.sign(logarithms) * np.expm1(np.abs(logarithms))
        columns.orientations[:] = _quaternions(self.quaternions[rows])
        columns.scales[:] = self.scale_table[self.scales[rows], np.arange(3)]
        colours = self.colours[rows]
        columns.opacities[:] = self.opacity_table[colours[:, 3]]
        columns.sh[:] = 0
        columns.sh[:, 0] = self.colour_table[colours[:, :3], np.arange(3)]
        if self.bands is not None and self.labels is not None:
            columns.sh[:, 1 : 1 + self.bands.shape[1]] = self.bands[self.labels[rows]]


def write(stream: BinaryIO, path: Path, splats: Splats) -> None:
    """Writes a bundled SOG scene of version 2; splats should be in space order."""
    n = len(splats)
    width = max(4, -(-int(np.ceil(np.sqrt(n))) // 4) * 4)
    shape = (-(-max(n, 1) // width), width)
    world = splats.positions + splats.origin
    logarithms = np.sign(world) * np.log1p(np.abs(world))
    lowest = logarithms.min(axis=0) if n else np.zeros(3)
    highest = logarithms.max(axis=0) if n else np.zeros(3)
    span = np.where(highest > lowest, highest - lowest, 1)
    steps = np.rint((logarithms - lowest) / span * 65535).astype(np.uint16)
    largest, others = smallest_three(np.roll(splats.orientations, 1, axis=1))
    log_scales = np.log(np.maximum(splats.scales, np.finfo(np.float32).tiny))
    scale_book, color_book = codebook(log_scales), codebook(splats.sh[:, 0])
    meta: dict[str, Any] = {
        "version": 2,
        "asset": {"generator": "ROSplat"},
        "count": n,
        "means": {
            "mins": lowest.tolist(),
            "maxs": highest.tolist(),
            "files": ["means_l.webp", "means_u.webp"],
        },
        "scales": {"codebook": scale_book.tolist(), "files": ["scales.webp"]},
        "quats": {"files": ["quats.webp"]},
        "sh0": {"codebook": color_book.tolist(), "files": ["sh0.webp"]},
    }
    if splats.model is Model.EWA_ANTIALIASED:
        meta["antialias"] = True  # the specification's
    if splats.model is not Model.EWA:
        meta["model"] = WORDS.get(splats.model, str(splats.model))
    with zipfile.ZipFile(stream, "w") as bundle:

        def add(name: str, columns: list[NDArray[Any]], shape: tuple[int, int] = shape) -> None:
            pixels = np.zeros((shape[0] * shape[1], 4), np.uint8)
            pixels[:, 3] = 255
            for channel, column in enumerate(columns):
                pixels[: len(column), channel] = column
            data = io.BytesIO()
            image = Image.fromarray(pixels.reshape(*shape, 4))
            image.save(data, "WEBP", lossless=True, exact=True, quality=50, method=2)
            bundle.writestr(name, data.getbuffer())

        add("means_l.webp", list((steps & 255).T))
        add("means_u.webp", list((steps >> 8).T))
        add("quats.webp", [*to_bytes(255 * (others / SQRT2 + 0.5)).T, LARGEST_TAG + largest])
        add("scales.webp", list(nearest(log_scales, scale_book).T))
        colors = nearest(splats.sh[:, 0], color_book)
        add("sh0.webp", [*colors.T, to_bytes(255 * splats.opacities)])
        if n and splats.sh_degree > 0:
            k = splats.sh.shape[1] - 1
            size = min(LARGEST_PALETTE, 1 << n.bit_length() - 1)
            vectors, labels = palette(splats.sh[:, 1:].reshape(n, -1), size)
            book = codebook(vectors)
            add(
                "shN_centroids.webp",
                list(nearest(vectors, book).reshape(-1, 3).T),
                (-(-len(vectors) // PALETTE_PER_ROW), PALETTE_PER_ROW * k),
            )
            add("shN_labels.webp", [labels & 255, labels >> 8])
            meta["shN"] = {
                "count": len(vectors),
                "bands": splats.sh_degree,
                "codebook": book.tolist(),
                "files": ["shN_centroids.webp", "shN_labels.webp"],
            }
        bundle.writestr(META, json.dumps(meta))


class _Reader:
    """Decodes one scene, given the folder or the zip of its files."""

    def __init__(self, path: Path, files: Path | zipfile.ZipFile) -> None:
        self._path = path
        self._files = files
        if self._size(META) > LARGEST_META:
            raise InputError(f"{path}: {META} has more than {LARGEST_META:,} bytes")
        try:
            self._meta = json.loads(self._file(META))
        except (ValueError, RecursionError) as error:  # JSON or its encoding
            if isinstance(error, InputError):
                raise
            raise InputError(f"{path}: broken {META}: {shown(error)}") from error
        if not isinstance(self._meta, dict):
            raise InputError(f"{path}: {META} holds no fields")
        self._version = self._meta.get("version", 1)  # version 1 has no such field
        if self._version not in (1, 2):
            raise InputError(
                f"{path}: SOG version {shown(repr(self._version))} can't be read, only 1 and 2"
            )

    def read(self, progress: Progress, warn: Warn, into: Into[Made]) -> Made:
        packed = self.unpack(progress)
        return packed.splats(slice(0, len(packed)), warn, into)

    def unpack(self, progress: Progress) -> Packed:
        n = self.claims().splats
        names = [
            self._name(field, i)
            for field, count in (("means", 2), ("quats", 1), ("scales", 1), ("sh0", 1))
            for i in range(count)
        ]
        pictures = 4 * len(names) * n  # once unpacked [bytes]
        claim(self._path, n, pictures, sum(self._size(name) for name in names))

        lowest, highest = self._numbers("means", "mins", 3), self._numbers("means", "maxs", 3)
        low, high = self._pixels("means", 0, n), self._pixels("means", 1, n)
        steps = np.empty((n, 3), np.uint16)
        for part in blocks(n):
            steps[part] = high[part, :3].astype(np.uint16) << 8 | low[part, :3]
        del low, high
        progress(0.3)
        quaternions = self._pixels("quats", 0, n)
        progress(0.5)
        scales = self._pixels("scales", 0, n)[:, :3].copy()
        progress(0.7)
        colours = self._pixels("sh0", 0, n)
        table = self._table("sh0", 4 if self._version == 1 else 3)
        opacity = sigmoid(table[:, 3]) if self._version == 1 else np.arange(256) / np.float32(255)
        bands = self._palette() if self._has_bands() else None
        with np.errstate(over="ignore"):  # splats of an infinite scale are dropped
            scale_table = np.exp(self._table("scales", 3))
        return Packed(
            path=self._path,
            model=self._model(),
            lowest=lowest,
            highest=highest,
            steps=steps,
            quaternions=quaternions,
            scales=scales,
            scale_table=scale_table,
            colours=colours,
            colour_table=table[:, :3],
            opacity_table=opacity,
            labels=None if bands is None else self._labels(n, len(bands)),
            bands=bands,
        )

    def claims(self) -> Claims:
        """What its meta.json says; of version 1, a picture's size tells the degree."""
        if self._version == 1:
            shape = self._field("means", "shape")
            n, name = shape[0] if isinstance(shape, list) and shape else shape, "means.shape[0]"
        else:
            n, name = self._field("count"), "count"
        if type(n) is not int or n < 0:  # true is an int, too
            raise InputError(
                f"{self._path}: {name} is {shown(repr(n))}, expected a number of splats"
            )
        return Claims(n, self._sh_degree() if self._has_bands() else 0, self._model())

    def _model(self) -> Model:
        name = self._meta.get("model")
        if self._meta.get("antialias") is True:
            return Model.EWA_ANTIALIASED
        return next((m for m in Model if name in (str(m), WORDS.get(m, m))), Model.EWA)

    def _has_bands(self) -> bool:
        return self._meta.get("shN") is not None

    def _sh_degree(self) -> int:
        """The SH degree of a scene with bands above 0."""
        if self._version == 2:
            degree = self._field("shN", "bands")
            if type(degree) is not int or not 1 <= degree <= MAX_SH_DEGREE:
                raise InputError(f"{self._path}: shN.bands is {shown(repr(degree))}, not 1, 2 or 3")
            return degree
        width = self._picture("shN", 0).width
        for degree in range(1, MAX_SH_DEGREE + 1):
            if width == _palette_width(degree):
                return degree
        wanted = ", ".join(str(_palette_width(d)) for d in range(1, MAX_SH_DEGREE + 1))
        raise InputError(f"{self._path}: {self._name('shN', 0)} is {width} px wide, not {wanted}")

    def _table(self, field: str, channels: int) -> NDArray[np.float32]:
        """(256, channels) the value of each byte in a field's channels."""
        if self._version == 2:
            book = self._numbers(field, "codebook", 256)
            return np.repeat(book[:, None], channels, axis=1).astype(np.float32)
        count = 1 if field == "shN" else channels
        lowest, highest = self._numbers(field, "mins", count), self._numbers(field, "maxs", count)
        table = lowest + (highest - lowest) * (np.arange(256)[:, None] / 255)
        return np.broadcast_to(table, (256, channels)).astype(np.float32)

    def _palette(self) -> Floats:
        """(colors, k - 1, 3) vectors of coefficients, which splats share."""
        image = self._picture("shN", 0)
        degree = self._sh_degree()
        if image.width != (width := _palette_width(degree)):
            name = self._name("shN", 0)
            raise InputError(f"{self._path}: {name} is {image.width} px wide, not {width}")
        if image.height > LARGEST_PALETTE // PALETTE_PER_ROW:
            raise InputError(f"{self._path}: {self._name('shN', 0)} is {image.height:,} px high")
        codes = self._decode(image, "shN", 0)[:, :3]
        return self._table("shN", 3)[codes, np.arange(3)].reshape(
            -1, sh_coefficients(degree) - 1, 3
        )

    def _labels(self, count: int, colours: int) -> NDArray[np.uint16]:
        """(count,) which of a palette's colours each splat has."""
        pixels = self._pixels("shN", 1, count)
        labels = pixels[:, :2].copy().view("<u2")[:, 0]
        if labels.max(initial=0) >= colours:
            raise InputError(
                f"{self._path}: shN.files: label {labels.max()}, but {colours} centroids"
            )
        return labels

    def _pixels(self, field: str, index: int, count: int) -> NDArray[np.uint8]:
        """(count, 4) RGBA of one of a field's pictures."""
        image = self._picture(field, index)
        pixels = image.width * image.height
        name = self._name(field, index)
        if pixels < count:
            raise InputError(
                f"{self._path}: {name} holds {pixels:,} pixels, fewer than {count:,} splats"
            )
        if pixels > max(4 * count, 1 << 16):  # a texture of a power of two, at most
            raise InputError(f"{self._path}: {name} holds {pixels:,} pixels for {count:,} splats")
        return self._decode(image, field, index)[:count]

    def _picture(self, field: str, index: int) -> Image.Image:
        """A picture whose size is known, but not decoded yet."""
        name = self._name(field, index)
        data = io.BytesIO(self._file(name))
        try:
            return Image.open(data, formats=("WEBP", "PNG"))
        except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
            reason = "no WebP or PNG" if isinstance(error, UnidentifiedImageError) else error
            raise InputError(f"{self._path}: {name} is no picture: {shown(reason)}") from error

    def _decode(self, image: Image.Image, field: str, index: int) -> NDArray[np.uint8]:
        try:
            return np.asarray(image.convert("RGBA")).reshape(-1, 4)
        except (OSError, SyntaxError, ValueError, EOFError, zlib.error) as error:
            name = self._name(field, index)
            raise InputError(
                f"{self._path}: {name} is a damaged picture: {shown(error)}"
            ) from error

    def _name(self, field: str, index: int) -> str:
        files = self._field(field, "files")
        if not isinstance(files, list) or len(files) <= index or not isinstance(files[index], str):
            raise InputError(f"{self._path}: {field}.files has no file name at {index}")
        name: str = files[index]
        if Path(name).name != name or "\0" in name or len(name) > LONGEST_NAME:
            raise InputError(
                f"{self._path}: {shown(repr(name))} is not the name of a file beside {META}"
            )
        return name

    def _size(self, name: str) -> int:
        """Of a file, once it is unpacked. [bytes]"""
        try:
            if isinstance(self._files, Path):
                return size_of(self._files / name)
            info = self._files.getinfo(name)
        except (OSError, KeyError, ValueError) as error:
            raise self._unreadable(name, error) from error
        if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise self._unreadable(
                name, f"compression method {info.compress_type}; only deflate can be read"
            )
        if info.file_size > unpackable(info.compress_size):
            raise self._unreadable(
                name, f"{info.file_size:,} bytes, in {info.compress_size:,} packed ones"
            )
        return info.file_size

    def _file(self, name: str) -> bytes:
        self._size(name)  # raises for too large a file, or none
        try:
            if isinstance(self._files, Path):
                return (self._files / name).read_bytes()
            return self._files.read(name)
        except (
            OSError, KeyError, EOFError, ValueError, RuntimeError, NotImplementedError,
            zipfile.BadZipFile, zlib.error,
        ) as error:  # fmt: skip
            raise self._unreadable(name, error) from error

    def _unreadable(self, name: str, why: object) -> InputError:
        """An OSError's own text would name the file once more."""
        reason = shown(getattr(why, "strerror", None) or why)
        return InputError(f"{self._path}: can't read {name!r}: {reason}")

    def _field(self, *names: str) -> Any:
        value: Any = self._meta
        for name in names:
            if not isinstance(value, dict) or name not in value:
                raise InputError(f"{self._path}: no field {'.'.join(names)}")
            value = value[name]
        return value

    def _numbers(self, field: str, name: str, count: int) -> NDArray[np.float64]:
        try:
            values = np.atleast_1d(np.asarray(self._field(field, name), np.float64))
        except (TypeError, ValueError, OverflowError) as error:
            if isinstance(error, InputError):
                raise
            values = np.empty(0)
        if name == "codebook" and values.shape == (count,) and np.isnan(values[0]):
            # Some writers leave null there; PlayCanvas's engine mends it so.
            values[0] = values[1] + (values[1] - values[-1]) / (count - 1)
        if values.shape != (count,) or not np.isfinite(values).all():
            raise InputError(f"{self._path}: {field}.{name}: expected {count} finite numbers")
        return values


def _palette_width(degree: int) -> int:
    """Width of a palette's picture. [px]"""
    return PALETTE_PER_ROW * (sh_coefficients(degree) - 1)


def _quaternions(rgba: NDArray[np.uint8]) -> NDArray[np.float32]:
    """(n, 4) pixels to (n, 4) x, y, z, w; zero, and so dropped, where the tag is a reserved one."""
    others = (rgba[:, :3] / np.float32(127.5) - 1) / SQRT2
    largest = rgba[:, 3].astype(np.intp) - LARGEST_TAG
    wxyz = largest_restored(largest & 3, others)
    wxyz[largest < 0] = 0
    return np.roll(wxyz, -1, axis=1)
