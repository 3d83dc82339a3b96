"""Scene files of 3D Gaussians: one format, one module, told apart by what a file begins with.

A format without such a signature is told by the path's ending. A model's folder stands for its
newest file.
"""

from __future__ import annotations

import logging
import os
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np

from rosplat_core.formats import (
    compressed_ply,
    folders,
    gltf,
    ksplat,
    ply,
    sog,
    splat,
    splatam,
    spz,
    strangers,
    streamed_sog,
    usd,
)
from rosplat_core.formats.bounds import naming_the_file, size_of
from rosplat_core.formats.decoded import AS_TRAINED, Axes, Into, IntoSplats, Made, Progress, Warn
from rosplat_core.formats.decoded import IntoPacked as IntoPacked
from rosplat_core.log_text import shown
from rosplat_core.models import Model
from rosplat_core.program.files import replacing
from rosplat_core.program.progress import watched
from rosplat_core.slot_order import space_order
from rosplat_core.splats import LONGEST_ERROR, Splats, check_splats
from rosplat_core.splats import InputError as InputError

_log = logging.getLogger(__name__)

# Each module has NAME, READS (what it reads, as users name it: endings, or a kind of folder),
# recognises(path, head), read(path, progress, warn, into). One that writes has SUFFIXES and
# write(stream, path, splats): path, which stream will replace, tells the ending and is named in
# errors. Optional: axes(path) (if not AS_TRAINED), IN_SPACE_ORDER (it packs neighbours), FINITE (it
# has no other numbers), KEEPS_CHANNELS, KEEPS_ORIGIN (splats may lie far from 0), MODELS (that it
# tells, if not EWA alone), require(path) (raises where a package is missing), DRAWN (how the format
# has its splats drawn, if otherwise).
FORMATS: tuple[ModuleType, ...] = (
    compressed_ply,
    ply,
    spz,
    gltf,
    usd,  # zips of the one below
    streamed_sog,
    splatam,
    sog,
    splat,
    ksplat,
    folders,
)

# Endings that can be written, for the user.
SUFFIXES = ", ".join(s for module in FORMATS if hasattr(module, "write") for s in module.SUFFIXES)

HEAD = 1 << 16  # what a module may see of a file's beginning [bytes]


def format_of(path: str | Path) -> ModuleType:
    """The module that reads a file or folder. Raises InputError when none does."""
    path = scene_file(path)
    with naming_the_file(path):
        head = b""
        if not path.is_dir():
            size_of(path)  # refuses a pipe, on which open() would wait
            with path.open("rb") as file:
                head = file.read(HEAD)
        what = strangers.impostor(head)
        for module in FORMATS if not what else ():
            if module.recognises(path, head):
                return module
        what = what or strangers.stranger(path, head)
    if what:
        raise InputError(f"{path}: {what}")
    if not head and path.is_file():
        raise InputError(f"{path}: is empty")
    names = ", ".join(module.NAME for module in FORMATS)
    raise InputError(f"{path}: not a scene of 3D Gaussians that can be read ({names})")


def scene_file(path: str | Path) -> Path:
    """The newest file of a model's folder; any other path itself."""
    path = Path(path)
    with naming_the_file(path):
        return folders.newest(path)[0]


def axes(path: str | Path) -> Axes:
    """Where the axes of a scene's coordinates point. Raises InputError as load does."""
    path = scene_file(path)
    module = format_of(path)
    with naming_the_file(path):
        found: Axes = module.axes(path) if hasattr(module, "axes") else AS_TRAINED
    return found


def load(
    path: str | Path,
    progress: Progress | None = None,
    warn: Warn = _log.warning,
) -> Splats:
    """Reads a scene in the file's own coordinates; nothing is flipped or scaled.

    progress is called with 0 to 1 while it reads; by default, a terminal shows a bar. warn is
    called with a sentence about whatever had to be left out, such as splats that are not finite,
    and with which file of a folder is read. Raises InputError for a file that can't be read whole:
    it names the file and what is wrong with it.
    """
    if progress is not None:
        return load_into(IntoSplats(), path, progress, warn)
    with watched("reading") as bar:
        return load_into(IntoSplats(), path, bar, warn)


def load_into(into: Into[Made], path: str | Path, progress: Progress, warn: Warn) -> Made:
    """As load, with splats of the kind that `into` makes."""

    def said(text: str) -> None:
        warn(shown(text, LONGEST_ERROR))

    with naming_the_file(Path(path)):
        file, candidates = folders.newest(Path(path))
    if file != Path(path):
        said(f"{path}: {file.relative_to(path)} is read, the newest of {candidates}")
    module = format_of(file)
    # A number that overflows is not finite in the end, and is dropped with its splat.
    with naming_the_file(file), np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        made: Made = module.read(file, progress, said, into)
    progress(1.0)
    return replace(made, up=axes(file).up)


