"""A map with fewer splats that looks the same, from the map alone."""

from __future__ import annotations

from rosplat_ros.program.processes import run_module


def main(arguments: list[str] | None = None) -> int:
    """Runs the command; 0 if the simpler map was written."""
    return run_module("simplify", "rosplat_lab.simplify.command", arguments)
