"""OpenUSD with ParticleField3DGaussianSplat (from 26.03 on): .usda is text, .usdc and .usd binary.

A .usdz is a zip of one of them. A prim of that type has arrays, a row for each of n particles:

    positions     point3f
    orientations  quatf, unit; those of GfQuat lie in memory as x y z w
    scales        float3, linear
    opacities     float, 0 to 1
    radiance:sphericalHarmonicsCoefficients    float3, (degree + 1)^2 a particle, by band and order
    radiance:sphericalHarmonicsDegree          int

All may be halves instead, under the same name and an h. Prims stand where their transforms and
those of their parents place them; upAxis and metersPerUnit say what the scene's coordinates mean.
After OpenUSD's usdVol/schema.usda and extras/imaging/examples/hdParticleField/py3dgsPlyToUsd.py.

Needs the Python package usd-core. A process of its own reads a file, as usd-core trusts any file.
"""

from __future__ import annotations

import functools
import importlib.util
import json
import os
import select
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any, BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rosplat_core.formats import usd_child
from rosplat_core.formats.bounds import claim, size_of, unpackable
from rosplat_core.formats.decoded import (
    BLOCK,
    Axes,
    Columns,
    Into,
    Made,
    Progress,
    Warn,
    blocks,
    one_model,
    told_as_trained,
    told_model,
)
from rosplat_core.formats.placed import place
from rosplat_core.formats.quantised import sigmoid
from rosplat_core.log_text import shown
from rosplat_core.models import Model
from rosplat_core.splats import (
    MAX_SH_DEGREE,
    InputError,
    Splats,
    as_trained,
    sh_coefficients,
    splat_bytes,
)

NAME = "OpenUSD"
READS = ".usd, .usda, .usdc, .usdz"
SUFFIXES = (".usdc", ".usda", ".usdz", ".usd")
MODELS = tuple(Model)
FINITE = True
KEEPS_ORIGIN = True

BEGINNINGS = (b"#usda", b"PXR-USDC")
ZIP = b"PK\x03\x04"
UPS = {"Y": (0.0, 1.0, 0.0), "Z": (0.0, 0.0, 1.0)}
UP = "Z"  # written where the vertical isn't known: REP-103
NEEDED = 1 << 27  # memory that usd-core takes for any file [bytes]
LONGEST_HEADER = 1 << 24  # of the child's line of JSON [bytes]
HIGHEST_DEGREE = 10  # of harmonics; the schema has no bound


def recognises(path: Path, head: bytes) -> bool:
    """Whether a file begins like OpenUSD's, or is a zip with its ending."""
    return head.startswith(BEGINNINGS) or (head[:4] == ZIP and path.suffix.lower() == ".usdz")


def axes(path: Path) -> Axes:
    """Where a file's axes point, by its upAxis."""
    found = path.stat()
    up = _up(path, found.st_mtime_ns, found.st_size)
    return Axes(f"{up.lower()} up (by the file's upAxis)", UPS[up])


def read(path: Path, progress: Progress, warn: Warn, into: Into[Made]) -> Made:
    """Reads all splats of a file, in metres, where their transforms place them.

    Layers of one .usdz may refer to one another. Raises InputError for a file that is composed of
    others.
    """
    size = size_of(path)
    with _child(path, size, progress) as (told, stream):
        fields = [_Field.of(path, field, told["meters"]) for field in told["fields"]]
        if not fields and told["nurec"]:
            raise InputError(
                f"{path}: a NuRec volume, which only Omniverse draws: 3DGRUT's export writes "
                f"{usd_child.SPLATS} by --format standard"
            )
        if not fields:
            raise InputError(f"{path}: holds no {usd_child.SPLATS}")
        for text in dict.fromkeys(text for field in fields for text in field.differs()):
            warn(f"{path}: {text}")
        if not told["measured"]:
            warn(f"{path}: has no metersPerUnit, so its units are centimetres by OpenUSD's rule")
        n = sum(field.splats for field in fields)
        degree = max(field.degree for field in fields)
        claim(path, n, n * splat_bytes(degree), size)
        model = one_model(path, [field.model for field in fields])
        columns = Columns.empty(n, sh_coefficients(degree))
        columns.sh[:] = 0
        first = 0
        for field in fields:
            own = columns.part(slice(first, first + field.splats))
            first += field.splats
            for text in _fill(path, own, field, stream):
                warn(f"{path}: {text}")
            place(own, field.pose)
            progress(0.9 * first / max(1, n))
    return into.make(path, warn, columns, model)


