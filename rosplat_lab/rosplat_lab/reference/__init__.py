"""A reference renderer in plain float64 NumPy: what every fast path is held against.

The semantics are those of the INRIA rasteriser (Kerbl et al. 2023) as gsplat 1.5.3 spells them out.
Written to be read, yet half a million splats in 1280x720 take but some seconds.
"""

from rosplat_lab.reference.renderer import Picture, contributions, dealt, pick, render

__all__ = ["Picture", "contributions", "dealt", "pick", "render"]
