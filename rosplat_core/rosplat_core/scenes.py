"""A scene by the name that a user gives it: a path, procedural:COUNT (a garden) or rooms:COUNT."""

from __future__ import annotations

import re

from rosplat_core import formats
from rosplat_core.formats.decoded import Into, IntoSplats, Made, Progress, Warn
from rosplat_core.generated import generate_into
from rosplat_core.models import Model
from rosplat_core.program.typed_numbers import whole_number
from rosplat_core.slot_pages import MAX_SLOTS
from rosplat_core.splats import MAX_SH_DEGREE, InputError, Splats

PROCEDURAL = "procedural:"
ROOMS = "rooms:"
GENERATED = {PROCEDURAL: "garden", ROOMS: "rooms"}

READS = ", ".join(module.READS for module in formats.FORMATS)
NAMES = f"{READS}, procedural:COUNT[:SEED] or rooms:COUNT[:SEED]"


def is_generated(name: str) -> bool:
    """Whether a scene's name asks for a generated scene, and is no file's."""
    return name.startswith(tuple(GENERATED))


def check_scene(name: str) -> None:
    """Raises InputError, before other work, for a file that isn't there, or is no scene."""
    if not name:
        raise InputError("no scene is named")
    if is_generated(name):
        _numbers(name)
    else:
        formats.format_of(name)


def load_scene(name: str, progress: Progress, warn: Warn) -> Splats:
    """Reads a scene to be shown; as read_scene, but raises InputError for one without a splat."""
    return load_scene_into(IntoSplats(), name, progress, warn)


def load_scene_into(into: Into[Made], name: str, progress: Progress, warn: Warn) -> Made:
    """As load_scene, with splats of the kind that `into` makes."""
    splats = _read(into, name, progress, warn)
    if len(splats) == 0:
        raise InputError(f"{name}: holds no splats")
    return splats


def read_scene(name: str, progress: Progress, warn: Warn) -> Splats:
    """Reads a scene file as formats.load, or generates COUNT splats.

    Raises InputError, also for more splats than a map or this machine's memory holds.
    """
    return _read(IntoSplats(), name, progress, warn)


def _read(into: Into[Made], name: str, progress: Progress, warn: Warn) -> Made:
    if is_generated(name):
        count, seed = _numbers(name)
        scene = GENERATED[name[: name.index(":") + 1]]
        try:
            return generate_into(into, count, seed, MAX_SH_DEGREE, progress, scene)
        except MemoryError as error:
            raise InputError(f"{name}: too large for this machine's memory") from error
    splats = formats.load_into(into, name, progress, warn)
    if len(splats) > MAX_SLOTS:
        raise InputError(f"{name}: {len(splats):,} splats; a map has at most {MAX_SLOTS:,}")
    return splats


def _numbers(name: str) -> tuple[int, int]:
    """COUNT and SEED of a generated scene's name. Raises InputError."""
    kind, _, numbers = name.partition(":")
    match = re.fullmatch(r"(\d{1,18}|[\d.]{1,18}[kKmM])(?::(\d{1,18}))?", numbers, re.ASCII)
    try:
        count, seed = map(whole_number, match.groups("0") if match else "?")
    except ValueError:
        raise InputError(f"{name}: expected {kind}:COUNT[:SEED], such as {kind}:20k") from None
    if not 1 <= count <= MAX_SLOTS:
        raise InputError(f"{name}: expected 1 to {MAX_SLOTS:,} splats, as many as a map has")
    return count, seed


def model_of(name: str, model: Model) -> str:
    """The model of a scene that was loaded, for people: of files, EWA is what remains.

    Few files say it, and some formats could say nothing else.
    """
    unsaid = model is Model.EWA and not is_generated(name)
    return f"{model}, as the file tells of no other" if unsaid else str(model)
