"""The edits by which a SLAM back end would arrive at a scene. Knows no ROS."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rosplat_core.slot_pages import SLOTS_PER_PAGE
from rosplat_core.splats import Splats
from rosplat_core.view import frame_at

DRIFT = 0.01  # how far off a rough Gaussian begins, as a part of the scene's size


@dataclass(frozen=True, eq=False)
class Edit:
    """Writes splats of a group to slots, or empties the slots where splats is None."""

    slots: range | NDArray[np.integer]
    splats: Splats | None
    group: int = 0


@dataclass(frozen=True, eq=False)
class Move:
    """Places groups: rigid transforms, float64 (4, 4)."""

    poses: dict[int, NDArray[np.float64]]


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


def with_keyframes(splats: Splats, batch_size: int) -> Splats:
    """The splats with a channel keyframe: the number, from 0, of the batch that each is in."""
    keyframes = (np.arange(len(splats)) // batch_size).astype(np.float32)
    return replace(splats, channels={**splats.channels, "keyframe": keyframes})


def edits(
    scene: Splats,
    *,
    batch_size: int,
    refine_fraction: float,
    prune_fraction: float,
    seed: int,
    submaps: int = 1,
) -> Iterator[Edit | Move]:
    """Edits of batch_size Gaussians at most that end in exactly scene, its order kept.

    The map grows in the scene's order. refine_fraction of the Gaussians begin a little off and are
    moved to their place later; prune_fraction are deleted later, and come back after that. The
    scene is cut into submaps, each a group in slots of its own, which drift ever farther away:
    once the last is there, a loop closure puts all of them right. Raises ValueError for a
    batch_size or submaps under 1, or fractions that are negative or add up to more than 1.
    """
    if batch_size < 1:
        raise ValueError(f"batch_size is {batch_size}, expected 1 or more")
    if submaps < 1:
        raise ValueError(f"submaps is {submaps}, expected 1 or more")
    if min(refine_fraction, prune_fraction) < 0 or refine_fraction + prune_fraction > 1:
        raise ValueError(
            f"refine_fraction, prune_fraction are {refine_fraction}, {prune_fraction}, "
            "expected 0 or more, and 1 at most together"
        )
    rng = np.random.default_rng(seed)
    return _edits(scene, submaps, batch_size, refine_fraction, prune_fraction, rng)


def _edits(
    scene: Splats, submaps: int, size: int, refine: float, prune: float, rng: np.random.Generator
) -> Iterator[Edit | Move]:
    if not len(scene):
        return
    low, high = np.quantile(scene.positions, [0.05, 0.95], axis=0)
    drift = DRIFT * float(np.linalg.norm(high - low))
    pose = np.eye(4)
    begin = first_slot = 0
    for group in range(submaps):
        end = len(scene) * (group + 1) // submaps
        part = scene[begin:end]
        if group:
            pose = pose @ _step(part, drift, rng)
            yield Move({group: pose})
        for edit in _grown(part, drift, size, refine, prune, rng):
            slots = (
                range(edit.slots.start + first_slot, edit.slots.stop + first_slot)
                if isinstance(edit.slots, range)
                else edit.slots + first_slot
            )
            yield Edit(slots, edit.splats, group)
        begin = end
        first_slot += -(-len(part) // SLOTS_PER_PAGE) * SLOTS_PER_PAGE
    if submaps > 1:
        yield Move({group: np.eye(4) for group in range(1, submaps)})


def _step(splats: Splats, drift: float, rng: np.random.Generator) -> NDArray[np.float64]:
    """A small random turn about the splats' middle and a small random shift, (4, 4). [m]"""
    middle = np.median(splats.positions, axis=0).astype(np.float64) if len(splats) else np.zeros(3)
    turn = frame_at(rng.normal(scale=drift, size=3), (*rng.normal(scale=DRIFT, size=3), 1.0))
    step: NDArray[np.float64] = frame_at(middle) @ turn @ frame_at(-middle)
    return step


def _grown(
    scene: Splats, drift: float, size: int, refine: float, prune: float, rng: np.random.Generator
) -> Iterator[Edit]:
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
