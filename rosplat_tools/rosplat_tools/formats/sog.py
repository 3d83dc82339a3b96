"""SOG version 2 (PlayCanvas): WebP pictures described by a meta.json, in a folder or a .sog zip.

After developer.playcanvas.com/user-manual/gaussian-splatting/formats/sog and splat-transform's
read-sog.ts. Each pixel of a picture, row by row, belongs to one splat.
"""

from __future__ import annotations

import io
import json
import zipfile
import zlib
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from rosplat_tools.formats.decoded import Floats, Progress, Warn, decoded
from rosplat_tools.splats import MAX_SH_DEGREE, SceneError, Splats, sh_coefficients

NAME = "SOG"

META = "meta.json"
CENTROIDS_PER_ROW = 64
LARGEST_FILE = 1 << 29  # unpacked: pictures of the most splats that a map has take less [bytes]
LARGEST_TAG = 252  # alpha of a quaternion's pixel: 252 + index of the component left out


def recognises(path: Path, head: bytes) -> bool:
    """Whether a path is a folder with a meta.json, that file itself, or a zip."""
    return (path / META).is_file() or path.name == META or head[:4] == b"PK\x03\x04"


def read(path: Path, progress: Progress, warn: Warn) -> Splats:
    """Reads an unbundled (folder or its meta.json) or a bundled (zip) SOG scene."""
    if path.is_dir() or path.name == META:
        folder = path if path.is_dir() else path.parent
        return _Reader(folder / META, lambda name: (folder / name).read_bytes()).read(
            progress, warn
        )
    try:
        with zipfile.ZipFile(path) as bundle:
            return _Reader(path, partial(_unpack, bundle)).read(progress, warn)
    except (zipfile.BadZipFile, NotImplementedError) as error:
        raise SceneError(f"{path}: broken zip: {error}") from error


def _unpack(bundle: zipfile.ZipFile, name: str) -> bytes:
    size = bundle.getinfo(name).file_size
    if size > LARGEST_FILE:
        raise ValueError(f"{size:,} bytes, expected {LARGEST_FILE:,} at most")
    return bundle.read(name)


