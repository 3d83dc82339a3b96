"""Publishes and shows a scene: in rviz2 if it is installed, else in a viewer of its own."""

from __future__ import annotations

from rosplat_ros.program.processes import run_module


def main(arguments: list[str] | None = None) -> int:
    """Runs publisher and viewer until the viewer ends; 1 where one of them can't."""
    return run_module("demo", "rviz_gaussian_plugin.demo.command", arguments)
