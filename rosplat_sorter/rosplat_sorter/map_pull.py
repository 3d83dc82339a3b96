"""What a receiver of a map asks its publisher for, and when: all that it lacks, until it has it.

Pure: knows batches by their labels, and time by numbers. map_pull.hpp is the same for displays.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Generic, TypeVar

from rosplat_core.slot_pages import PAGES

Batch = TypeVar("Batch")

PAUSE = 0.1  # from one beginning of a round to the next, and after a small answer [s]
SMALL = 1 << 14  # an answer that takes less [bytes]
MOST_ROUNDS = 32  # of a pull, before what was heard meanwhile has its turn
PATIENCE = 1.0  # with an answer; a server may not know a new client yet [s]
MOST_PATIENCE = 4.0  # which doubles up to this before it is given up [s]
OTHERS = 0.5  # with the answers of others, once a server had none [s]
RETRY = 1.0  # after a pull that came to nothing [s]
BLIND = 2.0  # from one request to the next where nobody seems to answer any [s]
MOST_WAITING = 1 << 26  # of what is heard while all before is pulled [bytes]


class Arrival(IntEnum):
    """How a batch came: heard on the topic, or pulled; after LAST, nothing is missing."""

    HEARD = 0
    PULLED = 1
    LAST = 2


@dataclass(frozen=True)
class Label:
    """What counts of a batch. bytes: the memory that it takes."""

    map_id: str
    revision: int
    replaces: bool
    bytes: int = 0


@dataclass(frozen=True)
class Request:
    """What to ask for, as in PullMap. number: what its answers are to be handed in with."""

    number: int
    map_id: str
    after_revision: int
    first_block: int


@dataclass
class Step(Generic[Batch]):
    """What to do now: batches to apply in turn, and a request to send."""

    batches: list[tuple[Batch, Arrival]] = field(default_factory=list)
    request: Request | None = None


class MapPull(Generic[Batch]):
    """Follows the batches of a map, and pulls what is missing where its publisher serves that.

    What is pulled is the map as it is at that moment, block by block; meanwhile it goes on
    changing, and what is heard waits. When all blocks are there, and the map was another at the
    first of them, what has changed since is pulled, and so on: usually that fits into one answer.
    Then the map is that of one revision, and what was heard above it follows. Where nothing can be
    pulled, batches are taken as they come.

    Nothing has to be heard first: who knows no map asks for whichever there is. Nor does anybody
    have to be known to serve: ROS tells late of a server, and of none while one of several is half
    known, so that what is missing is asked for now and then all the same.
    """

    def __init__(self) -> None:
        self.pulling = False
        """Whether something is missing that is on its way."""
        self.held = False
        """Whether to ask for nothing, because there is no room for answers."""
        self._map_id: str | None = None  # while none is known
        self._heard = 0  # the last revision from the topic
        self._revision = 0  # of the last batch that was passed on
        self._exact = True  # nothing up to that is missing
        self._base = 0  # the last revision of which nothing was missing
        self._round = 0  # revision of the first answer of this pull
        self._block = 0  # to go on with
        self._rounds = 0  # that this pull has begun
        self._number = 0  # of the last request
        self._asked: float | None = None  # when it was sent, if it wasn't answered [s]
        self._refused = False  # by a server that has no such map
        self._answered = False  # who seemed not to be there
        self._patience = PATIENCE
        self._ask_from = self._retry_from = self._blind_from = float("-inf")
        self._waiting: deque[tuple[Label, Batch]] = deque()
        self._waiting_bytes = 0

    def hear(self, label: Label, batch: Batch, now: float, served: bool) -> Step[Batch]:
        """A batch from the topic. served: whether somebody answers requests."""
        step: Step[Batch] = Step()
        if not label.revision:  # will be refused
            step.batches.append((batch, Arrival.HEARD))
            return step
        self._note(label)
        self._follow(label, batch, now, served or self._answered, step)
        return self._ask(now, served, step)

    @property
    def complete(self) -> int:
        """The last revision of which nothing was missing; what was passed on since is of later."""
        return self._base

    def miss(self, label: Label) -> None:
        """A batch from the topic that there was no room for: it is pulled."""
        if label.revision:
            self._note(label)
            self._exact = False

    def answer(
        self, number: int, batches: list[tuple[Label, Batch]], next_block: int, now: float,
        served: bool,
    ) -> Step[Batch]:  # fmt: skip
        """An answer to a request, of which several servers may send one each.

        One to an earlier request is ignored, and so is one after the first that has batches.
        """
        step: Step[Batch] = Step()
        if self._asked is None or number != self._number:
            return step
        if not batches:  # of a server without this map, where another may have it
            self._refused = True
            self._patience = min(self._patience, now - self._asked + OTHERS)
            return step
        self._asked = None
        if not self._is_sound([label for label, _ in batches], next_block):
            self._give_up(now, step)
            return step
        self.pulling = self._answered = True
        self._refused, self._patience = False, PATIENCE
        first = batches[0][0]
        self._map_id = first.map_id
        if first.replaces:
            self._base = self._block = 0
        if not self._block:
            self._round = first.revision
            self._rounds += 1
        self._revision = first.revision
        step.batches += [(batch, Arrival.PULLED) for _, batch in batches]
        self._block = next_block
        small = sum(label.bytes for label, _ in batches) < SMALL
        if next_block:
            self._ask_from = now + PAUSE * small
        else:
            self._base = self._round
        if not next_block and self._round == first.revision:
            step.batches[-1] = (batches[-1][1], Arrival.LAST)
            self._go_on(now, step)
        elif self._rounds > MOST_ROUNDS:
            self._give_up(now, step)
        return self._ask(now, served, step)

    def tick(self, now: float, served: bool) -> Step[Batch]:
        """To be called several times a second."""
        step: Step[Batch] = Step()
        late = self._asked is not None and now > self._asked + self._patience
        hopeless = late and (self._refused or self._patience >= MOST_PATIENCE)
        if self.pulling and (hopeless or not (served or self._answered)):
            self._give_up(now, step)
        elif late:
            self._patience *= 2
            self._asked = None
        return self._ask(now, served, step)

    def _note(self, label: Label) -> None:
        """What a batch from the topic says of the map."""
        if label.map_id != self._map_id:
            if self._map_id is not None:
                self._stop()
            self._begin(label.map_id)
        again = label.revision <= self._heard  # played once more, by a bag
        self._heard = label.revision
        if again:
            self._stop()
            self._revision, self._base, self._exact = label.revision - 1, 0, label.replaces

    def _begin(self, map_id: str) -> None:
        """What was asked for while no map was known may be this one."""
        self._map_id = map_id
        self._heard = self._revision = self._base = 0
        self._exact = True  # nothing is missing of an empty map
        self._retry_from = float("-inf")

    def _stop(self) -> None:
        self.pulling, self._asked, self._block, self._rounds = False, None, 0, 0
        self._refused, self._patience = False, PATIENCE
        self._waiting.clear()
        self._waiting_bytes = 0

    def _follow(
        self, label: Label, batch: Batch, now: float, served: bool, step: Step[Batch]
    ) -> None:
        if label.revision <= self._revision:
            return  # what was pulled has overtaken it
        if label.replaces:
            self._stop()
            self._exact = True
        elif self.pulling:
            self._wait(label, batch)
            return
        elif label.revision > self._revision + 1:
            if served and now >= self._retry_from:
                self._pull()
                self._wait(label, batch)
                return
            self._exact = False
        self._revision = label.revision
        if self._exact:
            self._base = label.revision
        step.batches.append((batch, Arrival.HEARD))

    def _pull(self) -> None:
        self.pulling, self._asked = True, None  # what was asked for blindly may be lost

    def _wait(self, label: Label, batch: Batch) -> None:
        self._waiting.append((label, batch))
        self._waiting_bytes += label.bytes
        # The oldest go: what then lacks is a gap.
        while self._waiting_bytes > MOST_WAITING and len(self._waiting) > 1:
            self._waiting_bytes -= self._waiting.popleft()[0].bytes

    def _go_on(self, now: float, step: Step[Batch]) -> None:
        """With what was heard meanwhile, all before it being there."""
        waiting = list(self._waiting)
        self._stop()
        self._exact = True
        for label, batch in waiting:
            self._follow(label, batch, now, True, step)
        if self._revision < self._heard and not self.pulling:  # there was no room for the last
            self._exact = False

    def _give_up(self, now: float, step: Step[Batch]) -> None:
        waiting = list(self._waiting)
        self._stop()
        self._exact = self._answered = False
        self._retry_from = now + RETRY
        for label, batch in waiting:
            self._follow(label, batch, now, False, step)

    def _ask(self, now: float, served: bool, step: Step[Batch]) -> Step[Batch]:
        lacks = not self._exact or self._map_id is None
        if lacks and (served or self._answered) and now >= self._retry_from and not self.pulling:
            self._pull()
        blind = lacks and not self.pulling and now >= max(self._blind_from, self._retry_from)
        wanted = (self.pulling and now >= self._ask_from) or blind
        if wanted and self._asked is None and not self.held:
            if not self._block:
                self._ask_from = now + PAUSE
            self._blind_from = now + BLIND
            self._asked = now
            self._number += 1
            step.request = Request(self._number, self._map_id or "", self._base, self._block)
        return step

    def _is_sound(self, labels: list[Label], next_block: int) -> bool:
        if labels[0].revision < max(1, self._revision):
            return False
        block = 0 if labels[0].replaces else self._block
        map_id = labels[0].map_id if self._map_id is None else self._map_id
        return (next_block == 0 or block < next_block < PAGES) and all(
            label.map_id == map_id and label.revision == labels[0].revision for label in labels
        )
