"""Measures ROSplat on the machine it runs on; a file for each subject, `command` runs them.

Subjects that need ROS 2 import it when they begin, so sorting and drawing can be measured without.
"""

from __future__ import annotations

from rosplat_ros.program.processes import run_module


def main(arguments: list[str] | None = None) -> int:
    """Runs the command; 0 where all was measured that this machine can."""
    return run_module("bench", "rosplat_lab.bench.command", arguments)
