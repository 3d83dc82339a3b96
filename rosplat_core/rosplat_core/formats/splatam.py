"""params.npz as SplaTAM writes it (Keetha et al. 2024): what it optimises, array by array.

means3D (n, 3), rgb_colors (n, 3) 0 to 1, unnorm_rotations (n, 4) with w first, logit_opacities
(n, 1), log_scales (n, 1) for spheres, or (n, 3). Other arrays, cameras among them, are left alone.
"""

from __future__ import annotations

import zipfile
import zlib
from pathlib import Path

import numpy as np

from rosplat_core.formats.bounds import claim
from rosplat_core.formats.decoded import Axes, Columns, Floats, Into, Made, Progress, Warn
from rosplat_core.formats.quantised import sigmoid
from rosplat_core.harmonics import C0 as SH_C0
from rosplat_core.log_text import shown
from rosplat_core.splats import InputError

NAME = "SplaTAM params.npz"
READS = ".npz"

SHAPES = {
    "means3D": (3,),
    "rgb_colors": (3,),
    "unnorm_rotations": (4,),
    "logit_opacities": (1,),
    "log_scales": (1, 3),
}
"""By array: how many numbers a splat has."""


def recognises(path: Path, head: bytes) -> bool:
    """Whether a file is called as NumPy's archives are, and begins like one."""
    return path.suffix.lower() == ".npz" and head[:4] == b"PK\x03\x04"


def axes(path: Path) -> Axes:
    """Where a file's axes point."""
    return Axes("the first camera's: x right, y down, z forward", (0.0, -1.0, 0.0))


def read(path: Path, progress: Progress, warn: Warn, into: Into[Made]) -> Made:
    """Reads the splats of a params.npz."""
    arrays: dict[str, Floats] = {}
    try:
        with zipfile.ZipFile(path) as archive:
            for name in SHAPES:
                arrays[name] = _array(path, archive, name)
                progress(len(arrays) / (len(SHAPES) + 1))
    except (zipfile.BadZipFile, zlib.error, EOFError) as error:
        raise InputError(f"{path}: damaged: {shown(error)}") from error
    except RuntimeError as error:  # it is encrypted, or packed in a way that zipfile lacks
        raise InputError(f"{path}: can't be unpacked: {shown(error)}") from error
    counts = {name: len(array) for name, array in arrays.items()}
    if len(set(counts.values())) > 1:
        raise InputError(f"{path}: arrays of different lengths: {counts}")
    scales = np.exp(arrays["log_scales"])
    columns = Columns(
        positions=arrays["means3D"].astype(np.float64),
        orientations=np.roll(arrays["unnorm_rotations"], -1, axis=1),  # w first -> last
        scales=np.repeat(scales, 3, axis=1) if scales.shape[1] == 1 else scales,
        opacities=sigmoid(arrays["logit_opacities"][:, 0]),
        sh=((arrays["rgb_colors"] - 0.5) / SH_C0)[:, None],
    )
    return into.make(path, warn, columns)


def _array(path: Path, archive: zipfile.ZipFile, name: str) -> Floats:
    """An array of the archive as float32, after its header was checked against its size."""
    try:
        entry = archive.getinfo(f"{name}.npy")
    except KeyError:
        raise InputError(f"{path}: not SplaTAM's: no array {name}") from None
    with archive.open(entry) as file:
        try:
            if np.lib.format.read_magic(file) != (1, 0):
                raise ValueError("a header larger than 64 KiB")
            shape, _, dtype = np.lib.format.read_array_header_1_0(file)
        except Exception as error:  # NumPy's parser fails in many ways
            raise InputError(f"{path}: {name}: no array of NumPy's: {shown(error)}") from error
        if len(shape) != 2 or shape[1] not in SHAPES[name] or dtype.kind != "f":
            raise InputError(
                f"{path}: {name}: {dtype} {shape}, expected floats (n, {SHAPES[name]})"
            )
        claim(path, shape[0], shape[0] * shape[1] * dtype.itemsize, entry.compress_size)
    with archive.open(entry) as file:
        try:
            return np.lib.format.read_array(file, allow_pickle=False).astype(np.float32)
        except ValueError as error:
            raise InputError(f"{path}: {name}: cut off: {shown(error)}") from error
