"""PLY in the layout of the INRIA code (Kerbl et al. 2023), as trainers and viewers exchange it.

x y z, f_dc_0..2, f_rest_* (channel-major), opacity as logit, scale_* as logarithm, rot_0..3 with w
first. Read in any order of properties, of any numeric type, in text or binary of either byte order.
Further properties are channels, a trainer's label say.

Descendants write less, or otherwise: one scale for spheres (MonoGS), two for discs (2DGS); red
green blue for f_dc_* (nerfstudio); more bands than three; half floats, some as 16-bit integers; the
vertical in a comment (Brush, nerfstudio); scalar_f_dc_0 and the like (CloudCompare).
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.lib.stride_tricks import as_strided
from numpy.typing import NDArray

from rosplat_core.channels import MOST as MOST_CHANNELS
from rosplat_core.channels import is_name
from rosplat_core.formats.bounds import claim, size_of
from rosplat_core.formats.decoded import (
    AS_TRAINED,
    BLOCK,
    Axes,
    Floats,
    Into,
    Made,
    Progress,
    Warn,
    blocks,
    share,
)
from rosplat_core.formats.ply_file import Element, PlyFile, Rows, header
from rosplat_core.formats.quantised import sigmoid
from rosplat_core.harmonics import C0 as SH_C0
from rosplat_core.log_text import shown
from rosplat_core.models import Model
from rosplat_core.splats import MAX_SH_DEGREE, InputError, Splats, sh_coefficients

NAME = "PLY"
READS = ".ply"
SUFFIXES = (".ply",)
MODELS = tuple(Model)
KEEPS_CHANNELS = True
KEEPS_ORIGIN = True

POSITION = ["x", "y", "z"]
NORMAL = ["nx", "ny", "nz"]
COLOR = ["f_dc_0", "f_dc_1", "f_dc_2"]
SCALE = ["scale_0", "scale_1", "scale_2"]
ROTATION = ["rot_0", "rot_1", "rot_2", "rot_3"]

# Colours in place of COLOR; beside it, they are for viewers of points.
RGB = (["red", "green", "blue"], ["r", "g", "b"])

# Names in place of a PLY's. CloudCompare puts `scalar_` before those of fields that it keeps, some
# converters for it `scal_`.
SAME = {
    **{f"{word}_{i}": axis for word in ("position", "xyz") for i, axis in enumerate("xyz")},
    **{f"position_{axis}": axis for axis in "xyz"},
    **{f"rot_{axis}": f"rot_{i}" for i, axis in enumerate("wxyz")},
    **{f"rotation_{i}": f"rot_{i}" for i in range(4)},
    **{f"scale_{axis}": f"scale_{i}" for i, axis in enumerate("xyz")},
}
_BEFORE = re.compile(r"(?:scal(?:ar)?_)+")

# Brush's comment, `SplatRenderMode: mip` for maps trained as Mip-Splatting. splat-transform reads
# and writes it too, and has 2dgs. The other models' words are ours.
COMMENT = "SplatRenderMode:"
WORDS = {
    "default": Model.EWA,
    "mip": Model.EWA_ANTIALIASED,
    "ray": Model.RAY,
    "disc": Model.DISC,
    "2dgs": Model.DISC,
}

# Brush's and nerfstudio's comment on the vertical: a letter, or three numbers.
VERTICAL = "Vertical axis:"
_VERTICAL = re.compile(r"(?:vertical|up)[ _]axis[:=\s]+(.*)", re.IGNORECASE)

# Mip-Splatting's own PLYs hold its 3D smoothing filter apart, still to be applied. [m]
FILTER = "filter_3D"

# Of Scaffold-GS, whose anchors only its networks can turn into splats.
ANCHOR = "f_anchor_feat_0"

# Of scenes in motion: SpacetimeGaussians' and STG's, 4DGS's (Yang et al. 2024).
MOVING = ("trbf_center", "scale_t")

HIGHEST_DEGREE = 10  # of harmonics

HALVES = ("f2", "u2", "i2")  # types that half floats are written as
TELLING = 16  # splats that tell what their numbers mean
BRIGHTEST = 2.0  # of colours from 0 to 1, with what a trainer overshoots

PARSING = 0.9  # share of the time to read a text PLY

TINY = np.finfo(np.float32).tiny


def recognises(path: Path, head: bytes) -> bool:
    """Whether a file begins like a PLY."""
    return re.match(rb"ply[ \t]*[\r\n]", head) is not None


def axes(path: Path) -> Axes:
    """Where a file's axes point, if a comment tells the vertical."""
    up = vertical(PlyFile(path).comments)
    if up is None:
        return AS_TRAINED
    return Axes(f"{' '.join(f'{x:g}' for x in up)} is up (by the file's comment)", up)


