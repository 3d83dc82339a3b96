"""What a stream of edits adds up to, whatever of it is lost: its hearers and a dictionary agree.

Batches, requests and answers go astray or wait, latecomers join, the publisher starts anew.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from rosplat_core import maps
from rosplat_core.maps import Arrival, BatchError
from rosplat_core.splats import Splats
from rosplat_core.view import frame_at
from rosplat_msgs.msg import GaussianArray
from rosplat_msgs.srv import PullMap
from rosplat_ros import map_publisher
from rosplat_ros.map_publisher import MapPublisher
from rosplat_ros.map_receiver import labelled
from rosplat_sorter.map import SplatMap

MOST_WAITING = 1 << 26  # of MapPull [bytes]
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


class Label(NamedTuple):
    """What counts of a batch. bytes: the memory that it takes."""

    map_id: str
    revision: int
    replaces: bool
    bytes: int = 0


class Request(NamedTuple):
    number: int
    map_id: str
    after_revision: int
    first_block: int


@dataclass
class Step:
    """What to do now: batches to apply in turn, and a request to send."""

    batches: list[tuple[Any, Arrival]] = field(default_factory=list)
    request: Request | None = None


class Pull:
    """MapPull, by names."""

    def __init__(self) -> None:
        self._pull = maps.MapPull()

    @property
    def pulling(self) -> bool:
        return self._pull.pulling

    def hold(self, held: bool) -> None:
        self._pull.held = held

    def hear(self, of: Label, batch: Any, now: float, served: bool) -> Step:
        return _step(self._pull.hear((*of, batch), now, served))

    def miss(self, of: Label) -> None:
        self._pull.miss((*of, None))

    def lose(self, now: float) -> None:
        self._pull.lose(now)

    def answer(self, number: int, batches: Any, block: int, now: float, served: bool) -> Step:
        labelled = [(*of, batch) for of, batch in batches]
        return _step(self._pull.answer(number, labelled, block, now, served))

    def tick(self, now: float, served: bool) -> Step:
        return _step(self._pull.tick(now, served))


def _step(result: Any) -> Step:
    batches, request = result
    return Step(batches, Request(*request) if request else None)


def label(message: GaussianArray) -> Label:
    return Label(*labelled(message)[:4])


class Wire:
    """In place of a node, its topic and its services: to whom batches go, and who answers."""

    def __init__(self) -> None:
        self.pull: Callable[..., PullMap.Response] | None = None
        self.sent: list[GaussianArray] = []

    def create_publisher(self, *_: object, **__: object) -> Wire:
        return self

    def serve_pulls(self, _: str, serve: Any, __: object) -> Wire:
        self.pull = serve
        return self

    def serve_repeats(self, *_: object) -> Wire:
        return self

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
            self._pull.miss(label(self.coming.popleft()))
        elif what <= 1 and self.coming:
            message = self.coming.popleft()
            self._do(self._pull.hear(label(message), message, self._now, served))
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
            try:
                self.map.take(message, arrival)
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
    for slot, mean in expected.items():
        np.testing.assert_allclose(points[slot], mean, rtol=0, atol=1e-3)


@pytest.mark.parametrize("losses", [0.0, 0.1, 0.5])
@pytest.mark.parametrize("chunk_bytes", [200, 2000, 10**6])
@pytest.mark.parametrize("seed", [0, 1])
def test_whatever_is_lost_all_end_with_the_map(
    monkeypatch: pytest.MonkeyPatch, losses: float, chunk_bytes: int, seed: int
) -> None:
    monkeypatch.setattr(map_publisher, "PullServer", Wire.serve_pulls)
    monkeypatch.setattr(map_publisher, "ServiceThread", Wire.serve_repeats)
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
            for _ in range(int(random.integers(30))):
                receiver.live(wire, served, loses=random.random() < losses)
                check(receiver)

    def check(receiver: Receiver) -> None:
        held = receiver.map
        expected = known.get((held.map_id, held.revision))
        if receiver.exact and expected is not None:
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


def beginning() -> tuple[Pull, Request]:
    """A receiver that has revision 1 and heard 5, and what it asks for."""
    pull = Pull()
    assert pull.hear(Label("map", 1, True), "one", 0.0, True).batches == [("one", Arrival.HEARD)]
    step = pull.hear(Label("map", 5, False, 100), "five", 1.0, True)
    assert not step.batches
    assert (step.request.map_id, step.request.after_revision, step.request.first_block) == (
        "map", 1, 0,
    )  # fmt: skip
    return pull, step.request


def part(revision: int, map_id: str = "map", replaces: bool = False) -> tuple[Label, str]:
    return Label(map_id, revision, replaces), f"pulled {revision}"


@pytest.mark.parametrize(
    ("batches", "next_block"),
    [
        ([part(5, map_id="another")], 0),
        ([part(5), part(5, map_id="another")], 0),
        ([part(0)], 0),
        ([part(5), part(6)], 0),
        ([part(5)], 2**15),
        ([part(5)], 2**32 - 1),
    ],
)
def test_an_answer_that_is_none_counts_for_nothing(
    batches: list[tuple[Label, str]], next_block: int
) -> None:
    pull, request = beginning()
    step = pull.answer(request.number, batches, next_block, 1.1, True)
    assert step == Step([("five", Arrival.HEARD)])
    assert not pull.pulling
    assert pull.tick(1.5, True).request is None
    again = pull.tick(2.5, True).request
    assert (again.after_revision, again.first_block) == (1, 0)
    # Nothing older than what was heard meanwhile.
    assert pull.answer(again.number, [part(4)], 0, 2.6, True) == Step()


def test_a_server_without_the_map_leaves_others_time_to_answer() -> None:
    pull, request = beginning()  # at 1.0
    assert pull.answer(request.number, [], 0, 1.1, True) == Step()
    step = pull.answer(request.number, [part(5)], 0, 1.3, True)
    assert step.batches == [("pulled 5", Arrival.LAST)]
    assert not pull.pulling
    pull, request = beginning()
    assert pull.answer(request.number, [], 0, 1.1, True) == Step()
    assert pull.tick(1.5, True) == Step()
    assert pull.tick(1.7, True) == Step([("five", Arrival.HEARD)])  # nobody else has it
    assert pull.tick(2.8, True).request


@pytest.mark.parametrize("replaces", [False, True])
def test_a_server_that_never_ends_is_asked_slowly_and_not_for_ever(replaces: bool) -> None:
    """It answers at once, each time that there is more: of another revision, or from the first."""
    pull, request = beginning()
    now, times = 1.0, [1.0]
    while now < 10:
        now += 0.01
        if request:
            revision = 5 if replaces else 5 + len(times)
            more = 1 if replaces else len(times) % 2
            answer = [part(revision, replaces=replaces)]
            request = pull.answer(request.number, answer, more, now, True).request
        else:
            request = pull.tick(now, True).request
        times += [now] * (request is not None)
        if not pull.pulling:
            break
    assert not pull.pulling  # what was heard has its turn
    assert 30 < len(times) < 80
    assert times[-1] - times[0] > 0.05 * (len(times) - 1)


def test_large_answers_follow_each_other_without_a_pause() -> None:
    pull, request = beginning()
    for block in range(1, 100):
        answer = (Label("map", 5, False, 2_000_000), "much")
        request = pull.answer(request.number, [answer], block, 1.0 + 0.001 * block, True).request
        assert request.first_block == block


def pulled_again(pull: Pull, revision: int, times: Iterable[float], served: bool) -> list[float]:
    """When what a receiver has is asked for again, not only what came after its revision."""
    requests = ((now, pull.tick(now, served).request) for now in times)
    return [now for now, request in requests if request and request.after_revision != revision]


@pytest.mark.parametrize("served", [True, False])
def test_who_joins_late_asks_though_it_hears_nothing_and_knows_of_no_server(served: bool) -> None:
    pull = Pull()
    request = pull.tick(0.0, served).request
    assert (request.map_id, request.after_revision, request.first_block) == ("", 0, 0)
    for now in np.arange(0.1, 1.0, 0.1):
        assert pull.tick(now, served) == Step()
    again = [now for now in np.arange(1.0, 5.0, 0.1) if pull.tick(now, served).request]
    assert again
    assert 0.9 < again[0] < 2.2  # it may have been lost
    pull = Pull()
    request = pull.tick(0.0, served).request
    step = pull.answer(request.number, [part(7)], 3, 0.2, served)
    assert step.batches == [("pulled 7", Arrival.PULLED)]
    request = pull.tick(0.4, served).request
    assert (request.map_id, request.first_block) == ("map", 3)
    step = pull.answer(request.number, [part(7)], 0, 0.5, served)
    assert step.batches == [("pulled 7", Arrival.LAST)]
    assert pull.hear(Label("map", 8, False), "eight", 0.6, served).batches == [
        ("eight", Arrival.HEARD)
    ]
    assert not pulled_again(pull, 8, np.arange(0.7, 20.0, 0.1), served)


def test_batches_of_a_publisher_that_serves_no_pulls_do_not_wait() -> None:
    pull = Pull()
    pull.tick(0.0, False)
    asked = []
    for revision in range(5, 105):
        step = pull.hear(Label("map", revision, False), revision, 0.1 * revision, False)
        assert step.batches == [(revision, Arrival.HEARD)]
        asked += [step.request, pull.tick(0.1 * revision, False).request]
    assert 3 <= len([request for request in asked if request]) <= 6  # in ten seconds


def test_a_map_without_a_name_is_pulled_once() -> None:
    pull = Pull()
    request = pull.tick(0.0, True).request
    step = pull.answer(request.number, [part(7, map_id="")], 0, 0.1, True)
    assert step.batches == [("pulled 7", Arrival.LAST)]
    assert not pulled_again(pull, 7, np.arange(0.2, 5.0, 0.1), True)


def test_a_round_whose_changes_all_wait_ends_the_pull() -> None:
    """However fast the map changes: blocks of later answers are newer than those of the first."""
    pull, request = beginning()
    for revision in (6, 7):
        assert pull.hear(Label("map", revision, False), revision, 1.05, True) == Step()
    pull.answer(request.number, [part(6)], 3, 1.1, True)  # 6 is in all that follows
    assert pull.hear(Label("map", 8, False), 8, 1.15, True) == Step()
    assert pull.hear(Label("map", 9, False), 9, 1.16, True) == Step()
    step = pull.answer(pull.tick(1.3, True).request.number, [part(8)], 0, 1.4, True)
    assert step == Step(
        [("pulled 8", Arrival.PULLED), (7, Arrival.PULLED), (8, Arrival.LAST), (9, Arrival.HEARD)]
    )
    assert not pull.pulling


def test_a_change_that_comes_after_the_round_ends_the_pull_too() -> None:
    pull, request = beginning()
    pull.answer(request.number, [part(5)], 3, 1.1, True)
    step = pull.answer(pull.tick(1.3, True).request.number, [part(7)], 0, 1.4, True)
    assert step.batches == [("pulled 7", Arrival.PULLED)]
    assert pull.hear(Label("map", 6, False), 6, 1.5, True) == Step()
    assert pull.hear(Label("map", 7, False), 7, 1.5, True) == Step(
        [(6, Arrival.PULLED), (7, Arrival.LAST)]
    )
    assert not pull.pulling


def test_changes_with_a_gap_end_no_pull() -> None:
    pull, request = beginning()
    pull.answer(request.number, [part(5)], 3, 1.1, True)
    assert pull.hear(Label("map", 7, False), 7, 1.15, True) == Step()
    step = pull.answer(pull.tick(1.3, True).request.number, [part(7)], 0, 1.4, True)
    assert step.batches == [("pulled 7", Arrival.PULLED)]
    assert pull.pulling
    assert step.request.after_revision == 5


def test_what_there_was_no_room_for_is_pulled_once_there_is() -> None:
    pull, request = beginning()
    pull.hold(True)
    pull.miss(Label("map", 6, False))
    step = pull.answer(request.number, [part(5)], 0, 1.2, True)
    assert step == Step([("pulled 5", Arrival.LAST)])
    assert not pull.tick(2.0, True).request
    pull.hold(False)
    request = pull.tick(2.1, True).request
    assert (request.after_revision, request.first_block) == (5, 0)
    step = pull.answer(request.number, [part(6)], 0, 2.2, True)
    assert step == Step([("pulled 6", Arrival.LAST)])
    pull.miss(Label("another", 1, True))  # of a map that begins
    request = pull.tick(3.0, True).request
    assert (request.map_id, request.after_revision) == ("another", 0)


def test_a_map_that_no_server_has_any_more_gives_way_to_another() -> None:
    """As of a publisher that began anew, of which nothing was heard."""
    pull = Pull()
    pull.hear(Label("old", 4, True), "four", 0.0, True)
    request = pull.tick(2.1, True).request
    assert request.map_id == "old"
    assert pull.answer(request.number, [], 0, 2.2, True) == Step()
    asked = (pull.tick(2.2 + 0.1 * i, True).request for i in range(100))
    request = next(request for request in asked if request)
    assert (request.map_id, request.after_revision, request.first_block) == ("", 0, 0)
    step = pull.answer(request.number, [part(3, "new", replaces=True)], 0, 20.0, True)
    assert step.batches == [("pulled 3", Arrival.LAST)]
    assert step.request.map_id == "new"  # whether anything got lost since


def test_after_a_batch_without_memory_all_is_pulled_after_a_while() -> None:
    pull = Pull()
    pull.hear(Label("map", 1, True), "one", 0.0, True)
    pull.hear(Label("map", 2, False), "two", 0.1, True)
    pull.lose(0.1)
    assert not pull.tick(0.2, True).request
    request = pull.tick(10.0, True).request
    assert (request.map_id, request.after_revision, request.first_block) == ("map", 0, 0)
    step = pull.answer(request.number, [part(2, replaces=True)], 0, 10.1, True)
    assert step == Step([("pulled 2", Arrival.LAST)])
    assert not pull.pulling


def test_a_last_batch_that_got_lost_is_pulled() -> None:
    """Nothing that is heard tells of it: who hears nothing for a while asks."""
    pull = Pull()
    pull.hear(Label("map", 1, True), "one", 0.0, True)
    assert not pull.tick(1.9, True).request
    assert not pull.tick(2.0, False).request  # nobody could answer
    request = pull.tick(2.1, True).request
    assert (request.map_id, request.after_revision, request.first_block) == ("map", 1, 0)
    assert not pull.pulling  # the map is taken for whole meanwhile
    step = pull.answer(request.number, [part(2)], 0, 2.2, True)
    assert step == Step([("pulled 2", Arrival.LAST)])
    request = pull.tick(4.2, True).request
    assert request.after_revision == 2
    assert pull.answer(request.number, [part(2)], 0, 4.3, True) == Step()  # nothing is missing


def test_what_is_heard_overtakes_an_answer_that_nothing_got_lost() -> None:
    pull = Pull()
    pull.hear(Label("map", 1, True), "one", 0.0, True)
    request = pull.tick(2.1, True).request
    assert pull.hear(Label("map", 2, False), "two", 2.2, True).batches == [("two", Arrival.HEARD)]
    assert pull.answer(request.number, [part(1)], 0, 2.3, True) == Step()
    assert not pull.pulling


def test_who_asks_in_vain_goes_on_asking() -> None:
    """A server that comes late is found soon, however long there was none."""
    pull = Pull()
    asked = [now for now in np.arange(0.0, 60.0, 0.1) if pull.tick(now, False).request]
    assert max(np.diff(asked)) < 5


def test_answers_never_go_back_to_earlier_blocks() -> None:
    pull, request = beginning()
    assert pull.answer(request.number, [part(5)], 7, 1.1, True) == Step(
        [("pulled 5", Arrival.PULLED)]
    )
    request = pull.tick(1.25, True).request
    assert request.first_block == 7
    assert not pull.answer(request.number, [part(5)], 7, 1.3, True).batches
    assert not pull.pulling


def test_who_does_not_answer_is_waited_for_a_while() -> None:
    pull, request = beginning()  # at 1.0
    assert pull.tick(2.0, True) == Step()
    for now in (2.1, 4.2):  # the server may not have known it yet
        again = pull.tick(now, True).request
        assert (again.after_revision, again.first_block) == (1, 0)
    assert pull.answer(request.number, [part(5)], 0, 5.0, True) == Step()  # too late
    assert pull.tick(8.1, True) == Step()
    assert pull.tick(8.3, True) == Step([("five", Arrival.HEARD)])
    assert pull.tick(9.4, True).request  # with new patience
    assert pull.tick(10.3, True) == Step()
    assert pull.tick(10.5, True).request
    pull, request = beginning()
    assert pull.tick(1.1, False).batches == [("five", Arrival.HEARD)]  # it has ended


def test_what_waits_has_a_limit_and_what_is_dropped_is_pulled() -> None:
    pull, request = beginning()
    most = MOST_WAITING // 2
    for revision in (6, 7, 8):
        assert not pull.hear(Label("map", revision, False, most), revision, 1.1, True).batches
    step = pull.answer(request.number, [part(5)], 0, 1.2, True)
    assert step.batches == [("pulled 5", Arrival.LAST)]  # 6 is lacking
    assert step.request.after_revision == 5
    step = pull.answer(step.request.number, [part(6)], 0, 1.3, True)
    assert step.batches == [("pulled 6", Arrival.LAST), (7, Arrival.HEARD), (8, Arrival.HEARD)]
    assert not pull.pulling
