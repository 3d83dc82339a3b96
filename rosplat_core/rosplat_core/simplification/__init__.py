"""Simplification: fewer splats that look the same."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from numbers import Integral, Real

import numpy as np

from rosplat_core.cameras import Camera, check_cameras
from rosplat_core.formats.decoded import Columns, told_drops, usable
from rosplat_core.program.progress import watched_tasks
from rosplat_core.splats import InputError, Splats, check_splats

_log = logging.getLogger(__name__)


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

    Leaves out the splats that views of the map miss least, or merges neighbours that look most
    like one splat. psnr: what 95 % of the views reach against the given map, where that shows; new
    views check it, and those that miss it are learnt from, three times at most [dB]. refine: time
    for refitting the splats that are left to pictures of the map, which raises the PSNR [s].
    cameras: a path, if only views along it matter; splats that these miss least are left out.
    margin: most distance of such views from the path [m], by default a quarter of the way to the
    nearest splats. A terminal shows a bar. Splats that can't be drawn are dropped, with a warning
    in the log, as loading drops them. Raises InputError for an empty map or path, a number of
    another kind, a negative margin, and unless exactly one of psnr and max_splats is given, above
    0.
    """
    from rosplat_core.simplification.search import Simplification  # scipy takes its time

    check_splats(splats, "simplify: splats")
    check_cameras(() if cameras is None else cameras)
    for name, value, kind, expected in (
        ("max_splats", max_splats, Integral, "a whole number"), ("psnr", psnr, Real, "dB"),
        ("margin", margin, Real, "metres"), ("refine", refine, Real, "seconds"),
    ):  # fmt: skip
        if value is not None and not isinstance(value, kind):
            raise InputError(f"simplify: {name} is {value!r}, expected {expected}")
    bound = psnr if max_splats is None else max_splats
    if bound is None or (psnr is None) == (max_splats is None) or not bound > 0:
        raise InputError(f"simplify: give psnr or max_splats, above 0; got {psnr} and {max_splats}")
    if margin is not None and not margin >= 0:
        raise InputError(f"simplify: margin is {margin}, expected a distance in metres, 0 or more")
    splats = _drawn(splats)
    if not len(splats):
        raise InputError("simplify: the map has no splats")
    with watched_tasks() as tell:
        work = Simplification(splats, tell, cameras, margin)
        if psnr is not None:
            work.shrink(psnr)
        elif max_splats is not None:
            work.reduce(max_splats)
        if refine > 0:
            work.refine(refine)
    return work.splats


def _drawn(splats: Splats) -> Splats:
    """The splats that can be drawn; the log says how many can't."""
    columns = Columns(
        splats.positions.astype(np.float64), splats.orientations.copy(), splats.scales,
        splats.opacities, splats.sh,
    )  # fmt: skip
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        kept = usable(columns)
    if drops := told_drops(kept):
        _log.warning("simplify: %s", drops)
        return splats[kept]
    return splats
