"""Generated scenes of thin things, which fill little of a picture: wires, a fence, inlays."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from rosplat_core.harmonics import C0
from rosplat_core.splats import Splats


def wires() -> Splats:
    """Eight wires that hang between two rows of poles, of uneven grey, and nothing else."""
    number, along = np.divmod(np.arange(8 * 600), 600)
    along = (along + 0.5) / 300 - 1
    sag = 1 - (0.1 + 0.02 * number) * (1 - along**2)
    pole, up = np.divmod(np.arange(16 * 60), 60)
    grey = np.random.default_rng(0).uniform(0.2, 0.5, len(along))
    return _scene(
        ([2 * along, 0.3 * (number - 3.5), sag], (0.005, 0.002, 0.002), grey),
        ([2 - 4 * (pole % 2), 0.3 * (pole // 2 - 3.5), up / 60], (0.01, 0.01, 0.02), 0.35),
    )


def fence() -> Splats:
    """Thin dark wires, across and upright, with bright inlays, above a bare ground."""
    random = np.random.default_rng(0)
    number, along = np.divmod(np.arange(60 * 80), 80)
    across = number % 2 == 1
    place = (number + 0.5) / 60 - 0.5
    along = (along + 0.5) / 80 - 0.5
    thin = np.full((len(along), 3), 0.002)
    thin[np.arange(len(along)), np.where(across, 0, 2)] = np.where(across, 0.025, 0.0125)
    grey = np.where(random.uniform(size=len(along)) < 0.1, 0.9, 0.25)
    x, z = np.where(across, 4 * along, 4 * place), 1 + np.where(across, 2 * place, 2 * along)
    ground = random.uniform(-2.5, 2.5, (1500, 2)).T
    return _scene(
        ([x, 0.02 * across, z], thin, grey),
        ([*ground, np.zeros(1500)], (0.08, 0.08, 0.005), random.uniform(0.2, 0.3, 1500)),
    )


def inlays() -> Splats:
    """A dark, grained board with frets and small bright inlays on both of its faces."""
    random = np.random.default_rng(0)
    board = random.uniform(-2, 2, 6000), random.uniform(-0.3, 0.3, 6000)
    fret, across = np.divmod(np.arange(24 * 40), 40)
    dots = random.uniform(-2, 2, 400), random.normal(0, 0.05, 400)
    face = np.split(random.choice([-1, 1], 7360), (6000, 6960))
    grain = random.uniform(0.1, 0.2, 6000)
    return _scene(
        ([*board, 0.05 * face[0]], (0.03, 0.03, 0.003), grain),
        ([fret / 6 - 1.92, (across - 19.5) / 66, 0.058 * face[1]], (0.004, 0.01, 0.004), 0.6),
        ([*dots, 0.056 * face[2]], (0.006, 0.006, 0.003), 0.95),
    )


def _scene(*parts: tuple[list[ArrayLike], ArrayLike, ArrayLike]) -> Splats:
    """Of parts: x, y and z, scales, and how bright they are."""
    places = [np.stack(place, axis=1) for place, _, _ in parts]
    count = sum(map(len, places))
    scales = [
        np.broadcast_to(part[1], place.shape) for part, place in zip(parts, places, strict=True)
    ]
    values = [
        np.broadcast_to(part[2], len(place)) for part, place in zip(parts, places, strict=True)
    ]
    sh = np.repeat((np.concatenate(values) - 0.5) / C0, 3).reshape(count, 1, 3).astype(np.float32)
    turns, opacities = np.tile([0, 0, 0, 1.0], (count, 1)), np.full(count, 0.9)
    return Splats(
        np.concatenate(places), turns, np.concatenate(scales), opacities, sh, up=(0, 0, 1)
    )


THIN = {"wires": wires, "fence": fence, "inlays": inlays}
