"""The laboratory: the error of every method against its time, and where methods fail.

`orders` and `fragments` are the maths, `methods` lists what is compared, `bench` runs the real
pipeline, `points` keeps what was measured, `report` and `charts` show it; `atlas` looks
for failures, and `stability` writes them down.
"""

from __future__ import annotations

from rosplat_tools.program.processes import run_module


def main(arguments: list[str] | None = None) -> int:
    """Runs the command; 0 if everything was measured."""
    return run_module("lab", "rosplat_lab.lab.command", arguments)
