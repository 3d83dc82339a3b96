"""What a receiver pulls of a map, and when: MapPull on a clock of its own."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from pulls import Label, Pull, Request, Step

from rosplat_core.maps import Arrival

MOST_WAITING = 1 << 26  # of MapPull [bytes]


def beginning() -> tuple[Pull, Request]:
    """A receiver that has revision 1 and heard 5, and what it asks for."""
    pull = Pull()
    assert pull.receive(Label("map", 1, True), "one", 0.0, True).batches == [("one", Arrival.HEARD)]
    step = pull.receive(Label("map", 5, False, 100), "five", 1.0, True)
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
    assert pull.tick(3.1, True).request


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
    assert pull.receive(Label("map", 8, False), "eight", 0.6, served).batches == [
        ("eight", Arrival.HEARD)
    ]
    assert not pulled_again(pull, 8, np.arange(0.7, 20.0, 0.1), served)


def test_batches_of_a_publisher_that_serves_no_pulls_do_not_wait() -> None:
    pull = Pull()
    pull.tick(0.0, False)
    asked = []
    for revision in range(5, 105):
        step = pull.receive(Label("map", revision, False), revision, 0.1 * revision, False)
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
        assert pull.receive(Label("map", revision, False), revision, 1.05, True) == Step()
    pull.answer(request.number, [part(6)], 3, 1.1, True)  # 6 is in all that follows
    assert pull.receive(Label("map", 8, False), 8, 1.15, True) == Step()
    assert pull.receive(Label("map", 9, False), 9, 1.16, True) == Step()
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
    assert pull.receive(Label("map", 6, False), 6, 1.5, True) == Step()
    assert pull.receive(Label("map", 7, False), 7, 1.5, True) == Step(
        [(6, Arrival.PULLED), (7, Arrival.LAST)]
    )
    assert not pull.pulling


def test_changes_with_a_gap_end_no_pull() -> None:
    pull, request = beginning()
    pull.answer(request.number, [part(5)], 3, 1.1, True)
    assert pull.receive(Label("map", 7, False), 7, 1.15, True) == Step()
    step = pull.answer(pull.tick(1.3, True).request.number, [part(7)], 0, 1.4, True)
    assert step.batches == [("pulled 7", Arrival.PULLED)]
    assert pull.pulling
    assert step.request.after_revision == 5


def test_what_there_was_no_room_for_is_pulled_once_there_is() -> None:
    pull, request = beginning()
    pull.hold(True)
    pull.miss(Label("map", 6, False), 1.1)
    step = pull.answer(request.number, [part(5)], 0, 1.2, True)
    assert step == Step([("pulled 5", Arrival.LAST)])
    assert not pull.tick(2.0, True).request
    pull.hold(False)
    request = pull.tick(2.1, True).request
    assert (request.after_revision, request.first_block) == (5, 0)
    step = pull.answer(request.number, [part(6)], 0, 2.2, True)
    assert step == Step([("pulled 6", Arrival.LAST)])
    pull.miss(Label("another", 1, True), 2.3)  # of a map that begins
    request = pull.tick(3.0, True).request
    assert (request.map_id, request.after_revision) == ("another", 0)


def test_a_map_that_no_server_has_any_more_gives_way_to_another() -> None:
    """As of a publisher that began anew, of which nothing was heard."""
    pull = Pull()
    pull.receive(Label("old", 4, True), "four", 0.0, True)
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
    pull.receive(Label("map", 1, True), "one", 0.0, True)
    pull.receive(Label("map", 2, False), "two", 0.1, True)
    pull.restart(0.1)
    assert not pull.tick(0.2, True).request
    request = pull.tick(10.0, True).request
    assert (request.map_id, request.after_revision, request.first_block) == ("map", 0, 0)
    step = pull.answer(request.number, [part(2, replaces=True)], 0, 10.1, True)
    assert step == Step([("pulled 2", Arrival.LAST)])
    assert not pull.pulling


def test_a_last_batch_that_got_lost_is_pulled() -> None:
    """Nothing that is heard tells of it: who hears nothing for a while asks."""
    pull = Pull()
    pull.receive(Label("map", 1, True), "one", 0.0, True)
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
    pull.receive(Label("map", 1, True), "one", 0.0, True)
    request = pull.tick(2.1, True).request
    assert pull.receive(Label("map", 2, False), "two", 2.2, True).batches == [
        ("two", Arrival.HEARD)
    ]
    assert pull.answer(request.number, [part(1)], 0, 2.3, True) == Step()
    assert not pull.pulling


def lacking() -> Pull:
    """A receiver that missed revisions 4 and 5 of 8, where nobody serves pulls."""
    pull = Pull()
    for revision in (1, 2, 3, 6, 7, 8):
        step = pull.receive(Label("map", revision, revision == 1), revision, 0.1 * revision, False)
        assert step.batches == [(revision, Arrival.HEARD)]
    return pull


def again(pull: Pull, revisions: Iterable[int], now: float) -> list[tuple[Any, Arrival]]:
    """What a receiver takes of revisions that come once more."""
    steps = (pull.receive(Label("map", r, r == 1), r, now, False) for r in revisions)
    return [batch for step in steps for batch in step.batches]


def test_what_nobody_answers_for_is_looked_for_once_in_the_history() -> None:
    pull = lacking()
    asked = [now for now in np.arange(0.9, 60.0, 0.1) if pull.tick(now, False).subscribe_anew]
    assert len(asked) == 1
    assert 2 < asked[0] < 5
    pull.subscribed_anew(asked[0])
    taken = again(pull, range(2, 9), asked[0] + 1.0)
    pulled, last = Arrival.PULLED, Arrival.LAST
    assert taken == [(4, pulled), (5, pulled), (6, pulled), (7, pulled), (8, last)]
    assert again(pull, [9], asked[0] + 1.1) == [(9, Arrival.HEARD)]
    assert again(pull, [11], asked[0] + 1.1) == [(11, Arrival.HEARD)]  # 10 is missing
    later = [now for now in np.arange(60.0, 90.0, 0.1) if pull.tick(now, False).subscribe_anew]
    assert len(later) == 1


def test_whom_nothing_reaches_joins_anew_once_and_asks_again() -> None:
    pull = Pull()
    joined = [now for now in np.arange(0.0, 60.0, 0.1) if pull.tick(now, now > 2).join_anew]
    assert len(joined) == 1
    assert 14 <= joined[0] < 14.3

    pull = Pull()
    steps = [(now, pull.tick(now, now < 12.2 or now > 13.0)) for now in np.arange(0.0, 20.0, 0.1)]
    (join,) = (now for now, step in steps if step.join_anew)
    again = next(now for now, step in steps if now > join and step.request)
    assert join + 0.5 < again < join + 2.5, "once the new participant knows the server"


def test_whom_anything_reaches_never_joins_anew() -> None:
    heard, answered = Pull(), Pull()
    heard.receive(Label("map", 1, True), 1, 0.0, True)
    asked = answered.tick(0.0, True).request
    assert asked
    answered.answer(asked.number, [], 0, 0.1, True)  # that server has no map
    for now in np.arange(0.2, 60.0, 0.1):
        assert not heard.tick(now, True).join_anew
        assert not answered.tick(now, True).join_anew


def test_a_history_from_its_beginning_is_taken_whole() -> None:
    pull = lacking()
    pull.subscribed_anew(1.0)
    assert again(pull, range(1, 9), 1.1) == [(r, Arrival.HEARD) for r in range(1, 9)]
    assert not any(pull.tick(now, False).subscribe_anew for now in np.arange(1.2, 20.0, 0.1))


def test_a_history_without_what_is_missing_changes_nothing() -> None:
    pull = lacking()
    pull.subscribed_anew(1.0)
    assert again(pull, range(6, 9), 1.1) == []
    assert again(pull, [9], 1.2) == [(9, Arrival.HEARD)]


def test_a_history_that_nothing_is_missing_of_is_no_map_that_begins_anew() -> None:
    pull = Pull()
    heard = range(1, 9)
    assert len(again(pull, heard, 0.1)) == 8
    pull.subscribed_anew(1.0)
    assert again(pull, heard, 1.1) == []
    # A bag in a loop: however soon after the history, and where that lacks the last batches.
    assert again(pull, heard, 1.2) == [(r, Arrival.HEARD) for r in heard]
    pull.subscribed_anew(2.0)
    assert again(pull, range(1, 8), 2.1) == []
    assert again(pull, heard, 10.0) == [(r, Arrival.HEARD) for r in heard]


def test_batches_that_come_again_from_a_publisher_with_pulls_cost_what_has_changed() -> None:
    """As of a publisher that DDS lost and found."""
    pull = Pull()
    for revision in range(1, 9):
        pull.receive(Label("map", revision, revision == 1), revision, 0.1, True)
    step = pull.receive(Label("map", 5, False), 5, 9.0, True)
    assert step.batches == []
    assert (step.request.after_revision, step.request.first_block) == (8, 0)
    for revision in (6, 7, 8):
        assert pull.receive(Label("map", revision, False), revision, 9.1, True).batches == []
    step = pull.answer(step.request.number, [part(8)], 0, 9.2, True)
    assert step.batches == [("pulled 8", Arrival.LAST)]
    # Or of one that began anew under the same name.
    step = pull.receive(Label("map", 2, False), 2, 9.3, True)
    step = pull.answer(step.request.number, [part(2, replaces=True)], 0, 9.4, True)
    assert step.batches == [("pulled 2", Arrival.LAST)]


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
    pull, _ = beginning()  # at 1.0
    assert pull.tick(3.0, True) == Step()
    for now in (3.1, 7.2):  # the first answer may be lost: the server may not have known it yet
        again = pull.tick(now, True).request
        assert (again.after_revision, again.first_block) == (1, 0)
    assert pull.tick(15.1, True) == Step()
    assert pull.tick(15.3, True) == Step([("five", Arrival.HEARD)])
    assert not pull.pulling
    assert pull.receive(Label("map", 7, False), "seven", 15.4, True).batches == [
        ("seven", Arrival.HEARD)
    ]
    asked = [now for now in np.arange(15.5, 75.0, 0.1) if pull.tick(now, True).request]
    assert 5 <= len(asked) <= 10
    pull, _ = beginning()
    assert pull.tick(1.1, False).batches == [("five", Arrival.HEARD)]  # it has ended


def test_the_first_answer_to_a_block_counts_however_late_it_is() -> None:
    pull, request = beginning()  # at 1.0
    again = pull.tick(3.1, True).request
    assert pull.awaits(request.number)
    step = pull.answer(request.number, [part(5)], 7, 4.0, True)
    assert step.batches == [("pulled 5", Arrival.PULLED)]
    assert not pull.awaits(again.number)
    assert pull.answer(again.number, [part(5)], 7, 4.1, True) == Step()
    assert pull.pulling


def test_a_pull_goes_on_at_its_block_after_a_silence() -> None:
    pull, request = beginning()
    pull.answer(request.number, [part(5)], 7, 1.1, True)
    requests = [pull.tick(now, True).request for now in np.arange(1.2, 60.0, 0.1)]
    assert not pull.pulling
    assert pull.receive(Label("map", 6, False), "six", 60.0, True).batches == [
        ("six", Arrival.HEARD)
    ]
    last = [request for request in requests if request][-1]
    assert (last.after_revision, last.first_block) == (1, 7)
    step = pull.answer(last.number, [part(6)], 0, 60.1, True)
    assert step.batches == [("pulled 6", Arrival.PULLED)]
    # What was heard meanwhile may be of earlier blocks, and batches before it may be missing.
    assert (step.request.after_revision, step.request.first_block) == (5, 0)
    step = pull.answer(step.request.number, [part(6)], 0, 60.2, True)
    assert step == Step([("pulled 6", Arrival.LAST)])


def test_an_answer_that_batches_have_overtaken_has_them_wait_for_the_next() -> None:
    pull, request = beginning()
    for now in np.arange(1.1, 20.0, 0.1):
        pull.tick(now, True)
    pull.receive(Label("map", 9, False), "nine", 20.0, True)
    again = pull.answer(request.number, [part(6)], 0, 20.1, True)
    assert again.batches == []
    assert again.request
    assert pull.receive(Label("map", 10, False), "ten", 20.2, True) == Step()
    step = pull.answer(again.request.number, [part(9)], 0, 40.0, True)
    assert step.batches == [("pulled 9", Arrival.LAST), ("ten", Arrival.HEARD)]


def test_what_waits_has_a_limit_and_what_is_dropped_is_pulled() -> None:
    pull, request = beginning()
    most = MOST_WAITING // 2
    for revision in (6, 7, 8):
        assert not pull.receive(Label("map", revision, False, most), revision, 1.1, True).batches
    step = pull.answer(request.number, [part(5)], 0, 1.2, True)
    assert step.batches == [("pulled 5", Arrival.LAST)]  # 6 is lacking
    assert step.request.after_revision == 5
    step = pull.answer(step.request.number, [part(6)], 0, 1.3, True)
    assert step.batches == [("pulled 6", Arrival.LAST), (7, Arrival.HEARD), (8, Arrival.HEARD)]
    assert not pull.pulling


BLOCKS = 50  # of the map that is pulled in the table below, each an answer


@dataclass
class Server:
    """Publishes a map, and answers pulls of it one after another, a block each.

    takes: time of an answer; lost: share of the answers that get lost; runs: whether the server
    runs at a time; edits: time from one batch on the topic to the next. [s]
    """

    takes: float
    lost: float = 0.0
    runs: Callable[[float], bool] = lambda now: True
    edits: float = np.inf
    delay: float = 0.0  # of each answer on its way, beside what it takes [s]
    revisions: list[int] = field(default_factory=lambda: [1] * BLOCKS)  # by block
    asked: Counter[tuple[int, int]] = field(default_factory=Counter)  # by revision and block
    _requests: deque[Request] = field(default_factory=lambda: deque(maxlen=10))  # as in ROS
    _done: float = 0.0  # of the first request [s]
    _on_their_way: deque[tuple[float, int, Any, int]] = field(default_factory=deque)
    _random: np.random.Generator = field(default_factory=lambda: np.random.default_rng(7))

    @property
    def revision(self) -> int:
        return max(self.revisions)

    def edit(self) -> tuple[Label, tuple[int, int]]:
        """Changes a block: the batch on the topic."""
        revision = self.revision + 1
        block = int(self._random.integers(BLOCKS))
        self.revisions[block] = revision
        return Label("map", revision, False, 1000), (block, revision)

    def ask(self, request: Request) -> None:
        self.asked[request.after_revision, request.first_block] += 1
        self._requests.append(request)

    def work(self, now: float, step: float) -> Iterator[tuple[int, Any, int]]:
        """The answers that arrive now: number, batches, next block."""
        if self.runs(now) and self._requests:
            self._done += step
            if self._done >= self.takes:
                self._done = 0.0
                answer = self._answer(self._requests.popleft())
                if self._random.random() >= self.lost:
                    self._on_their_way.append((now + self.delay, *answer))
        while self._on_their_way and self._on_their_way[0][0] <= now:
            yield self._on_their_way.popleft()[1:]

    def _answer(self, request: Request) -> tuple[int, Any, int]:
        after = request.after_revision if request.after_revision >= 1 else 0
        changed = [
            block for block in range(request.first_block, BLOCKS) if self.revisions[block] > after
        ]
        replaces = not after and not request.first_block
        of = Label("map", self.revision, replaces, 400_000)
        block = changed[0] if changed else -1
        content = (block, self.revisions[block]) if changed else ()
        return request.number, [(of, content)], changed[1] if len(changed) > 1 else 0


@dataclass
class Copy:
    """What a receiver has of a server's map."""

    pull: Pull = field(default_factory=Pull)
    revisions: list[int] = field(default_factory=lambda: [0] * BLOCKS)
    whole: bool = False

    def do(self, step: Step, server: Server) -> None:
        if step.request:
            server.ask(step.request)
        for content, arrival in step.batches:
            if content:
                self.revisions[content[0]] = content[1]
            self.whole |= arrival == Arrival.LAST


