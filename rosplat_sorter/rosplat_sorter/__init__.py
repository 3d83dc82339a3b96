"""Orders the splats of a 3D Gaussian map by depth for each view that looks at it.

This is the public interface; each name's module is loaded at first use. The modules are private.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from rosplat_core.lazy import attributes

if TYPE_CHECKING:
    from rosplat_sorter.backends import Backend, Unavailable, open_backend
    from rosplat_sorter.order_slots import OrderReader

__all__ = [
    "Backend",
    "OrderReader",
    "Unavailable",
    "open_backend",
]

__getattr__, __dir__ = attributes(
    __name__,
    {"backends": ("Backend", "Unavailable", "open_backend"), "order_slots": ("OrderReader",)},
)
