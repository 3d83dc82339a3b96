"""Pictures through the whole chain, of the cameras of a file."""

from __future__ import annotations

from rosplat_tools.processes import interrupt_by_signals


def main(arguments: list[str] | None = None) -> int:
    """Runs the command; 0 if every picture was drawn."""
    interrupt_by_signals()
    try:  # loading takes seconds, in which Ctrl-C is as quiet as later
        from rosplat_tools.render.command import main as run

        return run(arguments)
    except KeyboardInterrupt:
        return 130
