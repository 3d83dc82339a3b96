"""Scene files of 3D Gaussians: one format, one module, told apart by what a file begins with."""

from __future__ import annotations

import logging
from pathlib import Path
from types import ModuleType

import numpy as np

from rosplat_tools.files import replacing
from rosplat_tools.formats import ply, sog, spz
from rosplat_tools.formats.decoded import Progress, Warn
from rosplat_tools.splats import SceneError, Splats

__all__ = ["FORMATS", "Progress", "SceneError", "Warn", "check_output", "format_of", "load", "save"]

_log = logging.getLogger(__name__)

# Each module has NAME, recognises(path, head) and read(path, progress, warn); what can be written
# has write(path, splats) and SUFFIX as well.
FORMATS: tuple[ModuleType, ...] = (ply, spz, sog)

# Formats of web viewers that have no reader here.
UNREADABLE = (".splat", ".ksplat")


def format_of(path: str | Path) -> ModuleType:
    """The module that reads a file or folder. Raises SceneError when none does."""
    path = Path(path)
    try:
        head = b""
        if not path.is_dir():
            with path.open("rb") as file:
                head = file.read(16)
    except OSError as error:
        raise SceneError(f"{path}: {error.strerror or error}") from error
    for module in FORMATS:
        if module.recognises(path, head):
            return module
    names = ", ".join(module.NAME for module in FORMATS)
    if path.suffix.lower() in UNREADABLE:  # nothing in them tells
        raise SceneError(f"{path}: {path.suffix} can't be read, only {names}: convert it")
    raise SceneError(f"{path}: not a scene of 3D Gaussians that can be read ({names})")


def load(
    path: str | Path,
    progress: Progress = lambda fraction: None,
    warn: Warn = _log.warning,
) -> Splats:
    """Reads a scene in the file's own coordinates; nothing is flipped or scaled.

    progress is called with 0 to 1 while it reads. warn is called with a sentence about whatever
    had to be left out, such as splats that are not finite. Raises SceneError for a file that can't
    be read whole: it names the file and what is wrong with it.
    """
    path = Path(path)
    module = format_of(path)
    try:
        # What overflows on the way is not finite in the end, and dropped with its splat.
        with np.errstate(over="ignore", invalid="ignore"):
            splats: Splats = module.read(path, progress, warn)
    except OSError as error:
        raise SceneError(f"{path}: {error.strerror or error}") from error
    except MemoryError as error:
        raise SceneError(f"{path}: too large for this machine's memory") from error
    progress(1.0)
    return splats


def check_output(path: str | Path, overwrite: bool = False) -> None:
    """Raises SceneError, before there is anything to write, where save would fail.

    For an ending that can't be written, a folder that isn't there, and a file that would be lost.
    """
    path = Path(path)
    _writer(path)
    try:
        exists = path.exists()
    except OSError as error:
        raise SceneError(f"{path}: {error.strerror or error}") from error
    if not path.parent.is_dir():
        raise SceneError(f"{path}: {path.parent} is no folder")
    if exists and not overwrite:
        raise SceneError(f"{path}: exists already (--overwrite replaces it)")


def save(path: str | Path, splats: Splats) -> None:
    """Writes a scene; the path's ending chooses the format. Replaces a file that exists, whole.

    Raises SceneError for an ending that can't be written, a place that can't be written to, or too
    little memory.
    """
    path = Path(path)
    writer = _writer(path)
    try:
        with replacing(path) as partial:
            writer.write(partial, splats)
    except OSError as error:
        raise SceneError(f"{path}: {error.strerror or error}") from error
    except MemoryError as error:
        raise SceneError(f"{path}: too large for this machine's memory") from error


def _writer(path: Path) -> ModuleType:
    writers = {module.SUFFIX: module for module in FORMATS if hasattr(module, "write")}
    try:
        return writers[path.suffix.lower()]
    except KeyError:
        names = ", ".join(writers)
        raise SceneError(f"{path}: can't write this ending, only {names}") from None
