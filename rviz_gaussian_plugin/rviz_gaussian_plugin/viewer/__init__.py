"""A viewer without rviz2: `node` draws, `orbit` frames, `command` shows."""

from __future__ import annotations

from rosplat_ros.program.processes import run_module


def main(arguments: list[str] | None = None) -> int:
    """Runs the viewer; 1 where it can't draw."""
    return run_module("viewer", "rviz_gaussian_plugin.viewer.command", arguments)
