"""Every receiver of a map makes the same of the same batches."""

from __future__ import annotations

import numpy as np
import pytest
from conformance import CASES, Case, Receiver

from rosplat_msgs.msg import GaussianArray
from rosplat_sorter.edits import EMPTY, decode
from rosplat_sorter.map import SplatMap
from rosplat_sorter.map_pull import Arrival
from rosplat_tools import messages
from rosplat_tools.slot_map import SlotMap
from rviz_gaussian_plugin.from_messages import apply
from rviz_gaussian_plugin.offscreen import GaussianMap


class Display:
    """The display's map."""

    def __init__(self) -> None:
        self.map = GaussianMap()

    def take(self, message: GaussianArray, arrival: Arrival = Arrival.HEARD) -> int:
        return int(apply(self.map, message, arrival)["dropped"])

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
    def antialiased(self) -> bool:
        return bool(self.map.antialiased)

    @property
    def revision(self) -> int:
        return int(self.map.revision)

    @property
    def missed(self) -> int:
        return int(self.map.missed)


class Sorter:
    """The sidecar's map, which knows nothing of how splats are drawn."""

    antialiased = None

    def __init__(self) -> None:
        self.map = SplatMap()

    def take(self, message: GaussianArray, arrival: Arrival = Arrival.HEARD) -> int:
        self.map.apply(decode(message, arrival))
        return self.map.rejected

    def in_use(self, slot: int) -> bool:
        return bool((self.map.extents[self.map.slots == slot] != EMPTY).any())

    def place(self, group: int) -> tuple[float, float, float]:
        x, y, z = self.map.poses.get(group, np.eye(4))[:3, 3].tolist()
        return x, y, z

    @property
    def origin(self) -> tuple[float, float, float]:
        x, y, z = self.map.origins.get(0, np.zeros(3)).tolist()
        return x, y, z

    @property
    def channels(self) -> tuple[str, ...]:
        return self.map.channels

    @property
    def revision(self) -> int:
        return self.map.revision

    @property
    def missed(self) -> int:
        return self.map.missed


class Publisher:
    """A publisher's own copy of its map."""

    revision = missed = None

    def __init__(self) -> None:
        self.map = SlotMap()

    def take(self, message: GaussianArray, arrival: Arrival = Arrival.HEARD) -> int:
        assert arrival is Arrival.HEARD
        return messages.apply(message, self.map)

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
    def antialiased(self) -> bool:
        return self.map.snapshot()[1].antialiased


RECEIVERS = (Display, Sorter, Publisher)


def concerns(case: Case, receiver: type[Receiver]) -> bool:
    """A publisher misses none of its own batches, and mixes no filters."""
    whose = {"revision", "map_id"}
    numbered = all(batch.refused or not whose & batch.fields.keys() for batch in case.batches)
    return receiver is not Publisher or (numbered and "antialiasing" not in case.name)


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
            with pytest.raises(ValueError, match=rf"\b{batch.refused}\b"):
                target.take(message, batch.arrival)
            continue
        assert target.take(message, batch.arrival) == batch.dropped
        revision = message.revision
    assert [slot for slot in case.looked_at if target.in_use(slot)] == list(case.in_use)
    for known, expected in (
        (target.origin, case.origin),
        (target.antialiased, case.antialiased),
        (target.missed, case.missed),
        (target.revision, revision),
    ):
        assert known is None or known == expected
    assert target.channels == case.channels
    for group, place in case.places.items():
        assert target.place(group) == place
