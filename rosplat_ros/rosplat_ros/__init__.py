"""Maps of 3D Gaussians as topics: how a node publishes one, and how a node hears one.

The names here are the public interface, each loaded at its first use. The modules are private.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rosplat_ros.images import from_image
    from rosplat_ros.map_publisher import MapPublisher
    from rosplat_ros.map_receiver import MapReceiver
    from rosplat_ros.poses import to_matrix

__all__ = [
    "MapPublisher",
    "MapReceiver",
    "from_image",
    "to_matrix",
]

_MODULES = {
    "MapPublisher": "map_publisher",
    "MapReceiver": "map_receiver",
    "from_image": "images",
    "to_matrix": "poses",
}


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
    raise AttributeError(f"module '{__name__}' has no attribute '{name}'")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
