"""Slots by strips: each given once, the lowest first, holes before new ones."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rosplat_tools.streaming.slot_allocator import SlotAllocator, slots_for


def test_holes_are_used_before_the_map_grows() -> None:
    allocator = SlotAllocator()
    first, second, third = (allocator.allocate(count) for count in (2048, 1024, 10))
    assert [first[0], second[0], third[0]] == [0, 2048, 3072]
    assert allocator.slots == 3072 + 128
    allocator.give_back(second)
    allocator.give_back(first)
    assert allocator.slots == 128
    again = allocator.allocate(4 * 1024)
    assert set(again // 1024) == {0, 1, 2, 4}
    assert (np.diff(again.astype(int)) > 0).all()


def test_small_sets_share_pages_and_large_ones_have_theirs() -> None:
    allocator = SlotAllocator()
    small = [allocator.allocate(100) for _ in range(8)]
    large = allocator.allocate(2000)
    assert {page for slots in small for page in slots // 1024} == {0}
    assert set(large // 1024) == {1, 2}
    for slots in small:
        allocator.give_back(slots)
    assert set(allocator.allocate(800) // 1024) == {0}


@settings(deadline=None)
@given(data=st.data())
def test_no_slot_is_given_twice(data: st.DataObject) -> None:
    pages = 12
    allocator = SlotAllocator(pages)
    held: list[np.ndarray] = []
    for _ in range(data.draw(st.integers(1, 40))):
        if held and data.draw(st.booleans()):
            allocator.give_back(held.pop(data.draw(st.integers(0, len(held) - 1))))
            continue
        before = allocator.slots
        try:
            held.append(allocator.allocate(data.draw(st.integers(1, 4000))))
        except MemoryError:
            assert allocator.slots == before
        every = np.concatenate([np.zeros(0, np.uint32), *held])
        assert len(np.unique(every)) == len(every)
        assert every.max(initial=0) < 1024 * pages
        assert allocator.slots == sum(slots_for(len(slots)) for slots in held)


def test_more_than_there_is_takes_nothing() -> None:
    allocator = SlotAllocator(pages=3)
    taken = allocator.allocate(2048)
    with pytest.raises(MemoryError, match="1,025 slots"):
        allocator.allocate(1025)
    assert allocator.slots == 2048
    allocator.give_back(taken)
    assert len(allocator.allocate(3 * 1024)) == 3072


def test_nothing_takes_nothing() -> None:
    allocator = SlotAllocator()
    assert len(allocator.allocate(0)) == allocator.slots == 0


@pytest.mark.parametrize(("count", "slots"), [(0, 0), (1, 128), (128, 128), (129, 256)])
def test_slots_are_given_by_strips(count: int, slots: int) -> None:
    assert slots_for(count) == slots
