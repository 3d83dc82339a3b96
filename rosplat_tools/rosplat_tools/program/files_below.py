"""Files that peers name: only below a folder that a parameter names."""

from __future__ import annotations

from pathlib import Path

from rosplat_core.splats import SceneError


def check_below(parameter: str, root: str, path: str) -> None:
    """Raises SceneError for a path that leads out of a folder, by links or otherwise."""
    try:
        if root and Path(path).resolve().is_relative_to(Path(root).resolve()):
            return
    except (OSError, RuntimeError, ValueError):  # a circle of links, or no name of a file
        pass
    why = f"not below {root}, its" if root else "none is allowed by its"
    raise SceneError(f"{path}: refused: {why} parameter {parameter}")
