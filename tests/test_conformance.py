"""Every receiver of a map makes the same of the same batches."""

from __future__ import annotations

import math
import re
from array import array
from collections.abc import Callable
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from conformance import CASES, Batch, Case, Receiver
from numpy.typing import NDArray

from rosplat_core.maps import Arrival, GaussianMap, PublishedBatch, PublishedMap
from rosplat_msgs.msg import GaussianArray
from rosplat_ros.batches import pose_values
from rosplat_sorter.map import SplatMap
from rosplat_testing import messages, slot_map


class Display:
    """A receiver's map in C++: a display's, or the sorter's, which keeps no harmonics."""

    map: GaussianMap

    def __init__(self) -> None:
        self.map = GaussianMap()

    def take(self, message: GaussianArray, arrival: Arrival = Arrival.HEARD) -> int:
        return int(self.map.apply(message, arrival)["dropped"])

    def in_use(self, slot: int) -> bool:
        return bool(self.map.in_use(slot))

    def place(self, group: int) -> tuple[float, float, float]:
        x, y, z = self.map.pose(group)[0]
        return x, y, z

    @property
    def origin(self) -> tuple[float, float, float]:
        x, y, z = self.map.origin() or (0.0, 0.0, 0.0)
        return x, y, z

    @property
    def channels(self) -> tuple[str, ...]:
        return tuple(self.map.channels)

    @property
    def model(self) -> int:
        return int(self.map.model)

    @property
    def revision(self) -> int:
        return int(self.map.revision)

    @property
    def missed(self) -> int:
        return int(self.map.missed)


class Sorter(Display):
    """The sidecar's."""

    map: SplatMap

    def __init__(self) -> None:
        self.map = SplatMap()

    def slots(self) -> NDArray[np.uint32]:
        """Those in use, ascending."""
        slots = np.sort(self.map.slots_and_groups()[0])
        return slots[[self.map.in_use(slot) for slot in slots.tolist()]]


class Twin:
    """The map in plain NumPy that tests hold others against."""

    revision = missed = None

    def __init__(self) -> None:
        self.map = slot_map.SlotMap()

    def take(self, message: GaussianArray, arrival: Arrival = Arrival.HEARD) -> int:
        assert arrival is Arrival.HEARD
        return slot_map.apply(message, self.map)

    def in_use(self, slot: int) -> bool:
        return any(slot in group.slots for group in self.map.groups())

    def place(self, group: int) -> tuple[float, float, float]:
        x, y, z = self.map.poses.get(group, np.eye(4))[:3, 3].tolist()
        return x, y, z

    @property
    def origin(self) -> tuple[float, float, float]:
        origins = {part.group: part.splats.origin for part in self.map.groups()}
        x, y, z = origins.get(0, np.zeros(3)).tolist()
        return x, y, z

    @property
    def channels(self) -> tuple[str, ...]:
        return tuple(self.map.snapshot()[1].channels)

    @property
    def model(self) -> int:
        return self.map.snapshot()[1].model


@dataclass(frozen=True)
class Raw:
    """What a batch says its splats are, as Splats would check it."""

    message: GaussianArray

    def __getattr__(self, name: str) -> Any:
        if self.message.format:
            return getattr(messages.decode(self.message)[1], name)
        value = getattr(self.message, name)
        if not isinstance(value, array):
            return value
        shape = len(self), (self.message.sh_degree + 1) ** 2, 3
        as_told = name == "sh" and len(value) == math.prod(shape)
        return np.reshape(value, shape) if as_told else np.asarray(value)

    def __len__(self) -> int:
        return int(self.message.count)

    @property
    def origin(self) -> tuple[float, float, float]:
        return self.message.origin.x, self.message.origin.y, self.message.origin.z

    @property
    def channels(self) -> Any:
        names = self.message.channel_names
        values = np.array_split(self.message.channels, len(names) or 1)
        return SimpleNamespace(items=lambda: zip(names, values, strict=False))


NO_SPLATS = GaussianArray()