def write(stream: BinaryIO, path: Path, splats: Splats) -> None:
    """Writes one prim of floats in metres, coordinates as they are; the vertical is the upAxis.

    A vertical that is no axis, or isn't known, becomes z. The origin is the prim's translation.
    """
    Sdf, Tf, Usd, UsdGeom, _ = require(path)
    suffix = path.suffix.lower()
    # USD chooses the format by a file's ending. The folder is beside the file, whose disk has room.
    with tempfile.TemporaryDirectory(prefix=".usd.", dir=path.parent) as folder:
        scene = Path(folder) / ("scene.usdc" if suffix == ".usdz" else f"scene{suffix}")
        try:
            stage = Usd.Stage.CreateNew(str(scene))
            up = next((axis for axis, way in UPS.items() if way == splats.up), UP)
            UsdGeom.SetStageUpAxis(stage, up)
            UsdGeom.SetStageMetersPerUnit(stage, 1.0)
            stage.SetDefaultPrim(_authored(path, stage, splats))
            stage.Save()
            if suffix == ".usdz":
                package = Sdf.ZipFileWriter.CreateNew(f"{scene}.usdz")
                package.AddFile(str(scene), scene.name)
                package.Save()
                scene = Path(f"{scene}.usdz")
        except Tf.ErrorException as error:
            raise InputError(f"{path}: usd-core can't write it: {shown(error)}") from error
        with scene.open("rb") as written:
            shutil.copyfileobj(written, stream)


def _authored(path: Path, stage: Any, splats: Splats) -> Any:
    """Adds a prim of splats to a stage, as OpenUSD's own converter of PLY does."""
    Sdf, _, _, UsdGeom, Vt = require(path)
    types, uniform = Sdf.ValueTypeNames, Sdf.VariabilityUniform
    prim = stage.DefinePrim("/Splats", usd_child.SPLATS)
    if splats.origin.any():
        UsdGeom.Xformable(prim).AddTranslateOp().Set(tuple(splats.origin.tolist()))
    if splats.model is not Model.EWA:
        prim.SetCustomDataByKey(usd_child.MODEL, str(splats.model))
    positions, orientations, scales, opacities, harmonics = usd_child.ARRAYS
    for name, kind, array, values in (
        (positions, types.Point3fArray, Vt.Vec3fArray, splats.positions),
        (orientations, types.QuatfArray, Vt.QuatfArray, splats.orientations),
        (scales, types.Float3Array, Vt.Vec3fArray, splats.scales),
        (opacities, types.FloatArray, Vt.FloatArray, splats.opacities),
        (harmonics, types.Float3Array, Vt.Vec3fArray, splats.sh.reshape(-1, 3)),
        ("extent", types.Float3Array, Vt.Vec3fArray, _extent(splats)),
    ):
        attribute = prim.CreateAttribute(name, kind, custom=False)
        attribute.Set(array.FromNumpy(values) if len(values) else array())
    primvar = UsdGeom.Primvar(prim.GetAttribute(harmonics))
    primvar.SetElementSize(splats.sh.shape[1])
    primvar.SetInterpolation(UsdGeom.Tokens.vertex)
    prim.CreateAttribute(usd_child.DEGREE, types.Int, False, uniform).Set(splats.sh_degree)
    for name, value in usd_child.HINTS.items():
        prim.CreateAttribute(name, types.Token, False, uniform).Set(value)
    return prim


def require(path: Path) -> tuple[Any, ...]:
    """Modules of usd-core for writing. Raises InputError naming it where it is missing."""
    try:
        from pxr import Sdf, Tf, Usd, UsdGeom, Vt
    except ImportError as error:  # rosdep has no key for it
        raise _lacking(path) from error
    return Sdf, Tf, Usd, UsdGeom, Vt


def _lacking(path: Path) -> InputError:
    return InputError(f"{path}: OpenUSD needs the Python package usd-core: pip install usd-core")


def _extent(splats: Splats) -> NDArray[np.float32]:
    """(2, 3) the least and the largest that splats reach along the axes, at 3 sigma. [m]"""
    if not len(splats):
        return np.zeros((2, 3), np.float32)
    reach = 3 * splats.scales.max(axis=1, keepdims=True)
    low, high = splats.positions - reach, splats.positions + reach
    return np.array([low.min(axis=0), high.max(axis=0)], np.float32)


# --- Reading --------------------------------------------------------------------------------------


@functools.lru_cache(maxsize=16)
def _up(path: Path, modified: int, size: int) -> str:
    """A file's upAxis; modified and size are keys of the cache, so that a change is seen."""
    with _child(path, size, lambda fraction: None, metadata_only=True) as (told, _):
        return str(told["up"]) if told["up"] in UPS else "Y"


