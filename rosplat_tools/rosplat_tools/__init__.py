"""Scenes of 3D Gaussians: publishers, cameras and simulated robots in a map, emulated sensors.

The names here are the public interface, each loaded at its first use. The modules are private.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rosplat_tools.following.whole_maps import WholeMaps
    from rosplat_tools.simulation.splat_camera import SplatCamera

__all__ = [
    "SplatCamera",
    "WholeMaps",
]

_MODULES = {
    "SplatCamera": "simulation.splat_camera",
    "WholeMaps": "following.whole_maps",
}


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
    raise AttributeError(f"module '{__name__}' has no attribute '{name}'")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
