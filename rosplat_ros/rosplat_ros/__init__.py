"""Maps of 3D Gaussians as topics: how a node publishes one, and how a node hears one.

The names here are the public interface, each loaded at its first use. The modules are private.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from rosplat_core.lazy import attributes

if TYPE_CHECKING:
    from rosplat_ros.images import from_image
    from rosplat_ros.map_publisher import MapPublisher
    from rosplat_ros.map_receiver import MapReceiver
    from rosplat_ros.poses import to_matrix
    from rosplat_ros.program.running import spin

__all__ = [
    "MapPublisher",
    "MapReceiver",
    "from_image",
    "spin",
    "to_matrix",
]

__getattr__, __dir__ = attributes(
    __name__,
    {
        "images": ("from_image",),
        "map_publisher": ("MapPublisher",),
        "map_receiver": ("MapReceiver",),
        "poses": ("to_matrix",),
        "program.running": ("spin",),
    },
)
