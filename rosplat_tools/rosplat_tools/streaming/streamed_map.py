"""A map that holds of a streamed scene what views of it need, within a budget. Knows no ROS."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from rosplat_sorter.camera import Camera
from rosplat_sorter.slot_pages import MAX_SLOTS
from rosplat_tools.formats.decoded import Progress, Warn
from rosplat_tools.formats.streamed_sog import Part, Pieces, Streamed
from rosplat_tools.splats import SceneError, Splats
from rosplat_tools.streaming.detail import NOTHING, Levels, choose, errors, magnification, slots_for
from rosplat_tools.streaming.slot_allocator import SlotAllocator

Slots = NDArray[np.uint32]


class Sink(Protocol):
    """A living map: MapPublisher, say."""

    def upsert(self, slots: Slots, splats: Splats) -> None:
        """Writes the i-th splat to the i-th slot."""

    def delete(self, slots: Slots) -> None:
        """Empties slots."""


@dataclass(frozen=True)
class _Held:
    part: Part
    slots: Slots


class StreamedMap:
    """Moves towards the levels that `detail.choose` finds, a file of the scene at a time.

    A chunk's new level is in the map before its old one leaves it: there is never a hole. Beyond
    the budget the map has one level of one chunk at most, while it changes places.
    """

    def __init__(
        self, scene: Streamed, sink: Sink, *, budget: int, target: float, warn: Warn
    ) -> None:
        """budget: the most slots, in whole pages; target: small enough errors [px]."""
        largest = max(slots_for(part.count) for chunk in scene.chunks for part in chunk.levels)
        self._budget = min(budget, MAX_SLOTS - largest)
        self._target = target
        self._scene = scene
        self._sink = sink
        self._pieces = Pieces(scene, warn)
        self._parts = [chunk.levels for chunk in scene.chunks]
        self._held: list[_Held | None] = [None] * len(scene.chunks)
        self._slots = SlotAllocator()
        self._to_come = 0
        self._error = 0.0
        self._list()

    @property
    def least(self) -> int:
        """Slots that all chunks take at their coarsest."""
        return sum(slots_for(parts[0].count) for parts in self._parts if parts)

    @property
    def splats(self) -> int:
        """In the map now."""
        return sum(held.part.count for held in self._held if held)

    def __str__(self) -> str:
        chunks = sum(held is not None for held in self._held)
        text = (
            f"{self.splats:,} of {self._scene.splats:,} splats, {chunks:,} of "
            f"{len(self._held):,} chunks, splats at most {self._error:.3g} px apart where finer "
            "ones are to be had"
        )
        return f"{text}; {self._to_come:,} chunks to come" if self._to_come else text

    def step(self, views: Sequence[Camera], progress: Progress = lambda fraction: None) -> bool:
        """Takes what one file has to give to views; returns whether there was anything to do.

        progress is told how far the file is read; what it raises ends the work, the map stays
        sound. Raises SceneError for a file that can't be read, which is not read again.
        """
        scale = magnification(self._levels, views)
        held = [
            parts.index(held.part) if held and held.part in parts else NOTHING
            for parts, held in zip(self._parts, self._held, strict=True)
        ]
        wanted = choose(self._levels, scale, held, self._budget, self._target)
        found = errors(self._levels, scale)
        self._error = max(
            (
                found[chunk][level + 1]
                for chunk, level in enumerate(held)
                if level + 1 < len(self._parts[chunk])
            ),
            default=0.0,
        )
        changes = [chunk for chunk in range(len(held)) if wanted[chunk] != held[chunk]]
        for chunk in changes:
            if wanted[chunk] == NOTHING:
                self._drop(chunk)
        changes = [chunk for chunk in changes if wanted[chunk] != NOTHING]
        self._to_come = len(changes)
        if not changes:
            return False
        # What is worst first; but where it doesn't fit yet, what makes room.
        changes.sort(key=lambda chunk: found[chunk][held[chunk] + 1], reverse=True)
        shrinking = [chunk for chunk in changes if wanted[chunk] < held[chunk]]
        growing = [chunk for chunk in changes if wanted[chunk] > held[chunk]]
        fits = growing and self._fits(growing[0], self._parts[growing[0]][wanted[growing[0]]])
        first = (growing if fits or not shrinking else shrinking)[0]
        file = self._parts[first][wanted[first]].file
        for chunk in [first, *shrinking, *growing]:
            part = self._parts[chunk][wanted[chunk]]
            if part.file != file or self._has(chunk, part):
                continue
            if chunk == first or wanted[chunk] < held[chunk] or self._fits(chunk, part):
                try:
                    splats = self._pieces.read(part, progress)
                except SceneError:
                    self._give_up(file)
                    raise
                self._put(chunk, part, splats)
        return True

    def _fits(self, chunk: int, part: Part) -> bool:
        held = self._held[chunk]
        more = slots_for(part.count) - (slots_for(held.part.count) if held else 0)
        return self._slots.slots + more <= self._budget

    def _has(self, chunk: int, part: Part) -> bool:
        held = self._held[chunk]
        return held is not None and held.part == part

    def _put(self, chunk: int, part: Part, splats: Splats) -> None:
        slots = self._slots.take(part.count)
        before = self._held[chunk]
        self._sink.upsert(slots, splats)
        self._held[chunk] = _Held(part, slots)
        self._empty(before)

    def _drop(self, chunk: int) -> None:
        before, self._held[chunk] = self._held[chunk], None
        self._empty(before)

    def _empty(self, held: _Held | None) -> None:
        if held:
            self._sink.delete(held.slots)
            self._slots.give_back(held.slots)

    def _give_up(self, file: int) -> None:
        """Does without the levels that a file has; what is held of it stays as long as it may."""
        self._parts = [
            tuple(
                part
                for part in parts
                if part.file != file or (held is not None and held.part == part)
            )
            for parts, held in zip(self._parts, self._held, strict=True)
        ]
        self._list()

    def _list(self) -> None:
        self._levels = Levels(
            np.array([chunk.low for chunk in self._scene.chunks]),
            np.array([chunk.high for chunk in self._scene.chunks]),
            [tuple(part.count for part in parts) for parts in self._parts],
        )
