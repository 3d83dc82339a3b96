"""Fewer splats that look the same."""

from __future__ import annotations

from collections.abc import Sequence

from rosplat_core.cameras import Camera
from rosplat_core.splats import SceneError, Splats


def simplify(
    splats: Splats,
    *,
    psnr: float | None = None,
    max_splats: int | None = None,
    refine: float = 0.0,
    cameras: Sequence[Camera] | None = None,
    margin: float | None = None,
) -> Splats:
    """The fewest splats whose pictures have a PSNR of `psnr`, or at most `max_splats` of them.

    Neighbours that look most like one are merged, those first that views from in and around the map
    miss least. psnr: of other views together, against the map as it is [dB]. refine: how long what
    is left is then refitted to pictures of the map, which raises its PSNR [s]. cameras: a path, if
    only views along it matter: what is missed least there is left out. margin: how far from the
    path such views are at most [m], a quarter of the way to what is nearest to it by default.
    Raises SceneError unless either psnr or max_splats is given, above 0, and for an empty path.
    """
    from rosplat_core.simplification.search import Simplification  # scipy takes its time

    bound = psnr if max_splats is None else max_splats
    if bound is None or (psnr is None) == (max_splats is None) or not bound > 0:
        raise SceneError(f"simplify: give psnr or max_splats, above 0; got {psnr} and {max_splats}")
    work = Simplification(splats, path=cameras, margin=margin)
    if psnr is not None:
        work.shrink(psnr)
    elif max_splats is not None:
        work.reduce(max_splats)
    if refine > 0:
        work.refine(refine)
    return work.splats
