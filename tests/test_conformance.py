"""Every receiver of a map makes the same of the same batches."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from conformance import CASES, Case, Receiver
from numpy.typing import NDArray

from rosplat_core.maps import GaussianMap
from rosplat_msgs.msg import GaussianArray
from rosplat_sorter.edits import EMPTY, decode, pose_values
from rosplat_sorter.map import SplatMap
from rosplat_sorter.map_pull import Arrival
from rosplat_tools import _published_map as cpp
from rosplat_tools import messages
from rosplat_tools.slot_map import SlotMap
from rviz_gaussian_plugin.from_messages import apply


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

    def slots(self) -> NDArray[np.uint32]:
        """Those in use, ascending."""
        return np.unique(self.map.slots[self.map.extents != EMPTY])

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


class CppPublisher:
    """That of one in C++, whose calls take what batches say."""

    revision = missed = None

    def __init__(self, send: Callable[[dict[str, Any]], None] = lambda fields: None) -> None:
        """send: takes the fields of each batch that goes out."""
        self._left_out = 0
        self.map = cpp.PublishedMap("map", 10**6, "none", send, lambda: (0, 0), self._on_warning)

    def _on_warning(self, text: str) -> None:
        self._left_out = int(text.split()[0])

    def take(self, message: GaussianArray, arrival: Arrival = Arrival.HEARD) -> int:
        assert arrival is Arrival.HEARD
        self._left_out = 0
        slots = message.slots.tolist()
        if message.operation == GaussianArray.MOVE:
            poses = {
                group: (*position, *orientation)
                for group, (position, orientation) in zip(
                    message.groups, map(pose_values, message.poses), strict=True
                )
            }
            self.map.move(poses, None)
        elif message.operation == GaussianArray.DELETE and slots:
            self.map.erase(slots, None)
        elif message.operation == GaussianArray.DELETE:
            self.map.erase_from(message.first_slot, message.count, None)
        else:
            splats = self._splats(message)
            if message.operation == GaussianArray.REPLACE:
                self.map.replace(cpp.Splats([], [], [], [], [], [0, 0, 0], False, []), None, None)
            if slots:
                self.map.upsert(slots, splats, message.group, None)
            else:
                self.map.upsert_from(message.first_slot, splats, message.group, None)
        return self._left_out

    def _splats(self, message: GaussianArray) -> Any:
        of = vars(messages.decode(message)[1]) if message.format else None
        names = ("positions", "orientations", "scales", "opacities", "sh")
        arrays = [np.ravel(of[name] if of else getattr(message, name)) for name in names]
        values = np.array_split(message.channels, len(message.channel_names) or 1)
        origin = message.origin
        return cpp.Splats(
            *arrays,
            [origin.x, origin.y, origin.z],
            message.antialiased,
            list(zip(message.channel_names, values, strict=False)),
        )

    def in_use(self, slot: int) -> bool:
        return any(slot in slots for _, slots, _ in self.map.groups())

    def slots(self) -> NDArray[np.uint32]:
        """Those in use, ascending."""
        return np.unique(np.concatenate([slots for _, slots, _ in self.map.groups()]))

    def place(self, group: int) -> tuple[float, float, float]:
        x, y, z = self.map.poses().get(group, [0.0, 0.0, 0.0])[:3]
        return x, y, z

    @property
    def origin(self) -> tuple[float, float, float]:
        origins = {group: splats.origin for group, _, splats in self.map.groups()}
        x, y, z = origins.get(0, (0.0, 0.0, 0.0))
        return x, y, z

    @property
    def channels(self) -> tuple[str, ...]:
        return tuple(self.map.groups()[0][2].arrays["channels"])

    @property
    def antialiased(self) -> bool:
        return bool(self.map.groups()[0][2].antialiased)


RECEIVERS = (Display, Sorter, Publisher, CppPublisher)


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
    if receiver not in (Publisher, CppPublisher):
        return True
    whose = {"revision", "map_id"}
    numbered = all(batch.refused or not whose & batch.fields.keys() for batch in case.batches)
    called = case.name not in NOT_CALLS and all(
        batch.refused not in NOT_ARGUMENTS for batch in case.batches
    )
    return numbered and "antialiasing" not in case.name and (called or receiver is Publisher)


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