@contextmanager
def _child(
    path: Path, size: int, progress: Progress, metadata_only: bool = False
) -> Iterator[tuple[dict[str, Any], IO[bytes]]]:
    """Yields usd_child's JSON on a file of size [bytes], and its arrays. Raises InputError."""
    if importlib.util.find_spec("pxr") is None:
        raise _lacking(path)
    arguments = [str(path.absolute()), str(NEEDED + unpackable(size))]
    # One thread, as each would count towards the child's limit of memory.
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join(filter(None, sys.path)),
        "PXR_WORK_THREAD_LIMIT": "1",
    }
    with subprocess.Popen(
        [sys.executable, usd_child.__file__, *arguments, *["metadata"] * metadata_only],
        env=environment, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    ) as child:  # fmt: skip
        try:
            stream = child.stdout
            assert stream is not None
            while not select.select([stream], [], [], 0.1)[0]:
                progress(0.0)  # may raise, which ends the child
            line = stream.readline(LONGEST_HEADER)
            if not line.endswith(b"\n"):
                raise InputError(
                    f"{path}: broken, or it claims more memory than {size:,} bytes may"
                )
            told = json.loads(line)
            if "error" in told:
                reason = " ".join(told["error"].replace(f"{path.absolute()}:", "line ").split())
                raise InputError(f"{path}: {shown(reason, 300)}")
            yield told, stream
        finally:
            child.kill()


class _Field(NamedTuple):
    """The child's description of a prim's splats."""

    splats: int
    degree: int
    """Of the harmonics that are kept."""
    stored: int
    """Harmonics of a splat in the file."""
    pose: NDArray[np.float64]
    """(4, 4), finite, in metres."""
    model: Model
    arrays: list[tuple[np.dtype[Any], int] | None]
    """Type and number of rows of each of usd_child.ARRAYS; None for one that the prim lacks."""
    hints: dict[str, str]

    @classmethod
    def of(cls, path: Path, told: Any, meters: float) -> _Field:
        """Raises InputError for a transform that is not finite, or a degree out of range."""
        pose = np.diag([meters] * 3 + [1]) @ np.array(told["pose"], np.float64).T
        if not np.isfinite(pose).all():
            raise InputError(f"{path}: {shown(told['path'])}: its transform is not finite")
        arrays = [array and (np.dtype(array[0]), int(array[1])) for array in told["arrays"]]
        positions, harmonics = arrays[0], arrays[-1]
        count = positions[1] if positions else 0
        degree = told["degree"] if told["degree"] is not None else MAX_SH_DEGREE
        if not 0 <= degree <= HIGHEST_DEGREE:
            raise InputError(
                f"{path}: {shown(told['path'])}: SH degree {degree}, expected 0 to {HIGHEST_DEGREE}"
            )
        stored = sh_coefficients(degree)
        if not harmonics or harmonics[1] < stored * count:
            degree = 0
        kept = min(degree, MAX_SH_DEGREE)
        model = told_model(path, told["model"])
        return cls(count, kept, stored, pose, model, arrays, told["hints"])

    def differs(self) -> Iterator[str]:
        """Yields a warning for each thing that is not drawn or kept as the file has it."""
        for name, value in self.hints.items():
            if value != usd_child.HINTS[name]:
                yield f"{name} is {shown(value)}; drawn as {usd_child.HINTS[name]}"
        if self.degree == MAX_SH_DEGREE and self.stored > sh_coefficients(MAX_SH_DEGREE):
            yield f"spherical harmonics above band {MAX_SH_DEGREE} left out"


def _fill(path: Path, columns: Columns, field: _Field, stream: IO[bytes]) -> list[str]:
    """Reads a prim's arrays, one after the other, into columns; returns what to warn of.

    A missing or too short array becomes the schema's default: no rotation, scale 1, opaque, grey.
    """
    columns.orientations[:] = 0, 0, 0, 1
    columns.scales[:] = 1
    columns.opacities[:] = 1
    positions, orientations, scales, opacities, sh = columns
    targets = (
        positions[:, None],
        orientations[:, None],
        scales[:, None],
        opacities[:, None, None],
        sh[:, : sh_coefficients(field.degree)],
    )
    rows_of_each = (1, 1, 1, 1, field.stored)
    for array, target, each in zip(field.arrays, targets, rows_of_each, strict=True):
        if array is None:
            continue
        dtype, rows = array
        width = target.shape[-1]
        wanted = field.splats if rows >= field.splats * each else 0
        for part in blocks(wanted):
            values = _numbers(path, stream, dtype, (part.stop - part.start) * each * width)
            target[part] = values.reshape(-1, each, width)[:, : target.shape[1]]
        for part in blocks(rows - wanted * each):  # skips the others
            _numbers(path, stream, dtype, (part.stop - part.start) * width)
    logarithms, logits = as_trained(scales[:BLOCK], opacities[:BLOCK])
    (np.exp if logarithms else np.abs)(scales, out=scales)
    opacities[:] = sigmoid(opacities) if logits else np.clip(opacities, 0, 1)
    return told_as_trained(logarithms, logits)


def _numbers(path: Path, stream: IO[bytes], dtype: np.dtype[Any], count: int) -> NDArray[Any]:
    data = stream.read(count * dtype.itemsize)
    if len(data) < count * dtype.itemsize:
        raise InputError(f"{path}: broken: usd-core ended while it read")
    return np.frombuffer(data, dtype)
