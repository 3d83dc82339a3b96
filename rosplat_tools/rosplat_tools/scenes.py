"""A scene by the name that a user gives it: a path, or procedural:COUNT for the garden."""

from __future__ import annotations

from rosplat_tools import formats
from rosplat_tools.formats import Progress, Warn
from rosplat_tools.generate import generate
from rosplat_tools.splats import SceneError, Splats

PROCEDURAL = "procedural:"

NAMES = ".ply, .spz, .sog, a SOG folder, or procedural:COUNT[:SEED]"


def load_scene(name: str, progress: Progress, warn: Warn) -> Splats:
    """Reads a scene file, or generates COUNT splats; as formats.load. Raises SceneError."""
    if not name.startswith(PROCEDURAL):
        return formats.load(name, progress, warn)
    count, _, seed = name.removeprefix(PROCEDURAL).partition(":")
    if not (count.isdecimal() and (seed or "0").isdecimal()):
        raise SceneError(f"{name}: expected procedural:COUNT[:SEED]")
    return generate(int(count), int(seed or 0))
