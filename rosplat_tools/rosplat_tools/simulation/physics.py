"""MuJoCo, which needs a Python package of its own, and models of files."""

from __future__ import annotations

import os
import warnings
from pathlib import Path
from typing import Any

from rosplat_core.log_text import shown
from rosplat_core.splats import InputError


def load_mujoco() -> Any:
    """The module. Raises InputError where it, or what MUJOCO_GL names, is not installed."""
    try:
        import mujoco as found  # which takes a while
    except Exception as error:  # of PyOpenGL, too, and of no common kind
        if isinstance(error, ModuleNotFoundError) and error.name == "mujoco":
            reason = "MuJoCo needs the Python package mujoco: pip install mujoco"
        else:
            wanted = os.environ.get("MUJOCO_GL", "")
            reason = f"MuJoCo does not begin with MUJOCO_GL='{wanted}': {shown(error, 150)}"
        raise InputError(reason) from error
    return found


def read_spec(path: str | Path) -> Any:
    """The MjSpec of an MJCF file, to be added to and compiled. Raises InputError, naming the file.

    Names that are there twice are found when it is compiled.
    """
    try:
        return load_mujoco().MjSpec.from_file(str(path))
    except (ValueError, RuntimeError) as error:
        raise InputError(f"{path}: {_reason(error)}") from error


def compiled(spec: Any, path: str | Path) -> Any:
    """The MjModel of a spec of a file. Raises InputError, naming the file: meshes that are missing,
    names that are there twice, numbers that make no sense."""
    try:
        with warnings.catch_warnings():  # of attributes that are deprecated: the file's author's
            warnings.simplefilter("ignore")
            return spec.compile()
    except (ValueError, RuntimeError) as error:
        raise InputError(f"{path}: {_reason(error)}") from error


def _reason(error: Exception) -> str:
    return shown(" ".join(str(error).split()).removeprefix("Error: "), 300)
