"""Orders in shared memory: what the sorter writes, viewers read, and nothing stays behind."""

import os
import struct
import subprocess
import sys
import types

import numpy as np
import pytest

from rosplat_sorter import shared_orders
from rosplat_sorter.order_slots import PACKED, SHARED, OrderError, OrderReader, pack
from rosplat_sorter.shared_orders import (
    FOLDER,
    MAGIC,
    OrderBuffer,
    SharedOrders,
    memory_of,
    remove_stale,
)


@pytest.fixture
def orders():
    orders = SharedOrders()
    yield orders
    orders.close()


def message(**fields):
    """A SplatOrder, as far as its slots go."""
    values = {"packed": b"", "count": 0, "slot_bits": 0, "segment": "", "generation": 0}
    return types.SimpleNamespace(**(values | fields))


def write(buffer, slots):
    buffer.begin(len(slots))[:] = slots
    segment, generation = buffer.finish()
    return message(encoding=SHARED, count=len(slots), segment=segment, generation=generation)


def test_a_reader_gets_what_was_written(orders):
    buffer, reader = OrderBuffer(orders), OrderReader()
    first = write(buffer, [3, 1, 2])
    second = write(buffer, np.arange(100_000))  # first was small: a larger segment
    assert reader.read(first).tolist() == [3, 1, 2]  # one order back is still there
    np.testing.assert_array_equal(reader.read(second), np.arange(100_000))
    assert reader.key == orders.key
    third = write(buffer, [])
    with pytest.raises(OrderError):
        reader.read(first)
    assert reader.read(third).size == 0
    np.testing.assert_array_equal(reader.read(second), np.arange(100_000))
    buffer.begin(4)  # and never finished: a crash in the middle of a sort
    with pytest.raises(OrderError, match="another order"):
        reader.read(second)


def test_what_was_lent_is_taken_back_while_it_is_mapped(orders):
    buffer, seen = OrderBuffer(orders), []
    slots = buffer.begin(3)
    memory = memory_of(slots)
    memory.lent.callback(lambda: seen.append(memory[:8]))
    buffer.begin(2)
    assert not seen
    slots = buffer.begin(100_000)  # in a larger segment
    assert seen == [MAGIC]
    memory_of(slots).lent.callback(seen.append, "the other")
    orders.close()
    assert seen[1:] == ["the other"]
    assert memory_of(np.zeros(3, np.uint32)) is None


def test_memory_is_read_into_again_but_never_while_an_array_holds_it(orders):
    buffer, reader = OrderBuffer(orders), OrderReader()
    held = reader.read(write(buffer, np.arange(1000)))
    dropped = reader.read(write(buffer, np.arange(1000, 2000)))
    address = dropped.ctypes.data
    part = dropped[10:20]
    del dropped
    assert reader.read(write(buffer, np.arange(5))).ctypes.data != address
    assert part.tolist() == list(range(1010, 1020))
    del part
    assert reader.read(write(buffer, np.arange(999))).ctypes.data == address
    np.testing.assert_array_equal(held, np.arange(1000))


def test_the_probe_s_key_comes_with_any_order(orders):
    reader = OrderReader()
    slots = np.array([5, 1, 7], np.uint32)
    order = message(encoding=PACKED, packed=pack(slots, 3), count=3, slot_bits=3)
    assert reader.read(order).tolist() == [5, 1, 7]
    assert reader.key == 0
    order.segment = orders.probe
    reader.read(order)
    assert reader.key == orders.key
    orders.close()
    reader.read(order)
    assert reader.key == 0


def test_a_segment_is_what_the_message_says_in_words():
    """Written by nothing but the words of SplatOrder.msg."""
    name, slots = f"rosplat_order_plain_{os.getpid()}", [5, 1, 7]
    path, header = FOLDER / name, struct.pack("=8sIIQQ", b"ROSPLAT\0", 1, 0, 99, 6)
    path.write_bytes(header.ljust(4096, b"\0") + struct.pack("=3I", *slots))
    try:
        reader = OrderReader()
        order = message(encoding=SHARED, count=3, segment=name, generation=6)
        assert reader.read(order).tolist() == slots
        assert reader.key == 99
        for wrong in (4, 7, 8):
            order.generation = wrong
            with pytest.raises(OrderError, match="another order"):
                reader.read(order)
        path.write_bytes(struct.pack("=8sIIQQ", b"ROSPLAT\0", 3, 0, 99, 6).ljust(5000, b"\0"))
        order.generation = 6
        with pytest.raises(OrderError, match="is of version 3, and 1 is known"):
            reader.read(order)
        assert reader.key == 0
    finally:
        path.unlink()


@pytest.mark.parametrize("bits", [1, 7, 8, 20, 25, 32])
def test_packing_equals_its_plain_twin(bits):
    slots = np.random.default_rng(bits).integers(0, 2**bits, 1001, np.uint32)
    plain = (slots[:, None] >> np.arange(bits, dtype=np.uint32) & 1).astype(np.uint8)
    expected = np.packbits(plain.ravel(), bitorder="little")
    np.testing.assert_array_equal(np.frombuffer(pack(slots, bits), np.uint8), expected)


def files():
    return {path.name for path in FOLDER.glob(f"{shared_orders.PREFIX}*")}


def test_what_is_no_longer_used_is_removed():
    before = files()
    orders = SharedOrders()
    buffers = [OrderBuffer(orders) for _ in range(2)]
    for count in (10, 10, 1000):
        for buffer in buffers:
            write(buffer, np.zeros(count))
    assert len(files() - before) == 5  # the probe, two for each
    buffers[0].close()
    assert len(files() - before) == 3
    orders.close()
    assert not files() - before


# A sorter that has given out one order and is at the next: prints where the first one is.
SORTER = """
import sys
from rosplat_sorter.shared_orders import OrderBuffer, SharedOrders
buffer = OrderBuffer(SharedOrders())
buffer.begin(3)[:] = 1, 2, 3
place = buffer.finish()
buffer.begin(3)
print(*place, flush=True)
sys.stdin.read()
"""


def test_the_next_start_removes_what_a_crash_left_behind():
    """The living keep theirs."""
    processes = [
        subprocess.Popen(
            [sys.executable, "-c", SORTER], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        for _ in range(2)
    ]
    try:
        orders = []
        for process in processes:
            segment, generation = process.stdout.readline().split()
            orders.append(
                message(encoding=SHARED, count=3, segment=segment, generation=int(generation))
            )
        processes[1].kill()
        processes[1].wait()
        reader = OrderReader()
        for order in orders:  # a crash takes no order from those who read
            assert reader.read(order).tolist() == [1, 2, 3]
        before = files()
        SharedOrders().close()
        assert reader.read(orders[0]).tolist() == [1, 2, 3]
        with pytest.raises(OrderError, match="opened"):
            reader.read(orders[1])
        assert reader.key == 0  # what the next sorter takes for: in the message, please
        assert len(before - files()) == 3  # the probe and both segments
    finally:
        for process in processes:
            process.kill()
            process.communicate()
        remove_stale()


def test_room_is_left_to_others(orders, monkeypatch):
    free = types.SimpleNamespace(f_bavail=20, f_frsize=4096)
    monkeypatch.setattr(os, "statvfs", lambda path: free)
    with pytest.raises(OSError, match="no room for 4 MiB in /dev/shm"):
        OrderBuffer(orders).begin(1_000_000)
    assert OrderBuffer(orders).begin(100).size == 100
