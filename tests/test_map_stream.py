"""What a stream of edits adds up to, whatever of it is lost: its hearers and a dictionary agree.

Batches, requests and answers go astray or wait, latecomers join, the publisher starts anew.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from pulls import Label, Pull, Request, Step

from rosplat_core.maps import Arrival, BatchError
from rosplat_core.splats import Splats
from rosplat_core.view import frame_at
from rosplat_msgs.msg import GaussianArray
from rosplat_msgs.srv import PullMap
from rosplat_ros import map_publisher
from rosplat_ros.map_publisher import MapPublisher
from rosplat_ros.map_receiver import labelled
from rosplat_sorter.map import SplatMap

BLOCK = GaussianArray.SLOTS_PER_BLOCK
KINDS = [
    *["upsert"] * 12, *["delete"] * 6, *["delete a block"] * 6, *["move"] * 4,
    "delete all", "replace", "repeat", "join", "restart",
]  # fmt: skip
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


def label(message: GaussianArray) -> Label:
    return Label(*labelled(message)[:4])


class Wire:
    """In place of a node, its topic and its services: to whom batches go, and who answers."""

    def __init__(self) -> None:
        self.node = self
        self.pull: Callable[..., PullMap.Response] | None = None
        self.sent: list[GaussianArray] = []

    def create_publisher(self, *_: object, **__: object) -> Wire:
        return self

    def serve(self, kind: type, _: str, serve: Any) -> Wire:
        if kind is PullMap:
            self.pull = serve
        return self

    def report(self, *_: object, **__: object) -> Wire:
        return self

    def destroy_publisher(self, _: object) -> None: ...

    def start(self) -> None: ...

    def close(self) -> None: ...

    def resolve_topic_name(self, name: str) -> str:
        return name

    def count_publishers(self, _: str) -> int:
        return 1

    def get_clock(self) -> Any:
        return self

    def now(self) -> Any:
        return self

    def to_msg(self) -> None:
        return None

    def publish(self, message: GaussianArray) -> None:
        self.sent.append(message)

    def wait_for_all_acked(self, _: object) -> bool:
        return True


class Receiver:
    """Whoever hears the wire: maps that batches make, and what follows them."""

    def __init__(self, random: np.random.Generator) -> None:
        self._pull = Pull()
        self._random = random
        self.map = SplatMap()
        self.coming: deque[GaussianArray] = deque()
        self._request: Request | None = None
        self._answer: tuple[int, PullMap.Response] | None = None
        self._now = 0.0
        self.changed = False
        """Whether its map may be another than when it was last compared."""

    @property
    def exact(self) -> bool:
        """Whether it says that nothing of its revision is missing."""
        return self.map.revision > 0 and not self.map.missed and not self.map.pulled

    @property
    def at_rest(self) -> bool:
        waits = self.coming or self._request or self._answer
        return not (waits or self._pull.pulling or self.map.missed)

    def live(self, wire: Wire, served: bool, loses: bool) -> None:
        """Something of what can happen next happens."""
        self._now += float(self._random.choice([0.01, 0.05, 0.2]))
        what = self._random.integers(5)
        self._pull.hold(loses)
        if what <= 1 and self.coming and loses:  # there is no room
            self._pull.miss(label(self.coming.popleft()), self._now)
        elif what <= 1 and self.coming:
            message = self.coming.popleft()
            self._do(self._pull.receive(label(message), message, self._now, served))
        elif what == 2 and self._request and served and wire.pull:
            request, self._request = self._request, None
            asked = PullMap.Request(
                map_id=request.map_id,
                after_revision=request.after_revision,
                first_block=request.first_block,
            )
            if not loses:
                self._answer = request.number, wire.pull(asked, PullMap.Response())
        elif what == 3 and self._answer:
            (number, answer), self._answer = self._answer, None
            batches = [(label(message), message) for message in answer.batches]
            self._do(self._pull.answer(number, batches, answer.next_block, self._now, served))
        else:
            if loses:
                self._now += 10  # nobody waits for so long
            self._do(self._pull.tick(self._now, served))

    def _do(self, step: Step) -> None:
        self._request = step.request or self._request
        for message, arrival in step.batches:
            self.changed = True
            try:
                self.map.apply(message, arrival)
            except BatchError as error:  # it lacks a deletion
                assert "hold splats of group" in str(error)
                assert arrival == Arrival.HEARD


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
    slots, groups = held.slots_and_groups()
    used = np.array([held.in_use(slot) for slot in slots.tolist()], bool)
    frames = held.frames[groups[used]]
    means = (frames[:, :3, :3] @ held.positions[used][:, :, None])[:, :, 0] + frames[:, :3, 3]
    return dict(zip(slots[used].tolist(), means, strict=True))


def assert_same(points: Points, expected: Points) -> None:
    assert points.keys() == expected.keys()
    means = [points[slot] for slot in expected]
    np.testing.assert_allclose(means, list(expected.values()), rtol=0, atol=1e-3)


@pytest.mark.parametrize("losses", [0.0, 0.1, 0.5])
@pytest.mark.parametrize("chunk_bytes", [200, 2000, 10**6])
@pytest.mark.parametrize("seed", [0, 1])
def test_whatever_is_lost_all_end_with_the_map(
    monkeypatch: pytest.MonkeyPatch, losses: float, chunk_bytes: int, seed: int
) -> None:
    monkeypatch.setattr(map_publisher, "Node", Wire)
    monkeypatch.setattr(map_publisher, "ServiceThread", Wire.serve)
    monkeypatch.setattr(map_publisher, "Diagnostics", Wire.report)
    random = np.random.default_rng(seed)
    wire, model = Wire(), Model()
    publisher = MapPublisher(wire, chunk_bytes=chunk_bytes)
    receivers = [Receiver(random)]
    known: dict[tuple[str, int], Points] = {}

    def send(served: bool, losses: float) -> None:
        known[publisher.map_id, publisher.revision] = model.points()
        for message in wire.sent:
            for receiver in receivers:
                if random.random() >= losses:
                    receiver.coming.append(message)
        wire.sent.clear()
        for receiver in receivers:
            receiver.changed = True  # or what it is held against has
            for _ in range(int(random.integers(30))):
                receiver.live(wire, served, loses=random.random() < losses)
                check(receiver)

    def check(receiver: Receiver) -> None:
        held = receiver.map
        expected = known.get((held.map_id, held.revision))
        if receiver.changed and receiver.exact and expected is not None:
            receiver.changed = False
            assert_same(points_of(held), expected)
            assert held.splats == len(expected)

    for action in random.choice(KINDS, 60):
        group = int(random.integers(4))
        count = int(random.integers(1, 8))
        slots = random.choice(40, count, replace=False) + BLOCK * int(random.integers(0, 4))
        splats = splats_at(random, count)
        before = publisher.revision
        if action == "join":
            receivers = [*receivers[-2:], Receiver(random)]
        elif action == "restart":
            publisher = MapPublisher(wire, chunk_bytes=chunk_bytes)
            model = Model()
        elif action == "upsert" and model.mixes(slots, group):
            with pytest.raises(ValueError, match="hold splats of group"):
                publisher.upsert(slots, splats, group=group)
            assert publisher.revision == before
        elif action == "upsert":
            publisher.upsert(slots, splats, group=group)
            model.write(slots, splats, group)
        elif action == "replace":
            publisher.replace(splats)
            model = Model()
            model.write(np.arange(count), splats, 0)
        elif action == "repeat":
            publisher.repeat()
        elif action == "move":
            pose = frame_at(random.normal(size=3) * 100, random.normal(size=4))
            publisher.move({group: pose})
            model.poses[group] = pose
        else:
            gone = {"delete": slots, "delete all": range(4 * BLOCK)}.get(action)
            if gone is None:
                block = int(random.integers(4)) * BLOCK
                gone = range(block, block + BLOCK)
            publisher.delete(gone)
            for slot in gone:
                model.splats.pop(int(slot), None)
        used, held = publisher.snapshot()
        own = dict(zip(np.asarray(used).tolist(), held.positions + held.origin, strict=True))
        assert_same(own, model.points())
        send(served=random.random() >= losses, losses=losses)
    publisher.delete([])  # who has lost the last batch can't know: this isn't lost
    send(served=True, losses=0.0)
    for receiver in receivers:
        for _ in range(1000):
            if receiver.at_rest:
                break
            receiver.live(wire, served=True, loses=False)
            check(receiver)
        assert receiver.at_rest
        assert receiver.exact
        assert (receiver.map.map_id, receiver.map.revision) == (
            publisher.map_id, publisher.revision,
        )  # fmt: skip
        check(receiver)
