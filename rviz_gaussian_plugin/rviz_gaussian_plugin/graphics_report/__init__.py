"""The report that users attach to an issue about drawing."""

from __future__ import annotations

from rosplat_ros.program.processes import run_module


def main(arguments: list[str] | None = None) -> int:
    """Prints the report; 1 where nothing can be drawn."""
    return run_module("graphics_report", "rviz_gaussian_plugin.graphics_report.command", arguments)