def read(path: Path, progress: Progress, warn: Warn, into: Into[Made]) -> Made:
    """Reads the vertices of a PLY as splats; see from_rows."""
    file = PlyFile(path)
    if "vertex" not in file.elements:
        names = shown(", ".join(file.elements) or "none")
        raise InputError(f"{path}: not a Gaussian splat: no element vertex, only {names}")
    element = file.elements["vertex"]
    element.dtype.names = plain_names(element.dtype.names or ())
    if not file.is_text:
        file.elements["vertex"] = _with_halves(element)
    claim(path, file.elements["vertex"].length, 0, size_of(path))
    parsing = PARSING if file.is_text else 0.0
    rows = file.rows("vertex", share(progress, 0, parsing))
    shares = share(progress, parsing, 1)
    return from_rows(path, rows, shares, warn, into, model_in(file.comments))


@np.errstate(all="ignore")  # of what isn't finite, and is dropped
def from_rows(
    path: Path,
    rows: Rows,
    progress: Progress,
    warn: Warn,
    into: Into[Made],
    model: Model | None = None,
) -> Made:
    """Splats from rows with a PLY's properties.

    Those without scale_2 (2D Gaussians) are flat, and of Model.DISC; those with scale_0 alone are
    spheres. Bands above the third are left out. Mip-Splatting's 3D filter is applied, as its
    create_fused_ply.py does. path is for errors to name. Raises InputError where a property is
    missing.
    """
    have = rows.dtype.names or ()
    if ANCHOR in have:
        raise InputError(f"{path}: anchors of Scaffold-GS, whose networks make splats of them")
    if moving := next((name for name in MOVING if name in have), ""):
        raise InputError(
            f"{path}: a scene in motion, by its property {moving}: only still ones are read"
        )
    count = 3 if SCALE[2] in have else 2 if SCALE[1] in have else 1
    scale: list[str] = SCALE[:count]
    rotation: list[str] = [] if count == 1 and ROTATION[0] not in have else ROTATION
    color: list[str] = _color_names(rows)
    filters: list[str] = [FILTER] if FILTER in have else []
    _require_numbers(path, rows, [*POSITION, "opacity", *color, *scale, *rotation, *filters])
    _warn_of_linear(path, rows, scale, warn)
    channels = _channels(path, rows, warn)
    rest = rest_names(path, rows, warn)
    white = None if color is COLOR else _white(rows, color)

    n, k = len(rows), 1 + len(rest) // 3
    for part, (positions, orientations, scales, opacities, sh) in into.blocks(n, k, progress):
        block = rows[part]
        positions[:] = _columns(block, POSITION, np.float64)
        if rotation:
            orientations[:] = np.roll(_columns(block, rotation), -1, axis=1)  # w first -> last
        else:
            orientations[:] = 0, 0, 0, 1
        sides = scales[:, :2] if count == 2 else scales
        sides[:] = np.exp(_columns(block, scale))
        opacities[:] = sigmoid(_columns(block, ["opacity"])[:, 0])
        if filters:
            after = np.hypot(sides, _columns(block, filters))
            opacities *= (sides / np.maximum(after, TINY)).prod(axis=1)
            sides[:] = after
        dc = _columns(block, color)
        sh[:, 0] = dc if white is None else (dc / np.float32(white) - 0.5) / SH_C0
        if rest:
            by_channel = _columns(block, rest).reshape(len(block), 3, k - 1)
            sh[:, 1:] = by_channel.transpose(0, 2, 1)
        with np.errstate(over="ignore"):  # infinite: no value
            for name, values in channels.items():
                values[part] = block[name]
    if model is None:
        model = Model.DISC if count == 2 else Model.EWA
    return into.made(path, warn, Model.EWA_ANTIALIASED if filters else model, channels)


