"""The laboratory: the error of every method against its time, and where methods fail.

`orders` and `fragments` are the maths, `methods` lists what is compared, `bench` runs the real
pipeline, `points` keeps what was measured, `report` and `charts` show it; `atlas` looks
for failures, and `stability` writes them down.
"""

from __future__ import annotations


def main(arguments: list[str] | None = None) -> int:
    """Runs the command; 0 if everything was measured."""
    from rosplat_tools.lab.command import main as run  # so that the maths need no renderer

    return run(arguments)
