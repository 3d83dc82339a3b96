"""Maps of 3D Gaussians without ROS: files, edits, depth order, pictures, simplification.

This is the public interface; each name's module is loaded at first use. The modules are private.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from rosplat_core.lazy import attributes

if TYPE_CHECKING:
    from rosplat_core.alignment import Alignment, align
    from rosplat_core.cameras import Camera, load_cameras, look_at, orbit, save_cameras
    from rosplat_core.distances import DistanceField
    from rosplat_core.first_look import first_view
    from rosplat_core.formats import load, save
    from rosplat_core.generated import generate
    from rosplat_core.models import Model
    from rosplat_core.ordering import depth_order
    from rosplat_core.relocalisation import Relocaliser, relocalise
    from rosplat_core.rendering import CpuRenderer, render
    from rosplat_core.simplification import simplify
    from rosplat_core.slot_order import put_in_slot_order
    from rosplat_core.splats import InputError, Splats, concatenate
    from rosplat_core.upright import find_up

__all__ = [
    "Alignment",
    "Camera",
    "CpuRenderer",
    "DistanceField",
    "InputError",
    "Model",
    "Relocaliser",
    "Splats",
    "align",
    "concatenate",
    "depth_order",
    "find_up",
    "first_view",
    "generate",
    "load",
    "load_cameras",
    "look_at",
    "orbit",
    "put_in_slot_order",
    "relocalise",
    "render",
    "save",
    "save_cameras",
    "simplify",
]

__getattr__, __dir__ = attributes(
    __name__,
    {
        "alignment": ("Alignment", "align"),
        "cameras": ("Camera", "load_cameras", "look_at", "orbit", "save_cameras"),
        "distances": ("DistanceField",),
        "first_look": ("first_view",),
        "formats": ("load", "save"),
        "generated": ("generate",),
        "models": ("Model",),
        "ordering": ("depth_order",),
        "relocalisation": ("Relocaliser", "relocalise"),
        "rendering": ("CpuRenderer", "render"),
        "simplification": ("simplify",),
        "slot_order": ("put_in_slot_order",),
        "splats": ("InputError", "Splats", "concatenate"),
        "upright": ("find_up",),
    },
)
