"""Generated scenes of thin things, which fill little of a picture: wires, a fence, inlays."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rosplat_core.harmonics import C0
from rosplat_core.splats import Splats

Array = NDArray[np.floating[Any]]


def wires() -> Splats:
    """Eight wires that hang between two rows of poles, of uneven grey, and nothing else."""
    random = np.random.default_rng(0)
    number, along = np.divmod(np.arange(8 * 600), 600)
    along = (along + 0.5) / 300 - 1
    sag = 1 - (0.1 + 0.02 * number) * (1 - along**2)
    hanging = np.stack([2 * along, 0.3 * (number - 3.5), sag], axis=1)
    pole, up = np.divmod(np.arange(16 * 60), 60)
    poles = np.stack([2 - 4 * (pole % 2), 0.3 * (pole // 2 - 3.5), up / 60], axis=1)
    return _scene(
        np.concatenate([hanging, poles]),
        np.repeat([[0.005, 0.002, 0.002], [0.01, 0.01, 0.02]], [len(hanging), len(poles)], axis=0),
        np.concatenate([random.uniform(0.2, 0.5, len(hanging)), np.full(len(poles), 0.35)]),
    )


def fence() -> Splats:
    """Thin dark wires, across and upright, with bright inlays, above a bare ground."""
    random = np.random.default_rng(0)
    wires, pieces = 60, 80
    number, along = np.divmod(np.arange(wires * pieces), pieces)
    across = number % 2 == 1
    place = (number + 0.5) / wires - 0.5
    along = (along + 0.5) / pieces - 0.5
    wire = np.stack(
        [np.where(across, 4 * along, 4 * place), 0.02 * across,
         1 + np.where(across, 2 * place, 2 * along)], axis=1,
    )  # fmt: skip
    thin = np.full((len(wire), 3), 0.002)
    thin[np.arange(len(wire)), np.where(across, 0, 2)] = np.where(across, 0.025, 0.0125)
    grey = np.where(random.uniform(size=len(wire)) < 0.1, 0.9, 0.25)
    ground = np.hstack([random.uniform(-2.5, 2.5, (1500, 2)), np.zeros((1500, 1))])
    return _scene(
        np.concatenate([wire, ground]),
        np.concatenate([thin, np.tile([0.08, 0.08, 0.005], (1500, 1))]),
        np.concatenate([grey, random.uniform(0.2, 0.3, 1500)]),
    )


def inlays() -> Splats:
    """A dark, grained board with frets and small bright inlays on both of its faces."""
    random = np.random.default_rng(0)
    board = np.column_stack([random.uniform(-2, 2, 6000), random.uniform(-0.3, 0.3, 6000)])
    fret, across = np.divmod(np.arange(24 * 40), 40)
    frets = np.column_stack([fret / 6 - 1.92, (across - 19.5) / 66])
    dots = np.column_stack([random.uniform(-2, 2, 400), random.normal(0, 0.05, 400)])
    flat = [[0.03, 0.03, 0.003], [0.004, 0.01, 0.004], [0.006, 0.006, 0.003]]
    counts = [len(board), len(frets), len(dots)]
    heights = np.repeat([0.05, 0.058, 0.056], counts) * random.choice([-1, 1], sum(counts))
    return _scene(
        np.column_stack([np.concatenate([board, frets, dots]), heights]),
        np.repeat(flat, counts, axis=0),
        np.concatenate([random.uniform(0.1, 0.2, counts[0]), np.repeat([0.6, 0.95], counts[1:])]),
    )


THIN = {"wires": wires, "fence": fence, "inlays": inlays}


def _scene(positions: Array, scales: Array, values: Array) -> Splats:
    return Splats(
        positions,
        np.tile([0, 0, 0, 1.0], (len(values), 1)),
        scales,
        np.full(len(values), 0.9),
        np.repeat((values - 0.5) / C0, 3).reshape(-1, 1, 3),
        up=(0, 0, 1),
    )