class Publisher:
    """A publisher's map, whose calls take what batches say."""

    revision = missed = None

    def __init__(self, send: Callable[[PublishedBatch], None] = lambda batch: None) -> None:
        """send: takes each batch that goes out."""
        self._left_out = 0
        self.map = PublishedMap(10**6, "none", send, self._on_warning, lambda: None)

    def _on_warning(self, text: str) -> None:
        self._left_out = int(text.split()[0])

    def take(self, message: GaussianArray, arrival: Arrival = Arrival.HEARD) -> int:
        assert arrival is Arrival.HEARD
        self._left_out = 0
        slots = np.asarray(message.slots)
        if message.operation == GaussianArray.MOVE:
            poses = {
                group: (*position, *orientation)
                for group, (position, orientation) in zip(
                    message.groups, map(pose_values, message.poses), strict=True
                )
            }
            self.map.move(poses, None)
        elif message.operation == GaussianArray.DELETE and len(slots):
            self.map.erase(slots, None)
        elif message.operation == GaussianArray.DELETE:
            self.map.erase_from(message.first_slot, message.count, None)
        else:
            if message.operation == GaussianArray.REPLACE:
                self.map.replace(Raw(NO_SPLATS), None, None)
            named = slots if len(slots) else message.first_slot
            self.map.upsert(named, Raw(message), message.group, None)
        return self._left_out

    def in_use(self, slot: int) -> bool:
        return any(slot in slots for _, _, slots, _ in self.map.groups())

    def slots(self) -> NDArray[np.uint32]:
        """Those in use, ascending."""
        return np.unique(np.concatenate([slots for _, _, slots, _ in self.map.groups()]))

    def place(self, group: int) -> tuple[float, float, float]:
        x, y, z = self.map.poses().get(group, [0.0, 0.0, 0.0])[:3]
        return x, y, z

    @property
    def origin(self) -> tuple[float, float, float]:
        origins = {group: arrays["origin"] for group, _, _, arrays in self.map.groups()}
        x, y, z = origins.get(0, np.zeros(3)).tolist()
        return x, y, z

    @property
    def channels(self) -> tuple[str, ...]:
        return tuple(self.map.groups()[0][3]["channels"])

    @property
    def model(self) -> int:
        return int(self.map.groups()[0][3]["model"])


RECEIVERS = (Display, Sorter, Twin, Publisher)


# What no call can say, by the field that is refused, or by the case.
NOT_ARGUMENTS = {
    "revision", "operation", "format", "payload", "sh_degree", "sh", "groups", "count",
}  # fmt: skip
NOT_CALLS = {
    "a slot listed twice holds the last",  # it is refused
    "refused: a count beyond the arrays",
    "refused: channels without names",
    "refused: fewer poses than groups",
    "refused: a delete with positions",
    "refused: a delete with channels",
    "refused: a move with slots",
}


def concerns(case: Case, receiver: type[Receiver]) -> bool:
    """A publisher misses none of its own batches, and mixes no filters."""
    if receiver not in (Twin, Publisher):
        return True
    whose = {"revision", "map_id"}
    numbered = all(batch.refused or not whose & batch.fields.keys() for batch in case.batches)
    called = case.name not in NOT_CALLS and all(
        batch.refused not in NOT_ARGUMENTS for batch in case.batches
    )
    return numbered and "the model" not in case.name and (called or receiver is Twin)


def refuses(target: Receiver, message: GaussianArray, batch: Batch) -> None:
    """Asserts that a receiver refuses a batch and names the field."""
    try:
        target.take(message, batch.arrival)
    except ValueError as error:
        assert re.search(rf"\b{batch.refused}\b", str(error)), error
        return
    where = {
        Twin: "check() of rosplat_testing/messages.py does so",
        Publisher: "published_map.cpp does so, or NOT_ARGUMENTS has the field, which no call takes",
    }.get(type(target), "check() of gaussian_map.cpp does so")
    pytest.fail(f"{batch.refused} is not refused: {where}")


@pytest.mark.parametrize(
    ("receiver", "case"),
    [
        pytest.param(receiver, case, id=f"{receiver.__name__}-{case.name}")
        for receiver in RECEIVERS
        for case in CASES
        if concerns(case, receiver)
    ],
)
def test_receivers_agree(receiver: type[Receiver], case: Case) -> None:
    target = receiver()
    revision = 0
    for number, batch in enumerate(case.batches, 1):
        message = batch.message(number)
        if batch.refused:
            refuses(target, message, batch)
            continue
        assert target.take(message, batch.arrival) == batch.dropped
        revision = message.revision
    assert [slot for slot in case.looked_at if target.in_use(slot)] == list(case.in_use)
    for known, expected in (
        (target.origin, case.origin),
        (target.model, case.model),
        (target.missed, case.missed),
        (target.revision, revision),
    ):
        assert known is None or known == expected
    assert target.channels == case.channels
    for group, place in case.places.items():
        assert target.place(group) == place