def write(stream: BinaryIO, path: Path, splats: Splats) -> None:
    """Writes splats as binary little-endian PLY, with the zero normals that old viewers expect.

    Positions become doubles where the splats have an origin, so that none of it is lost. Raises
    InputError for a channel that is called like a property with a meaning.
    """
    for name in splats.channels:
        if _has_meaning(name):
            raise InputError(f"{path}: channel '{name}': a PLY has a property of that name")
    layout = to_rows(splats[:0]).dtype
    stream.write(header({"vertex": (len(splats), layout)}, comments_of(splats)))
    for part in blocks(len(splats)):
        stream.write(to_rows(splats[part]).tobytes())


def to_rows(splats: Splats) -> NDArray[np.void]:
    """The splats as a PLY holds them."""
    rest = [f"f_rest_{i}" for i in range(3 * (splats.sh.shape[1] - 1))]
    position_type = "<f8" if splats.origin.any() else "<f4"
    scale = SCALE[:2] if splats.model is Model.DISC else SCALE  # as the authors of 2DGS save them
    names = [*NORMAL, *COLOR, *rest, "opacity", *scale, *ROTATION, *splats.channels]
    rows = np.zeros(
        len(splats),
        [(name, position_type) for name in POSITION] + [(name, "<f4") for name in names],
    )
    _fill(rows, POSITION, splats.positions + splats.origin)
    _fill(rows, COLOR, splats.sh[:, 0])
    _fill(rows, rest, splats.sh[:, 1:].transpose(0, 2, 1).reshape(len(splats), len(rest)))
    _fill(rows, ["opacity"], _logit(splats.opacities)[:, None])
    # A flat Gaussian's zero scale has no logarithm; the smallest float stands for it.
    _fill(rows, scale, np.log(np.maximum(splats.scales, TINY)))
    _fill(rows, ROTATION, np.roll(splats.orientations, 1, axis=1))
    for name, values in splats.channels.items():
        rows[name] = values
    return rows


def plain_names(names: Sequence[str]) -> tuple[str, ...]:
    """A PLY's names in the place of others for the same, each once at most."""

    def plain(name: str) -> str:
        bare = _BEFORE.sub("", name, count=1) if _BEFORE.match(name) else name
        usual = SAME.get(bare, bare)
        return usual if _has_meaning(usual) and usual not in names else name

    found = tuple(map(plain, names))
    return found if len(set(found)) == len(found) else tuple(names)


def _has_meaning(name: str) -> bool:
    """Whether a property of this name has a meaning, and so is no channel."""
    known = [*POSITION, *NORMAL, *COLOR, "opacity", *SCALE, *ROTATION, FILTER, *RGB[0], "alpha"]
    return name in known or name.startswith("f_rest_")


def _channels(path: Path, rows: Rows, warn: Warn) -> dict[str, Floats]:
    """Room (n,) for each channel: the first properties without a meaning, MOST_CHANNELS at most."""
    used = _color_names(rows)
    further = [n for n in rows.dtype.names or () if not _has_meaning(n) and n not in used]
    kept = [name for name in further if is_name(name)][:MOST_CHANNELS]
    if len(kept) < len(further):
        left = len(further) - len(kept)
        warn(f"{path}: left out {left} properties: a map has {MOST_CHANNELS} channels of ASCII")
    return {name: np.empty(len(rows), np.float32) for name in kept}


def _warn_of_linear(path: Path, rows: Rows, scale: list[str], warn: Warn) -> None:
    """Says so where scales or opacities look like what they are the logarithms and logits of."""
    some = rows[: min(len(rows), BLOCK)]
    for names, what in ((scale, "logarithms"), (["opacity"], "logits")):
        values = _columns(some, names)
        if len(some) >= TELLING and ((values > 0) & (values <= 1)).all():
            warn(f"{path}: {names[0]} is from 0 to 1 in all splats: no {what}, as a PLY has them?")


def _with_halves(element: Element) -> Element:
    """Has 16-bit integers read as half floats, where even positions are such: some write them so.

    Channels stay integers.
    """
    dtype = element.dtype
    if any(name not in (dtype.names or ()) or dtype[name].str[1:] not in HALVES for name in "xyz"):
        return element
    used = [n for n in dtype.names or () if _has_meaning(n) and dtype[n].str[1:] in HALVES]
    halves = {name: dtype[name].str[0] + "f2" for name in used}
    columns = [(name, halves.get(name, dtype[name].str)) for name in dtype.names or ()]
    return element._replace(dtype=np.dtype(columns))


