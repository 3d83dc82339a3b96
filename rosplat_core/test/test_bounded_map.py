"""A map under a budget: what views need is published, and comes back as it was."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from rosplat_core import _core, bounded_map
from rosplat_core.bounded_map import BoundedMap
from rosplat_core.cameras import Camera, look_at
from rosplat_core.maps import MOVE, REPLACE, UPSERT, PublishedBatch
from rosplat_core.rendering import MOST_PSNR, psnr_of
from rosplat_core.splats import PackedSplats, Splats

Maker = Callable[..., Splats]
BLOCK = 1024
COUNT = 300  # splats of a group
MOST = COUNT * 3 // 2
ROW = 36  # bytes of a splat without harmonics


class Receiver:
    """A bounded map, and what receivers hold of it: a group and a row by slot."""

    def __init__(self, most: int = MOST) -> None:
        self.rows: dict[int, tuple[int, bytes]] = {}
        self.most = self.blocks = 0
        self.broken = False
        self.map = BoundedMap(10**6, "none", self._send, print, lambda: None, most)

    def _send(self, batch: PublishedBatch) -> None:
        if self.broken:
            raise RuntimeError("no wire")
        self.take(batch)
        self.most = max(self.most, len(self.rows))
        self.blocks = max(self.blocks, *(1 + slot // BLOCK for slot in self.rows), 0)

    def take(self, batch: PublishedBatch) -> None:
        slots = batch.slots if len(batch.slots) else batch.first_slot + np.arange(batch.count)
        rows = batch.payload.tobytes()
        if batch.operation == REPLACE:
            self.rows.clear()
        for i, slot in enumerate(slots.tolist()):
            if batch.operation in (REPLACE, UPSERT):
                self.rows[slot] = batch.group, rows[ROW * i : ROW * (i + 1)]
            elif batch.operation != MOVE:
                self.rows.pop(slot, None)

    def write(self, group: int, splats: Splats) -> None:
        self.map.upsert(BLOCK * group, splats, group, None)

    def of(self, group: int) -> set[bytes]:
        """The rows of a group."""
        return {row for owner, row in self.rows.values() if owner == group}


@pytest.fixture
def receiver(random_splats: Maker, monkeypatch: pytest.MonkeyPatch) -> Receiver:
    """Of three groups, 20 m apart, and a budget for one and a half; each view is looked from."""
    monkeypatch.setattr(bounded_map, "REST", 0)
    receiver = Receiver()
    for group in range(3):
        receiver.write(group, random_splats(COUNT, 0, seed=group))
        receiver.map.move({group: (20.0 * group, 0, 0, 0, 0, 0, 1)}, None)
    return receiver


def packed(splats: Splats) -> PackedSplats:
    rows = _core.pack_splats(splats, np.ones(len(splats), bool))
    return PackedSplats(rows, splats.sh_degree, splats.origin, splats.model, splats.channels)


def rows_of(splats: Splats) -> set[bytes]:
    return {row.tobytes() for row in packed(splats).rows}


def camera(eye: tuple[float, float, float], target: tuple[float, float, float]) -> Camera:
    return Camera(0, 160, 120, 150, 150, 80, 60, look_at(eye, target))


def view(group: int) -> Camera:
    """Sees one group and no other."""
    return camera((20 * group, -8, 0), (20 * group, 0, 0))


def test_new_splats_are_published_at_once(receiver: Receiver, random_splats: Maker) -> None:
    assert receiver.of(2) == rows_of(random_splats(COUNT, 0, seed=2))
    assert receiver.most == len(receiver.rows) == MOST
    assert len(receiver.map) == 3 * COUNT


def test_what_a_view_needs_returns_to_the_bit(receiver: Receiver) -> None:
    receiver.map.look_from(view(0))
    seen = receiver.of(0)
    for group in (1, 2, 1, 2):
        receiver.map.look_from(view(group))
    left = seen - receiver.of(0)
    receiver.map.look_from(view(0))
    assert len(left & receiver.of(0)) > 20
    assert receiver.of(0) <= seen
    assert receiver.most == len(receiver.rows) == MOST


def test_the_newest_view_looks_like_the_whole_map(receiver: Receiver) -> None:
    assert np.isnan(receiver.map.psnr())
    for group in (0, 2, *[1] * 20):
        receiver.map.look_from(view(group))
    whole, told = (bounded_map._Client(each) for each in (receiver.map._whole, receiver.map._told))
    whole.update()
    told.update()
    pictures = [client.renderer.render(view(1)) for client in (told, whole)]
    error = bounded_map._error(*pictures)
    assert error < 1e-4
    assert receiver.map.psnr() == pytest.approx(psnr_of(error), abs=0.1)
    receiver.map.look_from(view(0))
    assert receiver.map.psnr() < psnr_of(error)


def test_a_group_that_moves_into_view_is_published(receiver: Receiver) -> None:
    receiver.map.look_from(view(0))
    receiver.map.move({0: (0, 0, 60, 0, 0, 0, 1), 1: (0, 0, 0, 0, 0, 0, 1)}, None)
    receiver.map.look_from(view(0))
    assert len(receiver.of(1)) > COUNT / 2


def test_all_return_once_there_is_room(receiver: Receiver) -> None:
    receiver.map.look_from(view(2))
    receiver.map.erase(np.arange(BLOCK, BLOCK + COUNT, dtype=np.uint32), None)
    receiver.map.erase_from(0, COUNT // 2, None)
    receiver.map.look_from(view(2))
    assert len(receiver.rows) == len(receiver.map) == COUNT * 3 // 2
    assert receiver.map.psnr() == MOST_PSNR


def test_edits_are_heard_of_what_is_published(receiver: Receiver, random_splats: Maker) -> None:
    receiver.map.look_from(view(0))
    others = random_splats(COUNT, 0, seed=9)
    before, count = receiver.of(0), len(receiver.of(0))
    receiver.write(0, others)
    assert len(receiver.of(0)) == count
    assert not receiver.of(0) & before
    assert receiver.of(0) <= rows_of(others)
    others.opacities[:] = np.nan  # none can be drawn
    receiver.write(0, others)
    assert not receiver.of(0)
    receiver.map.look_from(view(1))
    assert len(receiver.rows) == MOST


def test_splats_in_slots_of_others_are_new(receiver: Receiver, random_splats: Maker) -> None:
    for _ in range(3):
        receiver.map.look_from(view(2))
    receiver.map.erase_from(0, COUNT, None)
    others = random_splats(COUNT, 0, seed=7)
    receiver.map.append(others, 0, None)
    assert receiver.of(0) == rows_of(others)


def test_a_replaced_map_is_looked_at_anew(receiver: Receiver, random_splats: Maker) -> None:
    receiver.map.look_from(view(1))
    splats = random_splats(2 * COUNT, 0, seed=5)
    splats.positions[COUNT // 2 :, 0] += 20
    receiver.map.replace(packed(splats), None, None)
    first = rows_of(splats[:MOST])
    assert receiver.of(0) == first
    receiver.map.look_from(view(1))
    assert len(receiver.of(0) - first) > 20
    assert len(receiver.rows) == MOST


def test_receivers_need_little_more_memory_than_the_budget(
    random_splats: Maker, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a map of 40 blocks in 10 groups, of which views need parts."""
    monkeypatch.setattr(bounded_map, "REST", 0)
    receiver = Receiver(5 * BLOCK)
    for group in range(10):
        receiver.map.append(random_splats(4 * BLOCK, 0, seed=group), group, None)
        receiver.map.move({group: (20.0 * group, 0, 0, 0, 0, 0, 1)}, None)
        receiver.map.look_from(view(group))
    for group in (0, 5, 9):
        receiver.map.look_from(view(group))
        assert len(receiver.rows) == 5 * BLOCK
        late = Receiver()
        block = 0
        while True:
            batches, block = receiver.map.pull(receiver.map.map_id, 0, block, 3)
            for batch in batches:
                late.take(batch)
            if not block:
                break
        assert late.rows == receiver.rows
    assert receiver.blocks <= 2 * 5 + 10
    assert receiver.most == 5 * BLOCK


def test_a_map_that_could_not_be_sent_is_sent_with_the_next_edit(
    receiver: Receiver, random_splats: Maker
) -> None:
    splats = random_splats(100, 0, seed=3)
    receiver.broken = True
    with pytest.raises(RuntimeError, match="no wire"):
        receiver.map.replace(splats, None, None)
    receiver.broken = False
    receiver.map.look_from(view(0))
    assert receiver.of(0) == rows_of(splats)


def test_views_of_nothing_are_harmless(random_splats: Maker) -> None:
    receiver = Receiver(10)
    assert receiver.map.look_from(view(0))
    assert receiver.map.psnr() == MOST_PSNR
    receiver.map._rests_until = 0
    receiver.write(0, random_splats(30, 0))
    receiver.map.look_from(camera((0, -8, 0), (0, -9, 0)))
    assert len(receiver.rows) == 10


def test_views_take_a_part_of_the_time(receiver: Receiver, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bounded_map, "REST", 1000)
    assert receiver.map.look_from(view(0))
    assert not receiver.map.look_from(view(1))
