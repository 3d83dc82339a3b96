"""MapPull by names: what a receiver of a map asks for, and what it takes."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple

from rosplat_core import maps
from rosplat_core.maps import Arrival


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
    """What to do now: batches to apply in turn, a request to send, whether to subscribe and to join
    anew.
    """

    batches: list[tuple[Any, Arrival]] = field(default_factory=list)
    request: Request | None = None
    subscribe_anew: bool = False
    join_anew: bool = False


class Pull:
    """MapPull, by names."""

    def __init__(self) -> None:
        self._pull = maps.MapPull()

    @property
    def pulling(self) -> bool:
        return self._pull.pulling

    def hold(self, held: bool) -> None:
        self._pull.held = held

    def receive(self, of: Label, batch: Any, now: float, served: bool) -> Step:
        return _step(self._pull.receive((*of, batch), now, served))

    def miss(self, of: Label, now: float) -> None:
        self._pull.miss((*of, None), now)

    def subscribed_anew(self, now: float) -> None:
        self._pull.subscribed_anew(now)

    def restart(self, now: float) -> None:
        self._pull.restart(now)

    def answer(self, number: int, batches: Any, block: int, now: float, served: bool) -> Step:
        labelled = [(*of, batch) for of, batch in batches]
        return _step(self._pull.answer(number, labelled, block, now, served))

    def awaits(self, number: int) -> bool:
        return self._pull.awaits(number)

    def tick(self, now: float, served: bool) -> Step:
        return _step(self._pull.tick(now, served))


def _step(result: Any) -> Step:
    batches, request, *anew = result
    return Step(batches, Request(*request) if request else None, *anew)
