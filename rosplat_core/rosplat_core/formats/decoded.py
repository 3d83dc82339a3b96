"""What all readers end with: a file's numbers become splats that can be drawn."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from rosplat_core import _core
from rosplat_core.payload import Arrays
from rosplat_core.slot_order import order_by_size
from rosplat_core.splats import PackedSplats, Splats, rebase

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


def blocks(
    count: int, progress: Progress = lambda fraction: None, size: int = BLOCK
) -> Iterator[slice]:
    """Slices that cover `count` splats, in order; tells progress how far they have come."""
    for start in range(0, count, size):
        yield slice(start, min(start + size, count))
        progress(min(start + size, count) / count)


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

    @classmethod
    def of(cls, splats: Splats) -> Columns:
        """The arrays of splats, but for their positions."""
        return cls(splats.positions + splats.origin, *splats.arrays[1:5])

    def part(self, which: slice) -> Columns:
        """Some of the splats: what is written to these is written here."""
        return Columns(
            self.positions[which],
            self.orientations[which],
            self.scales[which],
            self.opacities[which],
            self.sh[which],
        )


Made = TypeVar("Made", Splats, PackedSplats)


class Into(ABC, Generic[Made]):
    """What a file's numbers become."""

    @abstractmethod
    def blocks(
        self, n: int, k: int, progress: Progress = lambda fraction: None, size: int = BLOCK
    ) -> Iterator[tuple[slice, Columns]]:
        """Room for some of n splats of k coefficients after the other, to be written to."""

    @abstractmethod
    def made(
        self,
        path: Path,
        warn: Warn,
        antialiased: bool = False,
        channels: Mapping[str, Floats] = MappingProxyType({}),
    ) -> Made:
        """What was written; channels: (n,) each.

        Drops splats that hold a number that is not finite or a quaternion of length zero, and tells
        warn how many.
        """

    def make(self, path: Path, warn: Warn, columns: Columns, antialiased: bool = False) -> Made:
        """The same of all numbers at once. The arrays are the callee's from then on."""
        for part, room in self.blocks(*columns.sh.shape[:2]):
            for to, numbers in zip(room, columns.part(part), strict=True):
                to[:] = numbers
        return self.made(path, warn, antialiased)


class IntoSplats(Into[Splats]):
    """Splats as they are, in the order of the file."""

    def blocks(
        self, n: int, k: int, progress: Progress = lambda fraction: None, size: int = BLOCK
    ) -> Iterator[tuple[slice, Columns]]:
        """As Into."""
        self._columns = Columns.empty(n, k)
        for part in blocks(n, progress, size):
            yield part, self._columns.part(part)

    def made(
        self,
        path: Path,
        warn: Warn,
        antialiased: bool = False,
        channels: Mapping[str, Floats] = MappingProxyType({}),
    ) -> Splats:
        """As Into."""
        positions, orientations, scales, opacities, sh = columns = self._columns
        usable = np.empty(len(positions), bool)
        for part in blocks(len(positions)):
            usable[part] = _usable(columns.part(part))
        if _drops(path, warn, usable):
            positions, orientations = positions[usable], orientations[usable]
            scales, opacities, sh = scales[usable], opacities[usable], sh[usable]
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

    def make(self, path: Path, warn: Warn, columns: Columns, antialiased: bool = False) -> Splats:
        """As Into."""
        self._columns = columns
        return self.made(path, warn, antialiased)


class IntoPacked(Into[PackedSplats]):
    """Packed splats, in the order of a map's slots; a block at a time, to spare memory."""

    def blocks(
        self, n: int, k: int, progress: Progress = lambda fraction: None, size: int = BLOCK
    ) -> Iterator[tuple[slice, Columns]]:
        """As Into."""
        self._positions = np.empty((n, 3))
        self._sizes = np.empty(n, np.float32)
        self._usable = np.empty(n, bool)
        self._rows = np.empty((n, 8 + k), np.uint32)
        for part in blocks(n, progress, size):
            columns = Columns.empty(part.stop - part.start, k)
            yield part, columns
            usable = self._usable[part] = _usable(columns)
            self._positions[part] = columns.positions
            self._sizes[part] = columns.scales.max(axis=1)
            near = columns.positions.astype(np.float32)  # until there is an origin
            self._rows[part] = _core.pack_splats(Arrays(near, *columns[1:]), usable)

    def made(
        self,
        path: Path,
        warn: Warn,
        antialiased: bool = False,
        channels: Mapping[str, Floats] = MappingProxyType({}),
    ) -> PackedSplats:
        """As Into."""
        usable = self._usable
        if _drops(path, warn, usable):
            self._rows, self._sizes = self._rows[usable], self._sizes[usable]
            self._positions = self._positions[usable]
            channels = {name: values[usable] for name, values in channels.items()}
        positions, origin = rebase(self._positions)
        del self._positions
        self._rows[:, :3] = positions.view(np.uint32)
        degree = math.isqrt(self._rows.shape[1] - 8) - 1
        while degree > 0 and not self._rows[:, 8 + degree**2 :].any():
            degree -= 1
        rows = np.ascontiguousarray(self._rows[:, : 8 + (degree + 1) ** 2])
        del self._rows
        packed = PackedSplats(rows, degree, origin, antialiased, dict(channels))
        order = order_by_size(positions, self._sizes)
        for array in packed.arrays:
            _core.put_in_order(array, order)
        return packed


def _usable(columns: Columns) -> NDArray[np.bool_]:
    """(n,) which splats can be drawn. Gives their quaternions unit length."""
    positions, orientations, scales, opacities, sh = columns
    lengths = np.linalg.norm(orientations, axis=1)
    orientations /= lengths[:, None]
    # A sum is finite where all of its terms are.
    sums = positions.astype(np.float32).sum(axis=1) + lengths + scales.sum(axis=1) + opacities
    usable: NDArray[np.bool_] = np.isfinite(sums + sh.sum(axis=(1, 2), dtype=np.float64))
    usable &= lengths > 0
    return usable


def _drops(path: Path, warn: Warn, usable: NDArray[np.bool_]) -> bool:
    dropped = len(usable) - np.count_nonzero(usable)
    if dropped:
        warn(
            f"{path}: dropped {dropped:,} of {len(usable):,} splats: "
            "a number that is not finite, or a quaternion of length zero"
        )
    return bool(dropped)
