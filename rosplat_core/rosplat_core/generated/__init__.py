"""Procedural scenes of any size, the same for the same arguments: a garden, or a flat of rooms."""

from __future__ import annotations

from dataclasses import replace
from numbers import Integral
from pathlib import Path

import numpy as np

from rosplat_core.formats.decoded import Into, IntoSplats, Made, Progress
from rosplat_core.generated.garden import Garden
from rosplat_core.generated.rooms import Rooms
from rosplat_core.generated.surfaces import quaternions
from rosplat_core.slot_pages import MAX_SLOTS
from rosplat_core.splats import MAX_SH_DEGREE, InputError, Splats

SCENES: dict[str, type[Garden] | type[Rooms]] = {"garden": Garden, "rooms": Rooms}

UP = (0.0, 0.0, 1.0)  # REP-103
BLOCK = 1 << 18  # splats made at a time, which bounds the memory of float64 intermediates


def generate(
    count: int,
    seed: int = 0,
    sh_degree: int = 3,
    progress: Progress = lambda part: None,
    scene: str = "garden",
) -> Splats:
    """Makes one of SCENES of exactly count splats, the same for the same arguments.

    Their order is random, as a trained map's is: any part of them shows all of the scene, thinner.
    progress is called with 0 to 1; what it raises ends the work. Raises InputError for a count
    below 1 or beyond what a map holds, a seed below 0, or an sh_degree outside 0 to 3.
    """
    return generate_into(IntoSplats(), count, seed, sh_degree, progress, scene)


def generate_into(
    into: Into[Made], count: int, seed: int, sh_degree: int, progress: Progress, scene: str
) -> Made:
    """As generate, with splats of the kind that `into` makes."""
    if scene not in SCENES:
        raise InputError(f"scene is {scene!r}, expected {' or '.join(SCENES)}")
    if not isinstance(count, Integral):
        raise InputError(f"count is {count!r}, expected a whole number")
    if not 1 <= count <= MAX_SLOTS:
        raise InputError(f"count is {count:,}, expected 1 to {MAX_SLOTS:,}, as many as a map holds")
    if seed < 0:
        raise InputError(f"seed is {seed}, expected 0 or more")
    if not 0 <= sh_degree <= MAX_SH_DEGREE:
        raise InputError(f"SH degree is {sh_degree}, expected 0 to {MAX_SH_DEGREE}")
    rng = np.random.default_rng(seed)
    shares, makers = zip(*SCENES[scene](rng).parts(), strict=True)
    ends = np.round(np.cumsum(shares) * count).astype(int)
    starts = np.concatenate([[0], ends[:-1]])

    k = (sh_degree + 1) ** 2
    numbers = rng.permutation(count)
    for block, columns in into.blocks(count, k, progress, BLOCK):
        block_numbers = numbers[block]
        parts = np.searchsorted(ends, block_numbers, side="right")
        for part, make in enumerate(makers):
            slots = np.flatnonzero(parts == part)
            if len(slots):
                total = int(ends[part] - starts[part])
                patch = make(block_numbers[slots] - starts[part], total)
                columns.positions[slots] = patch.points
                columns.orientations[slots] = quaternions(patch.tangents, patch.normals)
                columns.scales[slots] = patch.scales
                columns.opacities[slots] = patch.opacities
                columns.sh[slots] = patch.sh[:, :k]
    return replace(into.made(Path(scene), lambda text: None), up=UP)
