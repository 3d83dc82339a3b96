"""Slots by pages: each given once, the lowest first, holes before new ones."""

import numpy as np
import pytest

from rosplat_tools.streaming.slot_allocator import SlotAllocator


def test_holes_are_used_before_the_map_grows() -> None:
    allocator = SlotAllocator()
    first, second, third = (allocator.take(count) for count in (1500, 1024, 10))
    assert [first[0], second[0], third[0]] == [0, 2048, 3072]
    assert allocator.slots == 4096
    allocator.give_back(second)
    allocator.give_back(first)
    assert allocator.slots == 1024
    again = allocator.take(3 * 1024 + 1)
    assert set(again // 1024) == {0, 1, 2, 4}
    assert (np.diff(again.astype(int)) > 0).all()
    assert allocator.slots == 5 * 1024


def test_more_than_there_is_takes_nothing() -> None:
    allocator = SlotAllocator(pages=3)
    taken = allocator.take(2048)
    with pytest.raises(MemoryError, match="1,025 slots"):
        allocator.take(1025)
    assert allocator.slots == 2048
    allocator.give_back(taken)
    assert len(allocator.take(3 * 1024)) == 3072


def test_nothing_takes_nothing() -> None:
    allocator = SlotAllocator()
    assert len(allocator.take(0)) == allocator.slots == 0
