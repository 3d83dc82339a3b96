"""Scenes of 3D Gaussians: publishers, cameras and simulated robots in a map, emulated sensors.

The names here are the public interface, each loaded at its first use. The modules are private.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from rosplat_core.lazy import attributes

if TYPE_CHECKING:
    from rosplat_tools.following.whole_maps import WholeMaps
    from rosplat_tools.simulation.splat_camera import SplatCamera

__all__ = [
    "SplatCamera",
    "WholeMaps",
]

__getattr__, __dir__ = attributes(
    __name__,
    {"following.whole_maps": ("WholeMaps",), "simulation.splat_camera": ("SplatCamera",)},
)
