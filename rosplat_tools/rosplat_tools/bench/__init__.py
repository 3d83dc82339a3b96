"""Measures ROSplat on the machine it runs on; a file for each subject, `command` runs them.

Subjects that need ROS 2 import it when they begin, so sorting and drawing can be measured without.
"""

from __future__ import annotations

from rosplat_tools.processes import interrupt_by_signals


def main(arguments: list[str] | None = None) -> int:
    """Runs the command; 0 where all was measured that this machine can."""
    interrupt_by_signals()
    try:  # loading takes seconds, in which Ctrl-C is as quiet as later
        from rosplat_tools.bench.command import main as run

        return run(arguments)
    except KeyboardInterrupt:
        return 130
