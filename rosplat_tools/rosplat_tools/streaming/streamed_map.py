"""Holds the parts of a streamed scene that views need, within a budget. Knows no ROS."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from rosplat_core.formats.decoded import Warn
from rosplat_core.formats.streamed_sog import FileRange, Pieces, Streamed
from rosplat_core.posed_camera import PosedCamera
from rosplat_core.slot_pages import MAX_SLOTS
from rosplat_core.splats import InputError, Splats, concatenate
from rosplat_tools.streaming.detail import NOTHING, Levels, choose, errors, magnification
from rosplat_tools.streaming.slot_allocator import SlotAllocator, slots_for

Slots = NDArray[np.uint32]

THREADS = min(4, os.cpu_count() or 1)
AHEAD = 3 * THREADS  # levels of chunks that are read at a time
TOGETHER = 1 << 17  # splats that go into the map at once


class Sink(Protocol):
    """A living map: MapPublisher, say."""

    def expect(self, slots: int) -> None:
        """Announces how many slots are in use once all parts on their way have come."""

    def upsert(self, slots: Slots, splats: Splats) -> None:
        """Writes the i-th splat to the i-th slot."""

    def delete(self, slots: Slots) -> None:
        """Empties slots."""


@dataclass(frozen=True)
class _Held:
    part: FileRange
    slots: Slots
    splats: int
    """Number of slots in use, the first ones."""


class StreamedMap:
    """Moves towards the levels that `detail.choose` finds; threads read what is missing.

    A chunk's new level is in the map before its old one leaves it: there is never a hole. So
    the map may exceed the budget by the old levels of chunks that change at once.
    """

    def __init__(
        self, scene: Streamed, sink: Sink, *, budget: int, target: float, warn: Warn
    ) -> None:
        """budget: the most slots, in whole strips; target: small enough errors [px]."""
        largest = max(slots_for(part.count) for chunk in scene.chunks for part in chunk.levels)
        self._budget = min(budget, MAX_SLOTS - largest - TOGETHER)
        self._target = target
        self._scene = scene
        self._sink = sink
        self._pieces = Pieces(scene, warn)
        self._readers = ThreadPoolExecutor(THREADS, "reader")
        self._asked: dict[FileRange, Future[Splats]] = {}
        self._parts = [chunk.levels for chunk in scene.chunks]
        self._held: list[_Held | None] = [None] * len(scene.chunks)
        self._slots = SlotAllocator()
        self._to_come: dict[int, FileRange] = {}
        self._unfinished = False  # whether finer levels follow those of _to_come
        self._error = 0.0
        self._list()

    @property
    def least(self) -> int:
        """Slots that all chunks take at their coarsest."""
        return sum(slots_for(parts[0].count) for parts in self._parts if parts)

    @property
    def splats(self) -> int:
        """Number of splats in the map now."""
        return sum(held.splats for held in self._held if held)

    def __str__(self) -> str:
        chunks = sum(held is not None for held in self._held)
        text = (
            f"{self.splats:,} of {self._scene.splats:,} splats, {chunks:,} of "
            f"{len(self._held):,} chunks, splats at most {self._error:.3g} px apart where the "
            "scene has finer levels"
        )
        if not self._to_come:
            return text
        splats = sum(part.count for part in self._to_come.values())
        return f"{text}; on their way: {splats:,} splats of {len(self._to_come):,} chunks"

    def step(self, views: Sequence[PosedCamera], patience: float = 0.25) -> bool:
        """Reads what views need into the map, for `patience` [s]; returns whether more is to come.

        Raises InputError for a file that can't be read, which is not read again.
        """
        deadline = time.monotonic() + patience
        growing, shrinking = self._plan(views)
        self._to_come = growing | shrinking
        while self._to_come and (left := deadline - time.monotonic()) > 0:
            fitting = self._fitting(growing)
            self._ask([*fitting.values(), *shrinking.values(), *growing.values()])
            for chunk in self._insert_what_is_read(fitting | shrinking, left):
                growing.pop(chunk, None)
                shrinking.pop(chunk, None)
                del self._to_come[chunk]
        return bool(self._to_come) or self._unfinished

    def _plan(
        self, views: Sequence[PosedCamera]
    ) -> tuple[dict[int, FileRange], dict[int, FileRange]]:
        """The next levels of chunks that get finer, the most urgent first, and of coarser ones.

        Drops chunks that the budget has no more room for.
        """
        held = self._level
        scale = magnification(self._levels, views)
        wanted = np.array(choose(self._levels, scale, held, self._budget, self._target))
        finest = np.array([len(parts) - 1 for parts in self._parts])
        # Of each chunk at its level now; 0 if there is no finer one.
        error = errors(self._levels, scale)[np.arange(len(held)), 1 + held]
        error[held >= finest] = 0
        self._error = float(error.max(initial=0.0))

        dropped = np.flatnonzero((wanted == NOTHING) & (held != NOTHING)).tolist()
        urgent = np.argsort(-error, kind="stable")
        finer = urgent[(wanted > held)[urgent]].tolist()
        coarser = np.flatnonzero((wanted < held) & (wanted != NOTHING)).tolist()
        growing, shrinking = (
            {chunk: self._parts[chunk][wanted[chunk]] for chunk in chunks}
            for chunks in (finer, coarser)
        )
        change = sum(part.count for part in (*growing.values(), *shrinking.values()))
        leaving = (self._held[chunk] for chunk in (*finer, *coarser, *dropped))
        self._sink.expect(self.splats + change - sum(held.splats for held in leaving if held))
        self._put({}, dict.fromkeys(dropped))
        # A missing chunk is a hole, so it begins with its coarsest level, which is soon read.
        missing = [chunk for chunk in finer if held[chunk] == NOTHING and wanted[chunk] > 0]
        self._unfinished = bool(missing)
        growing |= {chunk: self._parts[chunk][0] for chunk in missing}
        return growing, shrinking

    def close(self) -> None:
        """Ends the threads that read."""
        self._pieces.close()
        self._readers.shutdown(cancel_futures=True)

    def _fitting(self, growing: dict[int, FileRange]) -> dict[int, FileRange]:
        """The first chunks that the budget has room for now."""
        room = self._budget - self._slots.slots
        fitting = {}
        for chunk, part in growing.items():
            held = self._held[chunk]
            room -= slots_for(part.count) - (slots_for(held.part.count) if held else 0)
            if room < 0:
                break
            fitting[chunk] = part
        return fitting

    def _ask(self, parts: list[FileRange]) -> None:
        """Has the first AHEAD parts read, and cancels others."""
        first = dict.fromkeys(parts[:AHEAD])
        for part in self._asked.keys() - first.keys():
            self._asked.pop(part).cancel()
        for part in first:
            if part not in self._asked:
                self._asked[part] = self._readers.submit(self._pieces.read, part)

    def _insert_what_is_read(self, parts: dict[int, FileRange], patience: float) -> list[int]:
        """Waits for levels of chunks to be read, puts them in, and returns the chunks."""
        asked = {chunk: part for chunk, part in parts.items() if part in self._asked}
        wait({self._asked[part] for part in asked.values()}, patience, FIRST_COMPLETED)
        ready: dict[int, Splats] = {}
        failed: InputError | None = None
        for chunk, part in asked.items():
            reading = self._asked.get(part)  # none of a file that was given up
            if not reading or not reading.done() or sum(map(len, ready.values())) >= TOGETHER:
                continue
            try:
                ready[chunk] = reading.result()
            except InputError as error:
                self._give_up(part.file)
                failed = error
        self._put(ready, {chunk: parts[chunk] for chunk in ready})
        for chunk in ready:
            self._asked.pop(parts[chunk], None)
        if failed:
            raise failed
        return list(ready)

    def _put(self, ready: dict[int, Splats], parts: Mapping[int, FileRange | None]) -> None:
        """Puts in levels of chunks, or takes chunks out whose part is None."""
        before = [held.slots for chunk in parts if (held := self._held[chunk])]
        for chunk, part in parts.items():
            self._held[chunk] = None
            if part:
                slots = self._slots.allocate(part.count)
                self._held[chunk] = _Held(part, slots, len(ready[chunk]))
        if ready:
            now = [held.slots[: held.splats] for chunk in ready if (held := self._held[chunk])]
            self._sink.upsert(np.concatenate(now), concatenate(list(ready.values())))
        if before:
            slots = np.concatenate(before)
            self._sink.delete(slots)
            self._slots.give_back(slots)
        for chunk in parts:
            self._level[chunk] = self._level_of(chunk)

    def _level_of(self, chunk: int) -> int:
        held = self._held[chunk]
        parts = self._parts[chunk]
        return parts.index(held.part) if held and held.part in parts else NOTHING

    def _give_up(self, file: int) -> None:
        """Does without the levels of a file; held ones stay until replaced or dropped."""
        self._asked = {part: asked for part, asked in self._asked.items() if part.file != file}
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
        self._level = np.array([self._level_of(chunk) for chunk in range(len(self._held))])