def check_output(path: str | Path, overwrite: bool = False) -> None:
    """Raises InputError, before there is anything to write, where save would fail.

    That is for an ending that can't be written, a missing package, a folder that is missing or
    can't be written to, and a file that exists, unless overwrite is given.
    """
    path = Path(path)
    writer = _writer(path)
    if hasattr(writer, "require"):
        writer.require(path)
    check_new_file(path, overwrite)


def check_new_file(path: str | Path, overwrite: bool = False) -> None:
    """As check_output, for a file of any ending."""
    path = Path(path)
    with naming_the_file(path):
        exists = path.exists()
    if not path.parent.is_dir():
        raise InputError(f"{path}: {path.parent} is no folder")
    if not os.access(path.parent, os.W_OK | os.X_OK):
        raise InputError(f"{path}: nothing can be written to {path.parent}")
    if path.is_dir():
        raise InputError(f"{path}: is a folder")
    if exists and not path.is_file():
        raise InputError(f"{path}: is no file that could be replaced")
    if exists and not overwrite:
        raise InputError(f"{path}: exists already; overwrite replaces it")


def save(path: str | Path, splats: Splats, *, overwrite: bool = False) -> Splats:
    """Writes a scene; the path's ending chooses the format.

    overwrite: replace a file that exists, whole; else it is an error. Formats that have a place for
    the vertical keep it. Returns the splats in the order of the file: formats that pack neighbours
    put them in space order; channels that a format has no place for are left out, and a model that
    it can't tell is lost, with a warning in the log. Raises InputError for an ending that can't be
    written, splats that a format has no way to write, a place that can't be written to, or too
    little memory.
    """
    check_splats(splats)
    path = Path(path)
    check_output(path, overwrite)
    writer = _writer(path)
    if splats.channels and not getattr(writer, "KEEPS_CHANNELS", False):
        _log.warning(
            "%s: left out %s: %s has no channels", path, ", ".join(splats.channels), writer.NAME
        )
        splats = replace(splats, channels={})
    if splats.model not in getattr(writer, "MODELS", (Model.EWA,)):
        _log.warning(
            "%s: %s can't tell that the model is %s: whoever opens it has to",
            path, writer.NAME, splats.model,
        )  # fmt: skip
    if not getattr(writer, "KEEPS_ORIGIN", False):
        _warn_of_far_splats(path, writer, splats)
    with naming_the_file(path):
        packs = getattr(writer, "IN_SPACE_ORDER", False)
        if packs or getattr(writer, "FINITE", False):
            _require_finite(path, splats)
        if packs:
            splats = splats[space_order(splats.positions)]
        # A number beyond a format's range becomes its largest.
        with (
            replacing(path) as partial,
            partial.open("wb") as stream,
            np.errstate(over="ignore"),
        ):
            writer.write(stream, path, splats)
    return splats


def _warn_of_far_splats(path: Path, writer: ModuleType, splats: Splats) -> None:
    """Warns where 32-bit positions are coarser than the median splat."""
    if not splats.origin.any() or not len(splats):
        return
    with np.errstate(over="ignore", invalid="ignore"):  # beyond float32
        step = float(np.spacing(np.float32(np.abs(splats.origin).max())))
    if step > np.median(splats.scales.max(axis=1)):
        _log.warning(
            "%s: %s keeps no origin, and so far from 0 its positions are coarser than the splats: "
            "PLY, glTF, OpenUSD and SOG keep it", path, writer.NAME,
        )  # fmt: skip


def _require_finite(path: Path, splats: Splats) -> None:
    arrays = (splats.positions, splats.orientations, splats.scales, splats.opacities, splats.sh)
    with np.errstate(invalid="ignore"):  # in sums of infinities
        if not all(np.isfinite(array.sum(dtype=np.float64)) for array in arrays):
            raise InputError(f"{path}: a number that is not finite can't be written")


def _writer(path: Path) -> ModuleType:
    writers = {s: module for module in FORMATS if hasattr(module, "write") for s in module.SUFFIXES}
    # .compressed.ply before .ply
    for suffix in sorted(writers, key=len, reverse=True):
        if path.name.lower().endswith(suffix):
            return writers[suffix]
    raise InputError(f"{path}: can't write this ending, only {SUFFIXES}")
