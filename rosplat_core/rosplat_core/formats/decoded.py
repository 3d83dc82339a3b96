"""The last step of all readers: a file's numbers become splats that can be drawn."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from rosplat_core import _core
from rosplat_core.log_text import shown
from rosplat_core.models import Model
from rosplat_core.payload import Arrays
from rosplat_core.slot_order import order_by_size
from rosplat_core.splats import InputError, PackedSplats, Splats, rebase

Progress = Callable[[float], None]
Warn = Callable[[str], object]


Floats = NDArray[np.floating[Any]]


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
    """The progress of a task that is the part from begin to end, 0 to 1, of a whole."""
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

    def part(self, which: slice | NDArray[np.bool_]) -> Columns:
        """Some of the splats; with a slice, views: a write to them is a write here."""
        return Columns._make(column[which] for column in self)


Made = TypeVar("Made", Splats, PackedSplats)


def told_model(path: Path, name: object) -> Model:
    """The model that a file names, EWA for None. Raises InputError for one that isn't known."""
    if name is None:
        return Model.EWA
    known = list(map(str, Model))
    if name not in known:
        raise InputError(f"{path}: model {shown(repr(name))} is none of {', '.join(known)}")
    return Model.of(str(name))


def told_as_trained(logarithms: bool, logits: bool) -> list[str]:
    """What to warn of, by as_trained."""
    told = {
        "scales are negative: logarithms": logarithms,
        "opacities are no shares: logits": logits,
    }
    return [f"most {text}, and taken for them" for text, is_so in told.items() if is_so]


def one_model(path: Path, models: Iterable[Model]) -> Model:
    """The model of all parts of a file, EWA without one. Raises InputError for several."""
    found = sorted(set(models))
    if len(found) > 1:
        raise InputError(f"{path}: its splats are of several models: {', '.join(map(str, found))}")
    return found[0] if found else Model.EWA


class Into(ABC, Generic[Made]):
    """Takes a file's numbers and makes splats of them, in one of several forms."""

    def blocks(
        self, n: int, k: int, progress: Progress = lambda fraction: None, size: int = BLOCK
    ) -> Iterator[tuple[slice, Columns]]:
        """Yields, for n splats of k coefficients, one slice after the other and room to fill."""
        for _, part, room in self.blocks_of([n], k, progress, size):
            yield part, room

    def blocks_of(
        self,
        counts: Sequence[int],
        k: int,
        progress: Progress = lambda fraction: None,
        size: int = BLOCK,
    ) -> Iterator[tuple[int, slice, Columns]]:
        """As blocks, for several sources; yields the source's index and a slice of its splats."""
        n = sum(counts)
        self._begin(n, k)
        first = 0
        for source, count in enumerate(counts):
            for part in blocks(count, size=size):
                whole = slice(first + part.start, first + part.stop)
                room = self._room(whole)
                yield source, part, room
                self._store(whole, room)
                progress(whole.stop / n)
            first += count

    def made(
        self,
        path: Path,
        warn: Warn,
        model: Model = Model.EWA,
        channels: Mapping[str, Floats] = MappingProxyType({}),
    ) -> Made:
        """The splats that were written. channels: (n,) each.

        Drops splats that hold a number that is not finite, a negative scale or a quaternion of
        length zero, and tells warn how many.
        """
        drops = told_drops(self._usable)
        if drops:
            warn(f"{path}: {drops}")
        kept = self._usable if drops else slice(None)
        return self._made(kept, model, {name: each[kept] for name, each in channels.items()})

    def make(
        self,
        path: Path,
        warn: Warn,
        columns: Columns,
        model: Model = Model.EWA,
        channels: Mapping[str, Floats] = MappingProxyType({}),
    ) -> Made:
        """As blocks and made, for all numbers at once. Takes over the arrays."""
        n, k = columns.sh.shape[:2]
        self._begin(n, k, columns)
        for part in blocks(n):
            self._store(part, columns.part(part))
        return self.made(path, warn, model, channels)

    def _begin(self, n: int, k: int, columns: Columns | None = None) -> None:
        """columns: all numbers, if they are there already."""
        self._usable = np.empty(n, bool)

    @abstractmethod
    def _room(self, part: slice) -> Columns: ...

    def _store(self, part: slice, written: Columns) -> None:
        self._usable[part] = usable(written)

    @abstractmethod
    def _made(
        self, kept: slice | NDArray[np.bool_], model: Model, channels: dict[str, Floats]
    ) -> Made: ...


