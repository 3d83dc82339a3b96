"""What differs between two states of a map that is given whole each time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rosplat_tools.map_publisher import MapPublisher
from rosplat_tools.space_order import space_order
from rosplat_tools.splats import Splats


class WholeMaps:
    """Publishes a map that its author gives whole again and again, as edits where that is less.

    A splat keeps its slot as long as it keeps its row. The first map's rows are put in space order,
    later rows behind them.
    """

    def __init__(self, publisher: MapPublisher) -> None:
        """Nothing is sent yet. The publisher's map must be changed by nobody else."""
        self._publisher = publisher
        self._order: NDArray[np.intp] = np.zeros(0, np.intp)  # of rows, by slot
        self._shown: Splats | None = None  # by slot

    def show(self, splats: Splats) -> int:
        """Makes splats the map; returns how many were sent. Raises as MapPublisher does."""
        shown, order = self._shown, self._order
        if shown is None or not _continues(shown, splats):
            shown, order = None, order[:0]
        known = len(order)
        order = np.concatenate([order, known + space_order(splats.positions[known:])])
        splats = splats[order]
        changed = np.arange(len(splats)) if shown is None else _differing(shown, splats)
        self._shown = None  # where sending fails, all is sent the next time
        if len(changed) > len(splats) // 2:
            self._publisher.replace(splats)
            changed = np.arange(len(splats))
        elif len(changed):
            self._publisher.upsert(changed, splats[changed])
        self._shown, self._order = splats, order
        return len(changed)


def _continues(before: Splats, after: Splats) -> bool:
    """Whether rows may still be those that they were: a trainer that prunes moves them."""
    return (
        len(after) >= len(before)
        and np.array_equal(after.origin, before.origin)
        and after.antialiased == before.antialiased
    )


def _differing(before: Splats, after: Splats) -> NDArray[np.intp]:
    """The rows of `after` that `before` lacks, or has otherwise."""
    common, degree = len(before), max(before.sh_degree, after.sh_degree)
    a, b = before.with_sh_degree(degree), after[:common].with_sh_degree(degree)
    differs = a.opacities != b.opacities
    for name in ("positions", "orientations", "scales", "sh"):
        other = getattr(a, name) != getattr(b, name)
        differs |= other.reshape(common, -1).any(axis=1)
    return np.concatenate([np.flatnonzero(differs), np.arange(common, len(after))])
