"""The laboratory: the error of every way to draw a map against its time, and where pictures fail.

`ways` lists what is compared, `measure` measures it, `points` finds what pays; `picture`, `report`
and `pages` show it. `atlas` looks for failures.
"""

from __future__ import annotations

from rosplat_ros.program.processes import run_module


def main(arguments: list[str] | None = None) -> int:
    """Runs the command; 0 if everything was measured."""
    return run_module("lab", "rosplat_lab.lab.command", arguments)
