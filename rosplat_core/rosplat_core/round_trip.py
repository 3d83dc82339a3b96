"""What a format's quantisation does to a scene: error by field, splat by splat."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rosplat_core.formats.decoded import Floats, blocks
from rosplat_core.harmonics import C0 as SH_C0
from rosplat_core.models import Model
from rosplat_core.splats import Splats

QUANTILES = (0.5, 0.99, 1.0)


def errors(before: Splats, after: Splats) -> dict[str, NDArray[np.float64]]:
    """(n,) errors of each splat, by field and unit. Both must have the same splats in one order."""
    degree = max(before.sh_degree, after.sh_degree)
    names = ["position [m]", "scale [%]", "rotation [deg]", "opacity", "color"]
    names += ["harmonics"] if degree else []
    found = {name: np.empty(len(before)) for name in names}
    for part in blocks(len(before)):
        old, new = before[part].with_sh_degree(degree), after[part].with_sh_degree(degree)
        differ = np.abs(old.sh.astype(np.float64) - new.sh).max(axis=2)
        moved = old.positions.astype(np.float64) - new.positions + (old.origin - new.origin)
        found["position [m]"][part] = np.linalg.norm(moved, axis=1)
        least = np.finfo(np.float32).tiny  # in place of a flat splat's 0
        ratios = np.maximum(new.scales, least) / np.maximum(old.scales, least).astype(np.float64)
        sides = 2 if before.model is Model.DISC else 3  # a disc's third means nothing
        found["scale [%]"][part] = 100 * np.abs(ratios - 1)[:, :sides].max(axis=1)
        found["rotation [deg]"][part] = np.degrees(_angles(old.orientations, new.orientations))
        found["opacity"][part] = np.abs(old.opacities - new.opacities)
        found["color"][part] = SH_C0 * differ[:, 0]
        if degree:
            found["harmonics"][part] = differ[:, 1:].max(axis=1)
    return found


def report(before: Splats, after: Splats) -> str:
    """A table of the errors' quantiles; splats must be in one order."""
    if len(before) != len(after):
        return f"read back: {len(after):,} of {len(before):,} splats"
    lines = [f"{'read back, error':<18}" + "".join(f"{_percent(q):>11}" for q in QUANTILES)]
    for name, values in errors(before, after).items():
        quantiles = np.quantile(values, QUANTILES)
        lines.append(f"{name:<18}" + "".join(f"{value:11.3g}" for value in quantiles))
    return "\n".join(lines)


def _angles(a: Floats, b: Floats) -> NDArray[np.float64]:
    """(n,) angles between rotations, exact for small ones too. [rad]"""
    a = a.astype(np.float64)
    chords = np.minimum(np.linalg.norm(a - b, axis=1), np.linalg.norm(a + b, axis=1))
    angles: NDArray[np.float64] = 4 * np.arcsin(np.minimum(chords / 2, 1))
    return angles


def _percent(quantile: float) -> str:
    return {0.5: "median", 1.0: "most"}.get(quantile, f"{100 * quantile:g} %")
