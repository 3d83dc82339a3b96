"""The slots of SplatOrder messages, as viewers read them and sorters write them."""

from __future__ import annotations

from array import array
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rosplat_core import _core

if TYPE_CHECKING:
    from rosplat_msgs.msg import SplatOrder

OrderError = _core.OrderError
SLOTS, PACKED, SHARED = 0, 1, 2


class OrderReader:
    """A viewer's side: the slots of its orders, whichever way they came."""

    def __init__(self) -> None:
        self._reader = _core.OrderReader()

    @property
    def key(self) -> int:
        """The value for ViewCamera.segment_key; 0 while no segment of the sorter can be read."""
        return self._reader.key

    def read(self, message: SplatOrder) -> NDArray[np.uint32]:
        """The slots of an order, uint32 (n,), unchecked against the map.

        Raises OrderError where its fields contradict each other, or shared memory has it no more.
        """
        if message.encoding == SLOTS:
            return np.frombuffer(message.slots, np.uint32)
        return self._reader.read(
            message.encoding,
            message.packed,
            message.count,
            message.slot_bits,
            message.segment,
            message.generation,
        )


def pack(slots: NDArray[np.uint32], bits: int) -> array[int]:
    """Slots below 2^bits, uint32 (n,), as SplatOrder.packed."""
    packed = array("B", [0]) * ((len(slots) * bits + 7) // 8)
    _core.pack(slots, bits, packed)
    return packed
