"""A map that is received and drawn in one process, without a screen."""

from __future__ import annotations

from collections.abc import Callable

from rclpy.node import Node

from rosplat_core.rendering import CpuRenderer
from rosplat_tools.map_subscriber import MapSubscriber


class DrawnMap(MapSubscriber):
    """A map in a renderer. The same thread calls take() and draws."""

    def __init__(self, node: Node, heard: Callable[[], None]) -> None:
        """heard: called whenever a batch has come."""
        self.renderer = CpuRenderer()
        super().__init__(node, self.renderer, heard)

    @property
    def frame_id(self) -> str:
        """The map's frame."""
        return self.header.frame_id

    def problem(self) -> str:
        """Why a picture would not show the whole map; empty if it would."""
        empty = "" if self.books.splats else f"{self.topic}: the map is empty"
        return super().problem() or empty
