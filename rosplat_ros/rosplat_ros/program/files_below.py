"""Checks that files named by peers are below a folder that a parameter names."""

from __future__ import annotations

from pathlib import Path

from rosplat_core.splats import InputError


def check_below(parameter: str, root: str, path: str) -> None:
    """Raises InputError unless path is below root, links followed. An empty root allows none."""
    try:
        if root and Path(path).resolve().is_relative_to(Path(root).resolve()):
            return
    except (OSError, RuntimeError, ValueError):  # a circle of links, or no name of a file
        pass
    why = f"not below {root}, its parameter {parameter}"
    if not root:
        why = f"none is allowed; set the parameter {parameter} to a folder above it"
    raise InputError(f"{path}: refused: {why}")
