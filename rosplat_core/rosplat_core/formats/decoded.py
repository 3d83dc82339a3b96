"""What all readers end with: a file's numbers become splats that can be drawn."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rosplat_core.splats import Splats, rebase

Progress = Callable[[float], None]
Warn = Callable[[str], object]


Floats = NDArray[np.floating[Any]]

SH_C0 = 0.28209479177387814  # band 0 of the spherical harmonics: RGB is SH_C0 sh[0] + 0.5

# Splats decoded or encoded at a time: their columns stay in the cache, and take little memory.
BLOCK = 1 << 14


class Axes(NamedTuple):
    """Where the axes of a file's coordinates point."""

    text: str
    """For the user."""
    up: tuple[float, float, float] | None
    """The vertical, where the format fixes it."""


AS_TRAINED = Axes("the trainer's (with COLMAP, y mostly points down); the file doesn't tell", None)


def blocks(count: int, progress: Progress = lambda fraction: None) -> Iterator[slice]:
    """Slices that cover `count` splats, in order; tells progress how far they have come."""
    for start in range(0, count, BLOCK):
        yield slice(start, min(start + BLOCK, count))
        progress(min(start + BLOCK, count) / count)


def share(progress: Progress, begin: float, end: float) -> Progress:
    """The progress of what leads from one part of the whole to another."""
    return lambda part: progress(begin + part * (end - begin))


class Columns(NamedTuple):
    """The numbers of n splats as a file has them, in float32 but for positions."""

    positions: NDArray[np.float64]
    """(n, 3) means. [m]"""
    orientations: Floats
    """(n, 4) quaternions x, y, z, w of any length."""
    scales: Floats
    """(n, 3) standard deviations, linear. [m]"""
    opacities: Floats
    """(n,) 0 to 1."""
    sh: Floats
    """(n, k, 3) spherical harmonics."""

    @classmethod
    def empty(cls, n: int, k: int) -> Columns:
        """Room for n splats of k coefficients; scales are zero, for files that lack some."""
        return cls(
            np.empty((n, 3)),
            np.empty((n, 4), np.float32),
            np.zeros((n, 3), np.float32),
            np.empty(n, np.float32),
            np.empty((n, k, 3), np.float32),
        )

    def part(self, which: slice) -> Columns:
        """Some of the splats: what is written to these is written here."""
        return Columns(
            self.positions[which],
            self.orientations[which],
            self.scales[which],
            self.opacities[which],
            self.sh[which],
        )


def decoded(
    path: Path,
    warn: Warn,
    columns: Columns,
    antialiased: bool = False,
    channels: Mapping[str, Floats] = MappingProxyType({}),
) -> Splats:
    """Splats from a file's numbers; channels: (n,) each.

    Drops splats that hold a number that is not finite or a quaternion of length zero, and tells
    warn how many. The arrays are the callee's from then on.
    """
    positions, orientations, scales, opacities, sh = columns
    usable = np.empty(len(positions), bool)
    for part in blocks(len(positions)):
        lengths = np.linalg.norm(orientations[part], axis=1)
        orientations[part] /= lengths[:, None]
        # A sum is finite where all of its terms are.
        sums = positions[part].astype(np.float32).sum(axis=1) + lengths
        sums += scales[part].sum(axis=1) + opacities[part]
        usable[part] = np.isfinite(sums + sh[part].sum(axis=(1, 2), dtype=np.float64))
        usable[part] &= lengths > 0
    dropped = len(usable) - np.count_nonzero(usable)
    if dropped:
        warn(
            f"{path}: dropped {dropped:,} of {len(usable):,} splats: "
            "a number that is not finite, or a quaternion of length zero"
        )
        positions, orientations, scales = positions[usable], orientations[usable], scales[usable]
        opacities, sh = opacities[usable], sh[usable]
        channels = {name: values[usable] for name, values in channels.items()}
    offsets, origin = rebase(positions)
    return Splats(
        positions=offsets,
        orientations=orientations,
        scales=scales,
        opacities=opacities,
        sh=sh,
        origin=origin,
        antialiased=antialiased,
        channels=channels,
    )