class _Reader:
    """Decodes one scene, given how to read its files."""

    def __init__(self, path: Path, read_bytes: Callable[[str], bytes]) -> None:
        self._path = path
        self._read_bytes = read_bytes
        text = self._file(META)
        try:
            self._meta = json.loads(text)
        except (ValueError, RecursionError) as error:  # JSON or its encoding
            raise SceneError(f"{path}: broken {META}: {error}") from error

    def read(self, progress: Progress, warn: Warn) -> Splats:
        version = self._field("version") if isinstance(self._meta, dict) else None
        if version != 2:
            raise SceneError(f"{self._path}: SOG version {version!r} can't be read, only 2")
        n = self._field("count")
        if not isinstance(n, int) or n < 0:
            raise SceneError(f"{self._path}: count is {n!r}, expected a number of splats")

        low = self._picture("means", 0, n)[:, :3].astype(np.uint16)
        high = self._picture("means", 1, n)[:, :3].astype(np.uint16)
        lowest, highest = self._numbers("means", "mins", 3), self._numbers("means", "maxs", 3)
        logarithms = lowest + (highest - lowest) * ((high << 8 | low) / 65535)
        positions = np.sign(logarithms) * np.expm1(np.abs(logarithms))
        progress(0.3)
        orientations = _smallest_three(self._picture("quats", 0, n))
        progress(0.5)
        scale_values = np.exp(self._numbers("scales", "codebook", 256)).astype(np.float32)
        scales = scale_values[self._picture("scales", 0, n)[:, :3]]
        progress(0.7)
        base = self._picture("sh0", 0, n)
        base_colors = self._numbers("sh0", "codebook", 256).astype(np.float32)[base[:, :3]]
        sh = base_colors[:, None]
        if self._meta.get("shN") is not None:
            sh = np.concatenate([sh, self._higher_bands(n)], axis=1)
        progress(0.9)
        return decoded(
            self._path,
            warn,
            positions=positions,
            orientations=orientations,
            scales=scales,
            opacities=base[:, 3] / np.float32(255),
            sh=sh,
            antialiased=self._meta.get("antialias") is True
            or self._meta.get("model") == "antialiased",
        )

    def _higher_bands(self, n: int) -> Floats:
        """(n, k - 1, 3) coefficients: each splat's label names a row of a shared palette."""
        degree = self._field("shN", "bands")
        if not isinstance(degree, int) or not 1 <= degree <= MAX_SH_DEGREE:
            raise SceneError(f"{self._path}: shN.bands is {degree!r}, expected 1, 2 or 3")
        k = sh_coefficients(degree) - 1
        values = self._numbers("shN", "codebook", 256).astype(np.float32)
        centroids = self._picture("shN", 0, width=CENTROIDS_PER_ROW * k)[:, :3].reshape(-1, k, 3)
        labels = self._picture("shN", 1, n)[:, :2].astype(np.uint16)
        label = labels[:, 1] << 8 | labels[:, 0]
        if n and label.max() >= len(centroids):
            raise SceneError(
                f"{self._path}: shN.files: label {label.max()}, but {len(centroids)} centroids"
            )
        coefficients: Floats = values[centroids[label]]
        return coefficients

    def _picture(
        self, field: str, index: int, pixels: int = 0, width: int | None = None
    ) -> NDArray[np.uint8]:
        """(pixels, 4) RGBA of one of a field's files; all of it where a width is demanded."""
        files = self._field(field, "files")
        if not isinstance(files, list) or len(files) <= index or not isinstance(files[index], str):
            raise SceneError(f"{self._path}: {field}.files has no file name at {index}")
        name = files[index]
        data = io.BytesIO(self._file(name))
        try:
            with Image.open(data) as image:
                if width is not None and image.width != width:
                    raise SceneError(f"{self._path}: {name} is {image.width} px wide, not {width}")
                if image.width * image.height < pixels:
                    raise SceneError(
                        f"{self._path}: {name} holds {image.width * image.height:,} pixels, "
                        f"fewer than {pixels:,} splats"
                    )
                rgba = np.asarray(image.convert("RGBA")).reshape(-1, 4)
        except (OSError, SyntaxError, Image.DecompressionBombError) as error:
            raise SceneError(f"{self._path}: {name} is no picture: {error}") from error
        return rgba if width is not None else rgba[:pixels]

    def _file(self, name: str) -> bytes:
        if Path(name).name != name:
            raise SceneError(f"{self._path}: {name!r} is not the name of a file beside {META}")
        try:
            return self._read_bytes(name)
        except (OSError, KeyError, EOFError, ValueError, RuntimeError, zlib.error) as error:
            raise SceneError(f"{self._path}: can't read {name!r}: {error}") from error

    def _field(self, *names: str) -> Any:
        value: Any = self._meta
        for name in names:
            if not isinstance(value, dict) or name not in value:
                raise SceneError(f"{self._path}: no field {'.'.join(names)}")
            value = value[name]
        return value

    def _numbers(self, field: str, name: str, count: int) -> NDArray[np.float64]:
        try:
            values = np.asarray(self._field(field, name), np.float64)
        except (TypeError, ValueError, OverflowError):
            values = np.empty(0)
        if values.shape != (count,) or not np.isfinite(values).all():
            raise SceneError(f"{self._path}: {field}.{name}: expected {count} finite numbers")
        return values


def _smallest_three(rgba: NDArray[np.uint8]) -> Floats:
    """(n, 4) pixels to (n, 4) quaternions x, y, z, w.

    RGB are the components that remain of w, x, y, z, over sqrt(1/2), when the largest is left out.
    Other tags are reserved: those splats get a zero quaternion and are dropped.
    """
    wxyz = np.zeros((len(rgba), 4), np.float32)
    stored = (rgba[:, :3] / np.float32(127.5) - 1) * np.float32(np.sqrt(0.5))
    largest = np.sqrt(np.maximum(0, 1 - (stored**2).sum(axis=1)))
    for component in range(4):
        chosen = rgba[:, 3] == LARGEST_TAG + component
        others = [i for i in range(4) if i != component]
        wxyz[np.ix_(chosen, others)] = stored[chosen]
        wxyz[chosen, component] = largest[chosen]
    return np.roll(wxyz, -1, axis=1)
