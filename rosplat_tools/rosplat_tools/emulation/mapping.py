"""The edits by which a SLAM back end would arrive at a scene. Knows no ROS."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rosplat_tools.splats import Splats

DRIFT = 0.01  # how far off a rough Gaussian begins, as a part of the scene's size


@dataclass(frozen=True, eq=False)
class Edit:
    """Writes splats to slots, or empties the slots where splats is None."""

    slots: range | NDArray[np.integer]
    splats: Splats | None


def around(splats: Splats) -> Splats:
    """The splats in the order in which a camera that circles the scene comes by them.

    The circle lies in the plane in which the bulk of the scene extends most.
    """
    if not len(splats):
        return splats
    away = splats.positions - np.median(splats.positions, axis=0).astype(np.float64)
    distance = np.linalg.norm(away, axis=1)
    bulk = away[distance <= np.quantile(distance, 0.9)]
    _, axes = np.linalg.eigh(bulk.T @ bulk)
    angle = np.arctan2(away @ axes[:, 1], away @ axes[:, 2])
    return splats[np.argsort(angle, kind="stable")]


def edits(
    scene: Splats, *, batch_size: int, refine_fraction: float, prune_fraction: float, seed: int
) -> Iterator[Edit]:
    """Edits of batch_size Gaussians at most that end in exactly scene, in slots 0 to n - 1.

    The map grows in the scene's order. refine_fraction of the Gaussians begin a little off and are
    moved to their place later; prune_fraction are deleted later, and come back after that. Raises
    ValueError for a batch_size under 1 or fractions that are negative or add up to more than 1.
    """
    if batch_size < 1:
        raise ValueError(f"batch_size is {batch_size}, expected 1 or more")
    if min(refine_fraction, prune_fraction) < 0 or refine_fraction + prune_fraction > 1:
        raise ValueError(
            f"refine_fraction, prune_fraction are {refine_fraction}, {prune_fraction}, "
            "expected 0 or more, and 1 at most together"
        )
    return _edits(scene, batch_size, refine_fraction, prune_fraction, np.random.default_rng(seed))


def _edits(
    scene: Splats, size: int, refine: float, prune: float, rng: np.random.Generator
) -> Iterator[Edit]:
    if not len(scene):
        return
    low, high = np.quantile(scene.positions, [0.05, 0.95], axis=0)
    drift = DRIFT * float(np.linalg.norm(high - low))
    rough, doubtful, deleted = (np.zeros(0, np.int64) for _ in range(3))
    for start in range(0, len(scene), size):
        slots = np.arange(start, min(start + size, len(scene)))
        fate = rng.random(len(slots))
        is_rough = fate < refine
        splats = scene[slots]
        off = rng.normal(scale=drift, size=(len(slots), 3)) * is_rough[:, None]
        positions = (splats.positions + off).astype(np.float32)
        yield Edit(range(start, start + len(slots)), replace(splats, positions=positions))
        last = start + size >= len(scene)
        rough = np.append(rough, slots[is_rough])
        doubtful = np.append(doubtful, slots[~is_rough & (fate < refine + prune)])
        while len(rough) >= size or (last and len(rough)):
            batch, rough = np.split(rough, [size])
            yield Edit(batch, scene[batch])
        while len(doubtful) >= size or (last and len(doubtful)):
            if len(deleted):
                yield Edit(deleted, scene[deleted])
            deleted, doubtful = np.split(doubtful, [size])
            yield Edit(deleted, None)
    if len(deleted):
        yield Edit(deleted, scene[deleted])
