"""Publishes complete maps, as trainers write them, by their differences."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rosplat_core.slot_order import slot_order
from rosplat_core.splats import Splats, check_splats
from rosplat_ros.map_publisher import MapPublisher

_DRAWN = ("positions", "orientations", "scales", "opacities", "sh")


@dataclass(frozen=True)
class _Shown:
    """A map as it was sent: its splats, their ids, and their slots."""

    splats: Splats
    """(n,) by id, a copy: authors reuse their arrays."""
    ids: NDArray[np.int64]
    """(n,) ascending."""
    slots: NDArray[np.intp]
    """(n,) by id."""
    frame_id: str


class WholeMaps:
    """If you only have complete maps, pass each to `show`: it sends the differences.

    A splat keeps its slot while its id exists. Free slots are used again. So arrays may shrink,
    grow and change their order from one map to the next.
    """

    def __init__(self, publisher: MapPublisher) -> None:
        """Sends nothing yet. Nobody else may edit the publisher's map."""
        self._publisher = publisher
        self._shown: _Shown | None = None

    def show(self, splats: Splats, ids: ArrayLike | None = None) -> int:
        """Makes splats the map; returns how many splats were sent.

        ids: (n,) integers that identify splats from map to map, by default their rows. Raises
        ValueError if an id is there twice, and what MapPublisher raises.
        """
        check_splats(splats)
        ids = _checked(np.arange(len(splats)) if ids is None else np.asarray(ids), len(splats))
        rows = np.argsort(ids)
        ids = ids[rows]
        if np.any(ids[1:] == ids[:-1]):
            raise ValueError("ids: one is there twice")
        shown, self._shown = self._shown, None  # where sending fails, all is sent the next time
        sent = self._edit(shown, splats, ids, rows) if shown else None
        if sent is None:
            sent = self._replace(splats, ids, rows)
        return sent

    def _replace(self, splats: Splats, ids: NDArray[np.int64], rows: NDArray[np.intp]) -> int:
        order = _order(splats)
        self._publisher.replace(splats[order])
        slots = np.empty(len(order), np.intp)
        slots[order] = np.arange(len(order))
        self._shown = _Shown(splats[rows], ids, slots[rows], self._publisher.frame_id)
        return len(splats)

    def _edit(
        self, before: _Shown, splats: Splats, ids: NDArray[np.int64], rows: NDArray[np.intp]
    ) -> int | None:
        """Sends the splats that differ; returns how many, or None if that can't be or most do."""
        if splats.model != before.splats.model or np.any(splats.origin != before.splats.origin):
            return None
        _, old, same = np.intersect1d(before.ids, ids, assume_unique=True, return_indices=True)
        differs = np.ones(len(ids), bool)
        differs[same] = _differ(before.splats, old, splats, rows[same])
        if np.count_nonzero(differs) > len(ids) // 2:
            return None
        new = np.delete(np.arange(len(ids)), same)
        new = new[_order(splats[rows[new]])]
        gone = np.sort(np.delete(before.slots, old))
        used = np.zeros(before.slots.max(initial=-1) + 1 + len(new), bool)
        used[before.slots[old]] = True
        free = np.flatnonzero(~used)[: len(new)]
        slots = np.empty(len(ids), np.intp)
        slots[same], slots[new] = before.slots[old], free
        emptied = np.setdiff1d(gone, free, assume_unique=True)
        changed = np.flatnonzero(differs)
        moved = self._publisher.frame_id != before.frame_id
        if len(emptied) or (moved and not len(changed)):  # any batch carries the map's frame
            self._publisher.delete(emptied)
        if len(changed):
            self._publisher.upsert(slots[changed], splats[rows[changed]])
        self._shown = _Shown(splats[rows], ids, slots, self._publisher.frame_id)
        return len(changed)


def _order(splats: Splats) -> NDArray[np.intp]:
    """The order of a map's slots; splats that aren't finite come last."""
    placed = np.isfinite(splats.positions).all(axis=1) & np.isfinite(splats.scales).all(axis=1)
    if placed.all():
        return slot_order(splats)
    rows = np.flatnonzero(placed)
    return np.concatenate([rows[slot_order(splats[rows])], np.flatnonzero(~placed)])


def _checked(ids: NDArray[np.generic], n: int) -> NDArray[np.int64]:
    if ids.shape != (n,):
        raise ValueError(f"ids: expected shape {(n,)}, got {ids.shape}")
    if n and not np.issubdtype(ids.dtype, np.integer):  # NumPy makes floats of an empty list
        raise ValueError(f"ids: expected integers, got {ids.dtype}")
    return ids.astype(np.int64)  # larger ids wrap, and stay different


def _differ(
    before: Splats, old: NDArray[np.intp], after: Splats, new: NDArray[np.intp]
) -> NDArray[np.bool_]:
    """(n,) whether row old[i] of one map differs from row new[i] of the other.

    Compares bits, so that NaN equals NaN.
    """
    degree = max(before.sh_degree, after.sh_degree)
    a, b = before.with_sh_degree(degree), after.with_sh_degree(degree)
    names = {*a.channels, *b.channels}
    pairs = [(getattr(a, name), getattr(b, name)) for name in _DRAWN]
    pairs += [(a.channel(name), b.channel(name)) for name in names]
    differs = np.zeros(len(old), bool)
    for one, other in pairs:
        unlike = one[old].view(np.uint32) != other[new].view(np.uint32)
        differs |= unlike.any(axis=tuple(range(1, unlike.ndim)))
    return differs