class IntoSplats(Into[Splats]):
    """Splats as they are, in the order of the file."""

    def _begin(self, n: int, k: int, columns: Columns | None = None) -> None:
        super()._begin(n, k)
        self._columns = columns or Columns.empty(n, k)

    def _room(self, part: slice) -> Columns:
        return self._columns.part(part)

    def _made(
        self, kept: slice | NDArray[np.bool_], model: Model, channels: dict[str, Floats]
    ) -> Splats:
        positions, orientations, scales, opacities, sh = self._columns.part(kept)
        offsets, origin = rebase(positions)
        return Splats(
            positions=offsets,
            orientations=orientations,
            scales=scales,
            opacities=opacities,
            sh=sh,
            origin=origin,
            model=model,
            channels=channels,
        )


class IntoPacked(Into[PackedSplats]):
    """Packed splats, in the order of a map's slots; a block at a time, to spare memory."""

    def _begin(self, n: int, k: int, columns: Columns | None = None) -> None:
        super()._begin(n, k)
        self._positions = np.empty((n, 3))
        self._sizes = np.empty(n, np.float32)
        self._rows = np.empty((n, 8 + k), np.uint32)

    def _room(self, part: slice) -> Columns:
        return Columns.empty(part.stop - part.start, self._rows.shape[1] - 8)

    def _store(self, part: slice, written: Columns) -> None:
        super()._store(part, written)
        self._positions[part] = written.positions
        self._sizes[part] = written.scales.max(axis=1)
        near = written.positions.astype(np.float32)  # replaced once there is an origin
        self._rows[part] = _core.pack_splats(Arrays(near, *written[1:]), self._usable[part])

    def _made(
        self, kept: slice | NDArray[np.bool_], model: Model, channels: dict[str, Floats]
    ) -> PackedSplats:
        self._rows, sizes = self._rows[kept], self._sizes[kept]
        self._positions = self._positions[kept]
        positions, origin = rebase(self._positions)
        del self._positions
        self._rows[:, :3] = positions.view(np.uint32)
        degree = math.isqrt(self._rows.shape[1] - 8) - 1
        while degree > 0 and not self._rows[:, 8 + degree**2 :].any():
            degree -= 1
        rows = np.ascontiguousarray(self._rows[:, : 8 + (degree + 1) ** 2])
        del self._rows
        packed = PackedSplats(rows, degree, origin, model, channels)
        order = order_by_size(positions, sizes)
        for array in packed.arrays:
            _core.put_in_order(array, order)
        return packed


@np.errstate(all="ignore")  # what isn't finite is what it looks for
def usable(columns: Columns) -> NDArray[np.bool_]:
    """(n,) which splats can be drawn. Gives their quaternions unit length."""
    positions, orientations, scales, opacities, sh = columns
    lengths = np.linalg.norm(orientations, axis=1)
    orientations /= lengths[:, None]
    # A sum is finite where all of its terms are.
    sums = positions.astype(np.float32).sum(axis=1) + lengths + scales.sum(axis=1) + opacities
    kept: NDArray[np.bool_] = np.isfinite(sums + sh.sum(axis=(1, 2), dtype=np.float64))
    kept &= (lengths > 0) & (scales.min(axis=1) >= 0)
    return kept


def told_drops(kept: NDArray[np.bool_]) -> str:
    """How many splats are not usable, and what may be wrong with them; empty where all are."""
    dropped = len(kept) - np.count_nonzero(kept)
    if not dropped:
        return ""
    return (
        f"dropped {dropped:,} of {len(kept):,} splats: a number that is not finite, "
        "a negative scale (a logarithm?), or a quaternion of length zero"
    )