def time_to_pull(server: Server, limit: float, step: float = 0.05) -> float:
    """How long a receiver that joins takes until its map is whole, and the server's. [s]"""
    copy, now, next_edit = Copy(), 0.0, server.edits
    while now < limit:
        now += step
        if now >= next_edit and server.runs(now):
            next_edit = now + server.edits
            label, batch = server.edit()
            copy.do(copy.pull.receive(label, batch, now, True), server)
        for number, batches, next_block in server.work(now, step):
            copy.do(copy.pull.answer(number, batches, next_block, now, True), server)
        copy.do(copy.pull.tick(now, True), server)
        if copy.whole:
            assert copy.revisions == server.revisions
            return now
    return np.inf


@pytest.mark.parametrize("late", [False, True], ids=["", "late"])
@pytest.mark.parametrize("edits", [np.inf, 2.0], ids=["still", "living"])
@pytest.mark.parametrize("takes", [0.1, 1.5, 3.9, 4.1, 10.0, 30.0])
def test_a_pull_takes_what_its_answers_take(takes: float, edits: float, late: bool) -> None:
    """late: answers are made at once, and take their time on the way."""
    server = Server(0.0 if late else takes, edits=edits, delay=takes if late else 0.0)
    assert time_to_pull(server, limit=10_000.0) < 1.1 * BLOCKS * takes + 5
    twice = sum(server.asked.values()) - len(server.asked)
    assert twice <= (0 if takes < 2 else 6)