def _color_names(rows: Rows) -> list[str]:
    """The properties that colours are in."""
    have = rows.dtype.names or ()
    return next((names for names in (COLOR, *RGB) if names[0] in have), COLOR)


def _white(rows: Rows, names: list[str]) -> float:
    """The number that full red, green or blue has: by type, or of floats by the largest."""
    kind = rows.dtype[names[0]]
    if kind.kind in "iu":
        return 65535.0 if kind.itemsize == 2 else 255.0
    parts = (_columns(rows[part], names) for part in blocks(len(rows)))
    largest = max((np.fmax.reduce(part, axis=None) for part in parts), default=0)
    return 255.0 if largest > BRIGHTEST else 1.0


def comments_of(splats: Splats) -> list[str]:
    """What comments say of splats, for `vertical` and `model_in` to read."""
    told = [f"{COMMENT} {word}" for word, model in WORDS.items() if model is splats.model][-1:]
    if splats.model is Model.EWA:  # which all take a PLY for
        told = []
    if splats.up is not None:
        told.append(f"{VERTICAL} {' '.join(f'{x:.9g}' for x in splats.up)}")
    return told


def vertical(comments: list[str]) -> tuple[float, float, float] | None:
    """The unit vector that points up, as comments tell it; the last of them counts.

    Where Brush writes y or z, its viewer has that axis point down.
    """
    down = any("brush" in comment.lower() for comment in comments)
    up = None
    for comment in comments:
        if match := _VERTICAL.match(comment):
            up = _direction(match[1].lower(), down) or up
    return up


def _direction(text: str, down: bool) -> tuple[float, float, float] | None:
    """A letter with or without a sign, or three numbers, as a unit vector. down: of y and z."""
    if match := re.match(r"([-+]?)([xyz])\b", text):
        sign, axis = match.groups()
        length = -1.0 if sign == "-" or (not sign and down and axis != "x") else 1.0
        x, y, z = (length if axis == name else 0.0 for name in "xyz")
        return (x, y, z)
    try:
        x, y, z = (float(word) for word in re.split(r"[\s,;()\[\]]+", text.strip(" ()[]"))[:3])
    except ValueError:
        return None
    length = math.hypot(x, y, z)
    return (x / length, y / length, z / length) if 0 < length < math.inf else None


def model_in(comments: list[str]) -> Model | None:
    """What comments say, Brush's or Postshot's `antialiased 1`; the last of them counts."""
    found = None
    for comment in comments:
        words = comment.lower().split()
        if words[:1] == [COMMENT.lower()]:
            found = WORDS.get(" ".join(words[1:]), found)
        elif words[:1] == ["antialiased"]:
            found = Model.EWA_ANTIALIASED if words[1:] == ["1"] else Model.EWA
    return found


def rest_names(path: Path, rows: Rows, warn: Warn) -> list[str]:
    """Names of the f_rest properties that a map has room for, channel by channel.

    Tells warn of bands that are left out. Raises InputError for a gap.
    """
    count = sum(name.startswith("f_rest_") for name in rows.dtype.names or ())
    counts = [3 * (sh_coefficients(degree) - 1) for degree in range(HIGHEST_DEGREE + 1)]
    if count not in counts:
        raise InputError(f"{path}: {count} properties f_rest_*, expected one of {counts}")
    _require_numbers(path, rows, [f"f_rest_{i}" for i in range(count)])
    degree, each = counts.index(count), count // 3
    kept = min(each, sh_coefficients(MAX_SH_DEGREE) - 1)
    if kept < each:
        warn(f"{path}: spherical harmonics above band {MAX_SH_DEGREE} left out, of {degree} bands")
    return [f"f_rest_{channel * each + i}" for channel in range(3) for i in range(kept)]


def _require_numbers(path: Path, rows: Rows, names: list[str]) -> None:
    have = rows.dtype.names or ()
    missing = [name for name in names if name not in have]
    if missing:
        raise InputError(f"{path}: not a Gaussian splat: no property {', '.join(missing)}")


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
    return np.log(inside) - np.log1p(-inside)
