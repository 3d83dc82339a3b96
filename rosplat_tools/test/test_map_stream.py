"""What a stream of edits adds up to: publisher, sorter, latecomers and a dictionary agree."""

from __future__ import annotations

import contextlib
from collections import deque
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from rosplat_msgs.msg import GaussianArray
from rosplat_sorter.edits import EMPTY, decode
from rosplat_sorter.map import SplatMap
from rosplat_sorter.slot_pages import MixedGroupsError
from rosplat_sorter.view import frame_at
from rosplat_tools.map_publisher import MapPublisher
from rosplat_tools.splats import Splats

BLOCK = GaussianArray.SLOTS_PER_BLOCK
KINDS = ("upsert", "upsert", "upsert", "delete", "delete all", "move", "move", "replace")
Points = dict[int, NDArray[np.float64]]


@dataclass
class Model:
    """A group and a mean in its frame by slot, and poses."""

    splats: dict[int, tuple[int, NDArray[np.float64]]] = field(default_factory=dict)
    poses: dict[int, NDArray[np.float64]] = field(default_factory=dict)

    def mixes(self, slots: NDArray[np.int64], group: int) -> bool:
        blocks = set((slots // BLOCK).tolist())
        return any(slot // BLOCK in blocks and of != group for slot, (of, _) in self.splats.items())

    def write(self, slots: NDArray[np.int64], splats: Splats, group: int) -> None:
        for slot, mean in zip(slots.tolist(), splats.positions + splats.origin, strict=True):
            self.splats[slot] = group, mean

    def points(self) -> Points:
        placed = {}
        for slot, (group, mean) in self.splats.items():
            pose = self.poses.get(group, np.eye(4))
            placed[slot] = pose[:3, :3] @ mean + pose[:3, 3]
        return placed


class Wire:
    """In place of a node and its topic: what a writer keeps, and who hears it."""

    def __init__(self) -> None:
        self.history: deque[GaussianArray] = deque()
        self.careful, self.lossy = SplatMap(), SplatMap()
        self.loses = False

    def create_publisher(self, _: object, topic: str, qos: Any) -> Wire:
        self.history = deque(maxlen=qos.depth)
        return self

    def destroy_publisher(self, _: object) -> None: ...

    def get_subscription_count(self) -> int:
        return 0

    def wait_for_all_acked(self, _: object) -> bool:
        return True

    def get_clock(self) -> Any:
        return self

    def now(self) -> Any:
        return self

    def to_msg(self) -> None:
        return None

    def publish(self, message: GaussianArray) -> None:
        self.history.append(message)
        self.careful.apply(decode(message))
        if not self.loses:
            # Who lost a deletion may refuse what came in its place: it lacks that as well.
            with contextlib.suppress(MixedGroupsError):
                self.lossy.apply(decode(message))

    def latecomer(self) -> SplatMap:
        late = SplatMap()
        for message in self.history:
            late.apply(decode(message))
        return late


def splats_at(random: np.random.Generator, count: int) -> Splats:
    return Splats(
        positions=random.normal(size=(count, 3)),
        orientations=np.tile([0.0, 0.0, 0.0, 1.0], (count, 1)),
        scales=np.full((count, 3), 0.1),
        opacities=random.choice([0.001, 0.5], count),  # too faint to be drawn: these count as well
        sh=np.zeros((count, 1, 3)),
        origin=np.round(random.normal(size=3) * 100),
    )


def points_of(held: SplatMap) -> Points:
    used = held.extents != EMPTY
    frames = held.frames[held.groups[used]]
    means = (frames[:, :3, :3] @ held.positions[used][:, :, None])[:, :, 0] + frames[:, :3, 3]
    return dict(zip(held.slots[used].tolist(), means, strict=True))


def assert_same(points: Points, expected: Points) -> None:
    assert points.keys() == expected.keys()
    for slot, mean in expected.items():
        np.testing.assert_allclose(points[slot], mean, rtol=0, atol=1e-3)


@settings(max_examples=40, deadline=None)
@given(data=st.data())
def test_any_history(data: st.DataObject) -> None:
    random = np.random.default_rng(data.draw(st.integers(0, 2**32), "seed"))
    wire, model = Wire(), Model()
    depth = data.draw(st.sampled_from([12, 40]), "history_depth")
    publisher = MapPublisher(wire, history_depth=depth)  # type: ignore[arg-type]
    for kind in data.draw(st.lists(st.sampled_from(KINDS), max_size=25), "edits"):
        wire.loses = data.draw(st.sampled_from([False, False, False, True]), "lost")
        group = data.draw(st.integers(0, 3), "group")
        count = int(random.integers(1, 8))
        slots = random.choice(40, count, replace=False) + BLOCK * int(random.integers(0, 4))
        splats = splats_at(random, count)
        before = publisher.revision
        if kind == "upsert" and model.mixes(slots, group):
            with pytest.raises(ValueError, match="hold splats of group"):
                publisher.upsert(slots, splats, group=group)
            assert publisher.revision == before
        elif kind == "upsert":
            publisher.upsert(slots, splats, group=group)
            model.write(slots, splats, group)
        elif kind == "replace":
            publisher.replace(splats)
            model = Model()
            model.write(np.arange(count), splats, 0)
        elif kind == "move":
            pose = frame_at(random.normal(size=3) * 100, random.normal(size=4))
            publisher.move({group: pose})
            model.poses[group] = pose
        else:
            gone = range(4 * BLOCK) if kind == "delete all" else slots
            publisher.delete(gone)
            for slot in gone:
                model.splats.pop(int(slot), None)
        expected = model.points()
        assert_same(points_of(wire.careful), expected)
        known, held = publisher.snapshot()
        own = dict(zip(np.asarray(known).tolist(), held.positions + held.origin, strict=True))
        assert_same(own, expected)
        if publisher.revision:
            late = wire.latecomer()
            assert (late.missed, late.revision) == (0, publisher.revision)
            assert_same(points_of(late), expected)
        if wire.lossy.revision == publisher.revision and not wire.lossy.missed:
            assert_same(points_of(wire.lossy), expected)