@pytest.mark.parametrize("takes", [0.1, 1.5, 3.9])
@pytest.mark.parametrize("seed", range(10))
def test_a_pull_of_which_half_of_the_answers_get_lost_ends(takes: float, seed: int) -> None:
    server = Server(takes, lost=0.5, _random=np.random.default_rng(seed))
    assert time_to_pull(server, limit=10_000.0) < 2.5 * 2 * BLOCKS * takes + 6 * BLOCKS
    assert sum(server.asked.values()) < 3 * BLOCKS


@pytest.mark.parametrize("edits", [np.inf, 0.3], ids=["still", "living"])
@pytest.mark.parametrize("takes", [0.05, 0.1, 0.35])
def test_a_pull_uses_the_moments_in_which_its_server_runs(takes: float, edits: float) -> None:
    """As one that is stopped for 4.6 s and continued for 0.4 s, again and again."""
    server = Server(takes, runs=lambda now: now % 5 < 0.4, edits=edits)
    assert time_to_pull(server, limit=10_000.0) < 1.2 * BLOCKS * takes * 5 / 0.4
    assert sum(server.asked.values()) < 1.2 * BLOCKS


@pytest.mark.parametrize("edits", [np.inf, 2.0], ids=["still", "living"])
def test_a_pull_goes_on_where_a_server_ended_that_comes_back(edits: float) -> None:
    server = Server(1.0, runs=lambda now: not 20 < now < 200, edits=edits)
    assert time_to_pull(server, limit=10_000.0) < 180 + 2 * BLOCKS
    assert len([block for after, block in server.asked if after == 0]) == BLOCKS
