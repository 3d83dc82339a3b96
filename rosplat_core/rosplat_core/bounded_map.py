"""A published map of which receivers hold no more than a budget: what the robot's views need most.

How it works:

1. Each view is drawn once from the whole map. What a splat is worth in it is the geometric mean of
   how many pixels it fills and how much the picture changes without it.
2. A splat's value is the largest worth that it had in any view: of recent ones, each of which
   counts for less by FADING with every later one, and LASTING of that of all views ever. Splats
   that are published count STAYS times, so that few are exchanged for little.
3. The budget's number of splats with the highest values is published. New ones come first until a
   view tells what they are worth.
4. Receivers keep memory for each block of slots that they ever heard of. So published splats have
   slots of their own, which are used again; where a group's blocks are less than half full, the
   splats of the emptiest move into the others.

So what the robot looks at comes first, then what it just saw, then what it will see when it
returns. docs/experiments.md has the rules that were compared.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from threading import RLock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rosplat_core.cameras import Camera, resized
from rosplat_core.maps import Arrival, PublishedBatch, PublishedMap, received
from rosplat_core.models import Model
from rosplat_core.rendering import Contributions, CpuRenderer, posed, psnr_of
from rosplat_core.slot_pages import MAX_SLOTS, SLOTS_PER_PAGE
from rosplat_core.splats import PackedSplats, Splats

PIXELS = 320 * 240  # of a view, at most
FADING = 0.8
LASTING = np.float32(0.03)
STAYS = np.float32(1.25)
REST = 3  # times as long as a view took: no more than a quarter of the time goes into views
LAST = 4  # views that tell what the budget costs
LEAST_SHOWN = 0.01  # of a picture, as in simplification
LEAST = np.float32(1e-30)  # value of a splat that no view has shown, but could have
NEW = np.float32(1e30)  # of one that was written before the last ones, and since the last view
NONE = -1

Slots = NDArray[np.integer]
When = tuple[int, int] | None


class BoundedMap:
    """As PublishedMap, but that receivers hold `budget` splats at most, in slots of their own.

    Calls may come from any thread.
    """

    def __init__(
        self,
        chunk_bytes: int,
        compression: str,
        send: Callable[[PublishedBatch], None],
        warn: Callable[[str], None],
        settle: Callable[[], None],
        budget: int,
    ) -> None:
        """budget: the most splats of receivers. Raises ValueError for what makes no sense."""
        if not 1 <= budget <= MAX_SLOTS:
            raise ValueError(f"budget: a number from 1 to {MAX_SLOTS}, got {budget}")
        self._whole = PublishedMap(chunk_bytes, "none", lambda batch: None, warn, lambda: None)
        self._told = PublishedMap(chunk_bytes, compression, send, lambda text: None, settle)
        self._most = budget
        self._begun = True  # whether receivers know that the map was replaced
        self._expected = 0
        # By slot: the group, the slot of receivers, and values, infinite of the newest.
        self._group = self._place = np.zeros(0, np.int32)
        self._recent = self._ever = np.zeros(0, np.float32)
        # By slot of receivers, and by block of these: whose splat is there, and of which group.
        self._owner, self._block_group = np.zeros(0, np.int32), np.zeros(0, np.int32)
        self._drawn, self._sums = _Client(self._whole), Contributions()
        self._views: deque[Camera] = deque(maxlen=LAST)
        self._rests_until = 0.0
        self._lock = RLock()
        # What concerns receivers alone.
        self.revision, self.pull, self.repeat = (
            self._told.revision, self._told.pull, self._told.repeat
        )  # fmt: skip
        self.groups = self._whole.groups
        self.published = self._told.__len__

    @property
    def map_id(self) -> str:
        """Of receivers' map."""
        return self._told.map_id

    def __len__(self) -> int:
        return len(self._whole)

    # --- Edits ------------------------------------------------------------------------------------

    def replace(self, splats: Splats | PackedSplats, expected: int | None, when: When) -> None:
        """As PublishedMap's; the first splats are published until a view needs others."""
        with self._lock:
            self._whole.replace(splats, expected, when)
            self._expected = len(self._whole) if expected is None else expected
            self._begun = False
            self._group = np.zeros(len(splats), np.int32)
            self._place = np.full(len(splats), NONE, np.int32)
            self._recent = np.linspace(2 * NEW, NEW, len(splats), dtype=np.float32)
            self._ever = np.zeros(len(splats), np.float32)
            self._spend(when)

    def expect(self, slots: int) -> None:
        """As PublishedMap's, of the whole map."""
        self._told.expect(min(slots, self._most))

    def upsert(
        self, slots: int | Slots, splats: Splats | PackedSplats, group: int, when: When
    ) -> None:
        """As PublishedMap's. Receivers hear of hidden slots when they are published."""
        with self._lock:
            self._whole.upsert(slots, splats, group, when)
            self._written(_listed(slots, len(splats)), group, when)

    def append(self, splats: Splats | PackedSplats, group: int, when: When) -> NDArray[np.uint32]:
        """As PublishedMap's."""
        with self._lock:
            slots: NDArray[np.uint32] = self._whole.append(splats, group, when)
            self._written(slots, group, when)
        return slots

    def erase_from(self, first: int, count: int, when: When) -> None:
        """As PublishedMap's."""
        with self._lock:
            self._whole.erase_from(first, count, when)
            self._forget(np.arange(first, min(first + count, len(self._group))), when)

    def erase(self, slots: NDArray[np.uint32], when: When) -> None:
        """As PublishedMap's."""
        with self._lock:
            self._whole.erase(slots, when)
            self._forget(slots[slots < len(self._group)].astype(np.intp), when)

    def move(self, poses: Mapping[Any, Sequence[float]], when: When) -> None:
        """As PublishedMap's."""
        with self._lock:
            self._whole.move(poses, when)
            self._told.move(poses, when)

    # --- Views ------------------------------------------------------------------------------------

    def look_from(self, camera: Camera) -> bool:
        """Learns what a view needs, and publishes what the last views need most.

        Returns False, and does nothing, if it rests from the last view.
        """
        view = resized(camera, PIXELS)
        with self._lock:
            began = time.monotonic()
            if began < self._rests_until:
                return False
            self._views.append(view)
            self._drawn.update()
            self._drawn.renderer.contribute(posed(view), self._sums)
            slots, pixels, _, changes = self._sums.take_seen()
            new = self._recent >= NEW
            self._recent[new], self._ever[new] = 0, LEAST
            self._recent *= FADING
            worth = np.sqrt(pixels * changes)
            for values in (self._recent, self._ever):
                values[slots] = np.maximum(values[slots], worth)
            self._spend(None)
            now = time.monotonic()
            self._rests_until = now + REST * (now - began)
            return True

    def psnr(self) -> float:
        """PSNR of the published map's pictures against the whole map's, at the last views. [dB]

        Over what shows the whole map. NaN before the first view.
        """
        with self._lock:
            if not self._views:
                return float("nan")
            told = _Client(self._told)
            for client in (told, self._drawn):
                client.update()
            errors = [
                _error(told.renderer.render(view), self._drawn.renderer.render(view))
                for view in self._views
            ]
        return psnr_of(float(np.mean(errors)))

    # --- What is published ------------------------------------------------------------------------

    def _written(self, slots: Slots, group: int, when: When) -> None:
        """Publishes slots of the whole map that were written, if they are published or new."""
        if not len(slots):
            return
        more = max(0, int(slots.max()) + 1 - len(self._group))
        self._group, self._place = (
            np.pad(values, (0, more), constant_values=NONE) for values in (self._group, self._place)
        )
        self._recent, self._ever = (
            np.pad(values, (0, more)) for values in (self._recent, self._ever)
        )
        new = slots[self._ever[slots] == 0]
        self._group[slots] = group
        published = slots[self._place[slots] != NONE]
        if len(published):
            self._write(published, self._place[published], group, when)
        if len(new):
            self._recent[self._recent >= NEW] = NEW
            self._recent[new] = np.inf
            self._spend(when)

    def _forget(self, slots: Slots, when: When) -> None:
        """Takes slots out, which are empty in the whole map."""
        self._hide(slots[self._place[slots] != NONE], when)
        self._group[slots], self._recent[slots], self._ever[slots] = NONE, 0, 0

    def _spend(self, when: When) -> None:
        """Publishes the budget's number of splats with the highest values."""
        if not self._begun:
            self._told.replace(_NOTHING, min(self._expected, self._most), when)
            self._owner, self._block_group = np.zeros(0, np.int32), np.zeros(0, np.int32)
            self._begun = True
            poses: Mapping[Any, Sequence[float]] = self._whole.poses()
            self._told.move(poses, when)
        published = self._place != NONE
        best = self._group != NONE
        if (over := int(best.sum()) - self._most) > 0:
            values = self._recent + LASTING * self._ever
            values[published] *= STAYS
            used = np.flatnonzero(best)
            best[used[np.argpartition(values[used], over)[:over]]] = False
        self._hide(np.flatnonzero(published & ~best), when)
        self._close_up(when)
        coming = np.flatnonzero(best & ~published)
        groups = self._group[coming]
        for group in np.unique(groups).tolist():
            slots = coming[groups == group]
            self._write(slots, self._free(group, len(slots)), group, when)

    def _hide(self, slots: Slots, when: When) -> None:
        """Takes slots off receivers."""
        if len(slots):
            places = self._place[slots]
            self._place[slots] = NONE
            self._empty(places, when)

    def _empty(self, places: Slots, when: When) -> None:
        """Empties slots of receivers; others may use blocks that are empty then."""
        self._owner[places] = NONE
        blocks = np.unique(places // SLOTS_PER_PAGE)
        empty = (self._owner.reshape(-1, SLOTS_PER_PAGE)[blocks] == NONE).all(axis=1)
        self._block_group[blocks[empty]] = NONE
        self._told.erase(places.astype(np.uint32), when)

    def _write(self, slots: Slots, places: Slots, group: int, when: When) -> None:
        """Writes slots of a group to slots of receivers."""
        batch = self._whole.copy(slots.astype(np.uint32), group)
        held = batch.slots if len(batch.slots) else _listed(batch.first_slot, batch.count)
        if len(held) < len(slots):  # splats that can't be drawn
            known = np.isin(slots, held)
            self._forget(slots[~known], when)
            slots, places = slots[known], places[known]
            if not len(slots):
                return
        self._place[slots], self._owner[places] = places, slots
        self._block_group[places // SLOTS_PER_PAGE] = group
        splats = PackedSplats(
            batch.payload.view(np.uint32).reshape(batch.count, -1),
            batch.sh_degree,
            np.array(batch.origin),
            Model(batch.model),
            dict(zip(batch.channel_names, batch.channels.reshape(-1, batch.count), strict=True)),
        )
        self._told.upsert(places.astype(np.uint32), splats, group, when)

    def _free(self, group: int, count: int) -> Slots:
        """Free slots of receivers: in the fullest blocks of a group, then in empty ones."""
        own = np.flatnonzero(self._block_group == group)
        own = own[np.argsort(-self._fill(own), kind="stable")]
        free = self._holes(own)
        blocks = -(-max(0, count - len(free)) // SLOTS_PER_PAGE)
        more = blocks - int((self._block_group == NONE).sum())
        if more > 0:
            self._owner = np.pad(self._owner, (0, more * SLOTS_PER_PAGE), constant_values=NONE)
            self._block_group = np.pad(self._block_group, (0, more), constant_values=NONE)
        empty = np.flatnonzero(self._block_group == NONE)[:blocks]
        return np.append(free, self._holes(empty))[:count]

    def _fill(self, blocks: Slots) -> Slots:
        """(n,) how many slots of receivers' blocks are in use."""
        fill: Slots = (self._owner.reshape(-1, SLOTS_PER_PAGE)[blocks] != NONE).sum(axis=1)
        return fill

    def _holes(self, blocks: Slots) -> Slots:
        """The free slots of receivers' blocks, block by block."""
        block, at = np.nonzero(self._owner.reshape(-1, SLOTS_PER_PAGE)[blocks] == NONE)
        return blocks[block] * SLOTS_PER_PAGE + at

    def _close_up(self, when: When) -> None:
        """Empties the emptiest blocks of groups whose blocks are less than half full.

        What moves is there twice for a moment, so it is as many as the budget has room for.
        """
        for group in np.unique(self._block_group[self._block_group != NONE]).tolist():
            own = np.flatnonzero(self._block_group == group)
            fill = self._fill(own)
            if 2 * fill.sum() >= SLOTS_PER_PAGE * (len(own) - 1):
                continue
            own = own[np.argsort(-fill, kind="stable")]
            kept, rest = np.split(own, [-(-int(fill.sum()) // SLOTS_PER_PAGE)])
            places = (rest[::-1, None] * SLOTS_PER_PAGE + np.arange(SLOTS_PER_PAGE)).ravel()
            places = places[self._owner[places] != NONE][: self._most - self.published()]
            if len(places):
                try:
                    self._write(self._owner[places], self._holes(kept)[: len(places)], group, when)
                finally:
                    self._empty(places, when)


_NOTHING = Splats(
    positions=np.zeros((0, 3), np.float32),
    orientations=np.zeros((0, 4), np.float32),
    scales=np.zeros((0, 3), np.float32),
    opacities=np.zeros(0, np.float32),
    sh=np.zeros((0, 1, 3), np.float32),
)


class _Client:
    """A renderer that pulls a map as receivers do, without harmonics beyond band 0."""

    def __init__(self, published: PublishedMap) -> None:
        self.renderer = CpuRenderer()
        self._published = published
        self._revision = 0

    def update(self) -> None:
        """Takes what has changed since the last update."""
        first, block = 0, 0
        while True:
            batches, block = self._published.pull(self._published.map_id, self._revision, block, 0)
            for batch in batches:
                self.renderer.apply(received(batch), Arrival.PULLED)
                first = first or batch.revision
            if not block:
                break
        self._revision = first  # what was edited between two answers comes again


def _listed(slots: Any, count: int) -> Slots:
    """Slots as an array, that of the first of them for consecutive ones."""
    return np.arange(slots, slots + count) if np.ndim(slots) == 0 else np.asarray(slots, np.intp)


def _error(picture: NDArray[np.float32], whole: NDArray[np.float32]) -> float:
    """Mean square error of a picture over the area that the whole map covers."""
    differs = (picture[..., :3].clip(0, 1) - whole[..., :3].clip(0, 1)).ravel()
    area = max(float(whole[..., 3].sum()), LEAST_SHOWN * whole[..., 3].size)
    return float(differs @ differs) / (3 * area)
