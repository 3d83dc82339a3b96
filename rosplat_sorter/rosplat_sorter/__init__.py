"""Orders the splats of a 3D Gaussian map by depth for each view that looks at it.

This is the public interface; each name's module is loaded at first use. The modules are private.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rosplat_sorter.backends import Backend, Unavailable, open_backend
    from rosplat_sorter.order_slots import OrderReader

__all__ = [
    "Backend",
    "OrderReader",
    "Unavailable",
    "open_backend",
]

_MODULES = {
    "Backend": "backends",
    "OrderReader": "order_slots",
    "Unavailable": "backends",
    "open_backend": "backends",
}


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
    raise AttributeError(f"module '{__name__}' has no attribute '{name}'")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
