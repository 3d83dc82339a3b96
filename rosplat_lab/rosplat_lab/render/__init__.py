"""Pictures through the whole chain, of the cameras of a file."""

from __future__ import annotations

from rosplat_ros.program.processes import run_module


def main(arguments: list[str] | None = None) -> int:
    """Runs the command; 0 if every picture was drawn."""
    return run_module("render", "rosplat_lab.render.command", arguments)
