"""PLY in the layout of the INRIA code (Kerbl et al. 2023), as trainers and viewers exchange it.

x y z, f_dc_0..2, f_rest_* (channel-major), opacity as logit, scale_* as logarithm, rot_0..3 with w
first. Read in any order of properties, of any numeric type, in text or binary of either byte order.
Further properties are channels, a trainer's label say.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.lib.stride_tricks import as_strided
from numpy.typing import NDArray

from rosplat_core.channels import MOST as MOST_CHANNELS
from rosplat_core.channels import is_name
from rosplat_core.formats.bounds import claim, size_of
from rosplat_core.formats.decoded import Floats, Into, Made, Progress, Warn, blocks, share
from rosplat_core.formats.ply_file import PlyFile, Rows, header
from rosplat_core.formats.quantised import sigmoid
from rosplat_core.splats import MAX_SH_DEGREE, SceneError, Splats, sh_coefficients

NAME = "PLY"
SUFFIXES = (".ply",)
KEEPS_CHANNELS = True
KEEPS_ORIGIN = True

POSITION = ["x", "y", "z"]
NORMAL = ["nx", "ny", "nz"]
COLOR = ["f_dc_0", "f_dc_1", "f_dc_2"]
SCALE = ["scale_0", "scale_1", "scale_2"]
ROTATION = ["rot_0", "rot_1", "rot_2", "rot_3"]

# Brush's comment for models trained as Mip-Splatting; splat-transform reads and writes it too.
ANTIALIASED = "SplatRenderMode: mip"

# Mip-Splatting's own PLYs hold its 3D smoothing filter apart, still to be applied. [m]
FILTER = "filter_3D"

# Some programs write these beside f_dc_*, for viewers of points.
POINT_COLOR = ["red", "green", "blue", "alpha"]

PARSING = 0.9  # share of the time to read a text PLY

TINY = np.finfo(np.float32).tiny


def recognises(path: Path, head: bytes) -> bool:
    """Whether a file begins like a PLY."""
    return head[:4] in (b"ply\n", b"ply\r")


def read(path: Path, progress: Progress, warn: Warn, into: Into[Made]) -> Made:
    """Reads the vertices of a PLY as splats; see from_rows."""
    file = PlyFile(path)
    if "vertex" not in file.elements:
        raise SceneError(f"{path}: not a Gaussian splat: no element vertex")
    claim(path, file.elements["vertex"].length, 0, size_of(path))
    parsing = PARSING if file.is_text else 0.0
    rows = file.rows("vertex", share(progress, 0, parsing))
    shares = share(progress, parsing, 1)
    return from_rows(path, rows, shares, warn, into, antialiased(file.comments))


def from_rows(
    path: Path,
    rows: Rows,
    progress: Progress,
    warn: Warn,
    into: Into[Made],
    antialiased: bool = False,
) -> Made:
    """Splats from rows with a PLY's properties; without scale_2 (2D Gaussians) they are flat.

    Mip-Splatting's 3D filter is applied, as its create_fused_ply.py does. path is for errors to
    name. Raises SceneError where a property is missing.
    """
    channels = _channels(path, rows, warn)
    has_third_scale = SCALE[2] in (rows.dtype.names or ())
    scale: list[str] = SCALE if has_third_scale else SCALE[:2]
    rest = rest_names(path, rows)
    filters: list[str] = [FILTER] if FILTER in (rows.dtype.names or ()) else []
    _require_numbers(path, rows, [*POSITION, "opacity", *COLOR, *scale, *ROTATION, *filters])

    n, k = len(rows), 1 + len(rest) // 3
    for part, (positions, orientations, scales, opacities, sh) in into.blocks(n, k, progress):
        block = rows[part]
        positions[:] = _columns(block, POSITION, np.float64)
        orientations[:] = np.roll(_columns(block, ROTATION), -1, axis=1)  # w first -> last
        scales[:, : len(scale)] = np.exp(_columns(block, scale))
        opacities[:] = sigmoid(_columns(block, ["opacity"])[:, 0])
        if filters:
            before, width = scales[:, : len(scale)], _columns(block, filters)
            after = np.hypot(before, width)
            opacities *= (before / np.maximum(after, TINY)).prod(axis=1)
            scales[:, : len(scale)] = after
        sh[:, 0] = _columns(block, COLOR)
        if rest:
            by_channel = _columns(block, rest).reshape(len(block), 3, k - 1)
            sh[:, 1:] = by_channel.transpose(0, 2, 1)
        with np.errstate(over="ignore"):  # infinite: no value
            for name, values in channels.items():
                values[part] = block[name]
    return into.made(path, warn, bool(filters) or antialiased, channels)


def write(stream: BinaryIO, path: Path, splats: Splats) -> None:
    """Writes splats as binary little-endian PLY, with the zero normals that old viewers expect.

    Positions become doubles where the splats have an origin, so that none of it is lost. Raises
    SceneError for a channel that is called like a property with a meaning.
    """
    for name in splats.channels:
        if _has_meaning(name):
            raise SceneError(f"{path}: channel '{name}': a PLY has a property of that name")
    comments = [ANTIALIASED] if splats.antialiased else []
    layout = _rows(splats[:0]).dtype
    stream.write(header({"vertex": (len(splats), layout)}, comments))
    for part in blocks(len(splats)):
        stream.write(_rows(splats[part]).tobytes())


def _rows(splats: Splats) -> NDArray[np.void]:
    """The splats as a PLY holds them."""
    rest = [f"f_rest_{i}" for i in range(3 * (splats.sh.shape[1] - 1))]
    position_type = "<f8" if splats.origin.any() else "<f4"
    names = [*NORMAL, *COLOR, *rest, "opacity", *SCALE, *ROTATION, *splats.channels]
    rows = np.zeros(
        len(splats),
        [(name, position_type) for name in POSITION] + [(name, "<f4") for name in names],
    )
    _fill(rows, POSITION, splats.positions + splats.origin)
    _fill(rows, COLOR, splats.sh[:, 0])
    _fill(rows, rest, splats.sh[:, 1:].transpose(0, 2, 1).reshape(len(splats), len(rest)))
    _fill(rows, ["opacity"], _logit(splats.opacities)[:, None])
    # A flat Gaussian's zero scale has no logarithm; the smallest float stands for it.
    _fill(rows, SCALE, np.log(np.maximum(splats.scales, TINY)))
    _fill(rows, ROTATION, np.roll(splats.orientations, 1, axis=1))
    for name, values in splats.channels.items():
        rows[name] = values
    return rows


def _has_meaning(name: str) -> bool:
    """Whether a property of this name has a meaning, and so is no channel."""
    known = [*POSITION, *NORMAL, *COLOR, "opacity", *SCALE, *ROTATION, FILTER, *POINT_COLOR]
    return name in known or name.startswith("f_rest_")


def _channels(path: Path, rows: Rows, warn: Warn) -> dict[str, Floats]:
    """Room (n,) for each channel: the first properties without a meaning, MOST_CHANNELS at most."""
    further = [name for name in rows.dtype.names or () if not _has_meaning(name)]
    kept = [name for name in further if is_name(name)][:MOST_CHANNELS]
    if len(kept) < len(further):
        left = len(further) - len(kept)
        warn(f"{path}: left out {left} properties: a map has {MOST_CHANNELS} channels of ASCII")
    return {name: np.empty(len(rows), np.float32) for name in kept}


def antialiased(comments: list[str]) -> bool:
    """Whether comments say so, Brush's or Postshot's `antialiased 1`; the last of them counts."""
    found = False
    for comment in comments:
        words = comment.lower().split()
        if words[:1] in (["splatrendermode:"], ["antialiased"]):
            found = words[1:] in (["mip"], ["1"])
    return found


def rest_names(path: Path, rows: Rows) -> list[str]:
    """Names of the f_rest properties in order of their number. Raises SceneError for a gap."""
    count = sum(name.startswith("f_rest_") for name in rows.dtype.names or ())
    counts = [3 * (sh_coefficients(degree) - 1) for degree in range(MAX_SH_DEGREE + 1)]
    if count not in counts:
        raise SceneError(f"{path}: {count} properties f_rest_*, expected one of {counts}")
    names = [f"f_rest_{i}" for i in range(count)]
    _require_numbers(path, rows, names)
    return names


def _require_numbers(path: Path, rows: Rows, names: list[str]) -> None:
    have = rows.dtype.names or ()
    missing = [name for name in names if name not in have]
    if missing:
        raise SceneError(f"{path}: not a Gaussian splat: no property {', '.join(missing)}")


def _columns(
    rows: NDArray[np.void], names: list[str], dtype: type[np.floating[Any]] = np.float32
) -> Floats:
    """(rows, names) array of the named properties; a view where they lie side by side."""
    fields = [(rows.dtype[name], rows.dtype.fields[name][1]) for name in names]  # type: ignore[index]
    kind, begin = fields[0]
    if fields == [(kind, begin + i * kind.itemsize) for i in range(len(names))]:
        shape, strides = (len(rows), len(names)), (rows.strides[0], kind.itemsize)
        return as_strided(rows[names[0]], shape, strides, writeable=False).astype(dtype, copy=False)
    return np.stack([rows[name].astype(dtype) for name in names], axis=1)


def _fill(rows: NDArray[np.void], names: list[str], values: Floats) -> None:
    for i, name in enumerate(names):
        rows[name] = values[:, i]


def _logit(p: Floats) -> Floats:
    """log(p / (1 - p)), finite for the 0 and 1 that quantised formats hold."""
    inside = np.clip(p.astype(np.float64), 1e-8, 1 - 1e-8)
    logit: Floats = np.log(inside) - np.log1p(-inside)
    return logit
