"""The worker answers the newest camera only, and outlives what its peers and devices do to it."""

import os
import sys
import threading
import time
import types

import numpy as np
import pytest

from rosplat_core.maps import Arrival
from rosplat_msgs.msg import SplatOrder
from rosplat_ros.held_map import HeldMap
from rosplat_sorter import backends
from rosplat_sorter.backends import BACKENDS, Entry
from rosplat_sorter.backends.native_backend import NativeBackend
from rosplat_sorter.backends.numpy_backend import NumpyBackend
from rosplat_sorter.map import SplatMap
from rosplat_sorter.order_slots import OrderReader
from rosplat_sorter.shared_orders import FOLDER
from rosplat_sorter.worker import FORGET_AFTER, MAX_VIEWS, Worker

PATIENCE = 180.0  # with threads, however busy the machine is [s]


class Recorder:
    """Keeps orders, with their slots where a message has them, and lines of the log."""

    def __init__(self):
        self.answers = []
        self.lines = []
        self._told = threading.Condition()

    def publish(self, order):
        packed = order.encoding == SplatOrder.PACKED
        slots = OrderReader().read(order) if packed else np.zeros(order.count, np.uint32)
        fields = {name: getattr(order, name) for name in order.get_fields_and_field_types()}
        with self._told:
            self.answers.append(types.SimpleNamespace(**fields | {"slots": slots}))
            self._told.notify()

    def inform(self, subject, text):
        with self._told:
            self.lines.append(text)
            self._told.notify()

    def warn(self, subject, text):
        self.inform(subject, text)

    def pull_again(self):
        self.inform("lost", "all is to come again")

    def wait(self, condition):
        with self._told:
            assert self._told.wait_for(condition, timeout=PATIENCE), (self.answers, self.lines)

    def answer(self, sequence=None, revision=None, view_id="view", backend=None):
        """Waits for the answer to a sequence, with a revision or by a backend."""

        def matching():
            return [
                answer
                for answer in self.answers
                if answer.view_id == view_id
                and sequence in (None, answer.sequence)
                and revision in (None, answer.revision)
                and backend in (None, answer.backend)
            ]

        self.wait(matching)
        return matching()[-1]

    def said(self, text):
        self.wait(lambda: any(text in line for line in self.lines))


class GatedBackend(NumpyBackend):
    """Sorts when it may; counts."""

    name = "gated"
    gate = threading.Event()
    sorting = threading.Event()
    sorts = 0

    def order(self, view, allocate):
        type(self).sorts += 1
        self.sorting.set()
        assert self.gate.wait(PATIENCE)
        return super().order(view, allocate)


class BrokenBackend(NumpyBackend):
    """A GPU that runs out of memory, with as much of the map as it had until then."""

    name = "broken"
    where = "order"

    def update(self, splats, changed):
        if self.where == "update" and splats.splats:
            raise RuntimeError("CUDA out of memory")
        super().update(splats, changed)

    def order(self, view, allocate):
        if self.where == "order":
            raise RuntimeError("CUDA out of memory")
        return super().order(view, allocate)


def has_room_for(count, update):
    """A backend's update, of maps that are no larger."""

    def limited(self, splats, changed):
        if splats.splats > count:
            raise MemoryError
        update(self, splats, changed)

    return limited


@pytest.fixture(autouse=True)
def test_backends(monkeypatch):
    module = types.ModuleType("rosplat_sorter.backends.test_backend")
    module.GatedBackend, module.BrokenBackend = GatedBackend, BrokenBackend
    monkeypatch.setitem(sys.modules, module.__name__, module)
    for name in ("gated", "broken"):
        entry = Entry("test_backend", f"{name.capitalize()}Backend")
        monkeypatch.setitem(BACKENDS, name, entry)
    GatedBackend.gate.set()
    GatedBackend.sorting.clear()
    GatedBackend.sorts = 0
    BrokenBackend.where = "order"


@pytest.fixture
def start():
    workers = []

    def start(backend="gated"):
        host = Recorder()
        held = HeldMap(SplatMap(), "gaussians", host)
        held.pull_again = host.pull_again
        workers.append(Worker(held, host.publish, host, backend, threads=1))
        return workers[-1], host

    yield start
    GatedBackend.gate.set()
    for worker in workers:
        worker.close()


def test_an_order_answers_its_view(start, make_batch, make_look):
    worker, host = start()
    worker._held.add(make_batch(3, frame_id="map"))
    look = make_look(sequence=7)
    look.header.stamp.sec = 42
    worker.set_camera(look)
    answer = host.answer(7)
    assert list(answer.slots) == [2, 1, 0]
    assert answer.header.stamp.sec == 42
    assert (answer.map_id, answer.revision, answer.backend) == ("map", 1, "gated")
    assert 0 < answer.sort_time < 10


def test_a_view_is_answered_once_a_map_begins_and_when_it_changes(start, make_batch, make_look):
    worker, host = start()
    worker.set_camera(make_look())
    worker._held.add(make_batch(3, operation=0))
    assert len(host.answer(revision=1).slots) == 3
    worker._held.add(make_batch(2, revision=2, operation=2))
    assert list(host.answer(revision=2).slots) == [2]
    worker._held.add(make_batch(1, revision=3, first_slot=7, positions=[0.0, 0.0, 1.5]))
    assert list(host.answer(revision=3).slots) == [2, 7]


def test_of_a_burst_only_the_newest_view_is_sorted(start, make_batch, make_look):
    worker, host = start()
    GatedBackend.gate.clear()
    worker._held.add(make_batch())
    worker.set_camera(make_look(sequence=1))
    assert GatedBackend.sorting.wait(PATIENCE)
    for sequence in range(2, 102):
        worker.set_camera(make_look(sequence=sequence, x=0.001 * sequence))
    GatedBackend.gate.set()
    host.answer(101)
    assert [answer.sequence for answer in host.answers] == [1, 101]
    assert GatedBackend.sorts == 2


def test_who_asks_for_no_order_gets_none(start, make_batch, make_look):
    worker, host = start()
    worker._held.add(make_batch())
    worker.set_camera(make_look(view_id="sorts itself", sequence=0))
    worker.set_camera(make_look(view_id="asks", sequence=1))
    host.answer(1, view_id="asks")
    assert [answer.view_id for answer in host.answers] == ["asks"]


def test_a_map_that_is_pulled_at_once_is_sorted_once(start, make_batch, make_look, monkeypatch):
    monkeypatch.setattr("rosplat_sorter.worker.PULL_PATIENCE", PATIENCE)
    worker, host = start()
    worker._held.add(make_batch(operation=0, revision=5), Arrival.PULLED)
    worker.set_camera(make_look(sequence=1))
    worker._held.add(make_batch(1, revision=5, first_slot=3), Arrival.PULLED)
    worker.set_camera(make_look(sequence=2))
    worker._held.add(make_batch(1, revision=5, first_slot=4), Arrival.LAST)
    worker.set_camera(make_look(sequence=3))
    assert len(host.answer(3).slots) == 5
    assert {len(answer.slots) for answer in host.answers} == {5}
    assert not [line for line in host.lines if "missed" in line]


def test_orders_during_a_long_pull_name_no_revision(start, make_batch, make_look, monkeypatch):
    """A viewer must not take them for orders of the whole map."""
    monkeypatch.setattr("rosplat_sorter.worker.PULL_PATIENCE", 0.1)
    worker, host = start()
    worker._held.add(make_batch(operation=0, revision=5))
    worker.set_camera(make_look(sequence=1))
    assert host.answer(1).revision == 5
    worker._held.add(make_batch(1, revision=9, first_slot=3), Arrival.PULLED)
    worker.set_camera(make_look(sequence=2))
    assert (host.answer(2).revision, len(host.answer(2).slots)) == (0, 4)
    worker._held.add(make_batch(1, revision=12, first_slot=4), Arrival.LAST)
    assert len(host.answer(2, revision=12).slots) == 5


def test_orders_of_a_map_that_lacks_a_batch_name_no_revision(start, make_batch, make_look):
    worker, host = start()
    worker._held.add(make_batch(operation=0))
    worker._held.add(make_batch(1, revision=3, first_slot=4))
    worker.set_camera(make_look(sequence=1))
    assert (host.answer(1).revision, len(host.answer(1).slots)) == (0, 4)
    worker._held.add(make_batch(1, revision=3, first_slot=3), Arrival.LAST)
    assert len(host.answer(1, revision=3).slots) == 5


def test_it_says_when_too_much_waits(start, make_batch, make_look, monkeypatch):
    monkeypatch.setattr("rosplat_ros.held_map.MOST_WAITING", 10 * 50 * 56)
    worker, host = start()
    GatedBackend.gate.clear()
    worker._held.add(make_batch())
    worker.set_camera(make_look())
    assert GatedBackend.sorting.wait(PATIENCE)
    revision = 1
    while not worker._held.busy:
        revision += 1
        worker._held.add(make_batch(50, revision=revision))
    assert revision == 12
    GatedBackend.gate.set()
    assert len(host.answer(revision=12).slots) == 50
    assert not worker._held.busy


def test_views_are_answered_between_batches_that_wait(start, make_batch, make_look, monkeypatch):
    monkeypatch.setattr("rosplat_sorter.worker.SLICE", 2 * 50 * 56)
    views = [str(number) for number in range(30)]
    worker, host = start()
    worker._held.add(make_batch(50))
    for view_id in views:
        worker.set_camera(make_look(view_id=view_id))
    for view_id in views:
        host.answer(view_id=view_id, revision=1)
    GatedBackend.gate.clear()
    GatedBackend.sorting.clear()
    worker._held.add(make_batch(50, revision=2))
    assert GatedBackend.sorting.wait(PATIENCE)
    for revision in range(3, 63):
        worker._held.add(make_batch(50, revision=revision))
    assert worker._held._backlog == 60 * 50 * 56
    GatedBackend.gate.set()
    for view_id in views:
        host.answer(view_id=view_id, revision=62)
    revisions = [answer.revision for answer in host.answers[len(views) :]]
    assert max(np.diff(revisions)) <= 2
    waiting = host.answers[len(views) : 2 * len(views)]
    assert {answer.view_id for answer in waiting} == set(views)  # each in its turn
    assert worker._held._backlog == 0


def test_of_batches_that_wait_none_is_applied_that_another_replaces(start, make_batch, make_look):
    worker, host = start()
    worker._held.add(make_batch())
    GatedBackend.gate.clear()
    worker.set_camera(make_look())
    assert GatedBackend.sorting.wait(PATIENCE)
    for revision in range(2, 20):
        worker._held.add(make_batch(50, revision=revision))
    worker._held.add(make_batch(5, operation=0, revision=20))
    worker._held.add(make_batch(1, revision=21, first_slot=5))
    assert worker._held._backlog == 6 * 56
    GatedBackend.gate.set()
    assert len(host.answer(revision=21).slots) == 6
    assert worker._held.edits == 3
    assert not [line for line in host.lines if "missed" in line]


def test_views_do_not_displace_each_other(start, make_batch, make_look):
    worker, host = start()
    worker._held.add(make_batch())
    for view_id in "abc":
        worker.set_camera(make_look(view_id=view_id))
    for view_id in "abc":
        assert len(host.answer(view_id=view_id).slots) == 3


def test_what_did_not_change_is_answered_but_not_sorted_again(start, make_batch, make_look):
    worker, host = start()
    worker._held.add(make_batch())
    worker.set_camera(make_look(sequence=1))
    first = host.answer(1)
    worker.set_camera(make_look(sequence=1))  # a sign of life
    worker.set_camera(make_look(sequence=2))
    second = host.answer(2)
    np.testing.assert_array_equal(second.slots, first.slots)
    worker.set_camera(make_look(sequence=3))
    host.answer(3)
    assert GatedBackend.sorts == 1
    assert [answer.sequence for answer in host.answers] == [1, 2, 3]
    worker.set_camera(make_look(sequence=4, x=1.0))
    host.answer(4)
    assert GatedBackend.sorts == 2


def test_a_map_that_is_played_once_more_is_sorted_again(start, make_batch, make_look):
    worker, host = start()
    worker._held.add(make_batch(operation=0))
    worker.set_camera(make_look(sequence=1))
    assert len(host.answer(1).slots) == 3
    worker._held.add(make_batch(5, operation=0))  # of the same revision
    worker.set_camera(make_look(sequence=2))
    assert len(host.answer(2).slots) == 5


def test_silent_views_are_forgotten(start, make_batch, make_look, monkeypatch):
    worker, host = start()
    worker._held.add(make_batch())
    worker.set_camera(make_look(view_id="gone"))
    host.answer(view_id="gone")
    now = time.monotonic() + FORGET_AFTER + 1
    monkeypatch.setattr(time, "monotonic", lambda: now)
    worker.set_camera(make_look(view_id="here"))
    host.answer(view_id="here")
    worker._held.add(make_batch(revision=2))
    host.answer(view_id="here", revision=2)
    assert [answer.view_id for answer in host.answers] == ["gone", "here", "here"]


def test_views_without_end_do_not_pile_up(start, make_batch, make_look):
    worker, host = start()
    worker._held.add(make_batch())
    for number in range(MAX_VIEWS + 20):
        worker.set_camera(make_look(view_id=str(number)))
        host.answer(view_id=str(number))
    host.answers.clear()
    worker._held.add(make_batch(revision=2))
    host.answer(revision=2, view_id=str(MAX_VIEWS + 19))
    assert len(host.answers) == MAX_VIEWS


def test_bad_messages_are_reported_and_survived(start, make_batch, make_look):
    worker, host = start()
    worker._held.add(make_batch(count=3))
    worker._held.add(make_batch(revision=2, positions=[0.0]))
    host.said("batch 2 of map 'map' dropped: positions holds 1 values, not the 9")
    worker._held.add(make_batch(revision=3, opacities=[1.0, float("nan"), 1.0]))
    host.said("missed 1 batch before 3")
    host.said("1 splat of batch 3 dropped")
    worker.set_camera(make_look(view_id="bad", fx=0.0))
    host.said("of view 'bad' dropped: fx is 0.0")
    worker.set_camera(make_look(view_id="astray", frame_id="odom"))
    host.said("header.frame_id is 'odom', the map's 'map'")
    worker.set_camera(make_look())
    assert list(host.answer().slots) == [2, 0]


@pytest.mark.parametrize("where", ["order", "update"])
def test_a_backend_that_fails_is_left_for_the_best_other(start, make_batch, make_look, where):
    BrokenBackend.where = where
    worker, host = start("broken")
    worker._held.add(make_batch())
    worker.set_camera(make_look())
    answer = host.answer()
    assert answer.backend in BACKENDS.keys() - {"broken"}
    assert list(answer.slots) == [2, 1, 0]
    host.said("backend 'broken' failed: CUDA out of memory")


def test_what_replaces_a_backend_may_fail_too(start, make_batch, make_look, monkeypatch):
    monkeypatch.setattr(backends, "_has_nvidia_driver", lambda: False)
    monkeypatch.setattr(NativeBackend, "update", has_room_for(0, NativeBackend.update))
    BrokenBackend.where = "update"
    worker, host = start("broken")
    with worker._held._lock:  # all at once
        worker._held.add(make_batch())
        worker._held.add(make_batch(1, revision=2, first_slot=7, positions=[0.0, 0.0, 1.5]))
        worker.set_camera(make_look())
    answer = host.answer(revision=2)
    assert (answer.backend, list(answer.slots)) == ("numpy", [2, 1, 7, 0])
    host.said("backend 'broken' failed: CUDA out of memory")
    host.said("backend 'native' failed: MemoryError")


def test_without_memory_for_a_batch_the_map_comes_again(start, make_batch, monkeypatch):
    apply, taken = SplatMap.apply, []

    def short(self, batch, arrival):
        taken.append(batch.revision)
        if batch.revision == 2:
            raise MemoryError
        return apply(self, batch, arrival)

    monkeypatch.setattr(SplatMap, "apply", short)
    worker, host = start()
    with worker._held._lock:
        for revision in (1, 2, 3):
            worker._held.add(make_batch(revision=revision, operation=min(revision - 1, 1)))
    host.said("all is to come again")
    host.said("batch 2 of map 'map' dropped: out of memory")
    assert taken == [1, 2]  # what waited behind it is dropped
    host.wait(lambda: worker.figures()["Backlog (bytes)"] == 0)


def test_a_backend_that_can_t_take_the_map_is_never_used(start, make_batch, make_look):
    BrokenBackend.where = "update"
    worker, host = start("numpy")
    worker._held.add(make_batch())
    worker.set_camera(make_look())
    host.answer()
    with worker._held._lock:
        worker.use("broken", 1)
        worker._held.add(make_batch(1, revision=2, first_slot=7, positions=[0.0, 0.0, 1.5]))
    assert list(host.answer(revision=2).slots) == [2, 1, 7, 0]
    host.said("backend 'broken' failed: CUDA out of memory")
    assert not [answer for answer in host.answers if answer.backend == "broken"]


def test_a_map_that_no_backend_takes_leaves_room_for_the_next(
    start, make_batch, make_look, monkeypatch
):
    monkeypatch.setattr(backends, "_has_nvidia_driver", lambda: False)
    for backend in (NativeBackend, NumpyBackend):
        monkeypatch.setattr(backend, "update", has_room_for(3, backend.update))
    worker, host = start("native")
    worker.set_camera(make_look())
    worker._held.add(make_batch(5, operation=0))
    host.said("could not sort: Unavailable")
    worker._held.add(make_batch(3, operation=0, revision=2))
    assert len(host.answer(revision=2).slots) == 3
    assert len(host.answers) == 1


def test_backends_change_while_running(start, make_batch, make_look):
    worker, host = start("numpy")
    worker._held.add(make_batch())
    worker.set_camera(make_look(sequence=1))
    assert host.answer(1).backend == "numpy"
    worker.use("native", 1)
    native = host.answer(1, backend="native")  # without a new camera: the view sees who sorts
    np.testing.assert_array_equal(native.slots, host.answer(1, backend="numpy").slots)


def test_a_viewer_that_shows_the_key_is_answered_through_shared_memory(
    start, make_batch, make_look
):
    worker, host = start()
    reader = OrderReader()
    worker._held.add(make_batch())
    worker.set_camera(make_look(sequence=1))
    first = host.answer(1)
    assert (first.generation, first.slot_bits) == (0, 2)
    key = int.from_bytes((FOLDER / first.segment).read_bytes()[16:24], sys.byteorder)

    def read(answer):
        order = SplatOrder(encoding=SplatOrder.SHARED, count=len(answer.slots))
        order.segment, order.generation = answer.segment, answer.generation
        return reader.read(order).tolist()

    worker.set_camera(make_look(sequence=2, segment_key=key))  # not sorted again
    assert read(host.answer(2)) == [2, 1, 0]
    assert GatedBackend.sorts == 1
    worker.set_camera(make_look(sequence=3, segment_key=key, x=0.1))
    assert read(host.answer(3)) == [2, 1, 0]
    assert read(host.answer(2)) == [2, 1, 0]
    worker.set_camera(make_look(sequence=1, segment_key=key, view_id="another"))
    assert read(host.answer(1, view_id="another")) == [2, 1, 0]
    # One that has lost it, or guesses, gets all in the message, without another sort.
    for sequence, wrong in ((4, 0), (5, key + 1)):
        worker.set_camera(make_look(sequence=sequence, segment_key=wrong, x=0.1))
        answer = host.answer(sequence)
        assert (answer.generation, answer.segment) == (0, first.segment)
        assert answer.slots.tolist() == [2, 1, 0]
    assert GatedBackend.sorts == 3
    assert not (FOLDER / host.answer(3).segment).exists()
    worker.close()
    assert not (FOLDER / first.segment).exists()
    assert not (FOLDER / host.answer(1, view_id="another").segment).exists()


def test_a_lost_key_brings_the_last_order_again(start, make_batch, make_look):
    """The sequence is the same: the viewer could not read what answered it."""
    worker, host = start()
    worker._held.add(make_batch())
    worker.set_camera(make_look(sequence=1))
    first = host.answer(1)
    key = int.from_bytes((FOLDER / first.segment).read_bytes()[16:24], sys.byteorder)
    worker.set_camera(make_look(sequence=1, segment_key=key))
    host.wait(lambda: host.answers[-1].generation)
    worker.set_camera(make_look(sequence=1))
    host.wait(lambda: not host.answers[-1].generation)
    assert host.answers[-1].slots.tolist() == [2, 1, 0]
    assert GatedBackend.sorts == 1


def test_without_room_orders_travel_in_messages(start, make_batch, make_look, monkeypatch):
    worker, host = start()
    worker._held.add(make_batch())
    worker.set_camera(make_look(sequence=1))
    first = host.answer(1)
    key = int.from_bytes((FOLDER / first.segment).read_bytes()[16:24], sys.byteorder)
    full = types.SimpleNamespace(f_bavail=0, f_frsize=4096)
    monkeypatch.setattr(os, "statvfs", lambda path: full)
    for sequence, x in ((2, 0.0), (3, 0.1)):
        worker.set_camera(make_look(sequence=sequence, segment_key=key, x=x))
        assert host.answer(sequence).generation == 0
        assert host.answer(sequence).slots.tolist() == [2, 1, 0]
    host.said("orders travel in messages: [Errno 28] no room")


def test_what_peers_send_makes_no_more_than_a_line(start, make_batch, make_look):
    worker, host = start()
    long = "a\n\x1b[31m" * 100_000
    worker._held.add(make_batch(map_id=long, frame_id=long))
    worker._held.add(make_batch(map_id=long, revision=0))
    worker._held.add(make_batch(map_id=long, revision=5))
    worker.set_camera(make_look(view_id=long, frame_id=long))
    host.said("header.frame_id is 'a\\n\\x1b[31ma")
    worker.set_camera(make_look(view_id=long, fx=0.0))
    host.said("fx is 0.0")
    host.said("revision is 0")
    assert max(map(len, host.lines)) < 1000
    assert all(line.isprintable() for line in host.lines)


def test_views_that_wait_do_not_pile_up(start, make_batch, make_look):
    worker, _ = start()
    GatedBackend.gate.clear()
    worker._held.add(make_batch())
    worker.set_camera(make_look())
    assert GatedBackend.sorting.wait(PATIENCE)
    for number in range(1000):
        worker.set_camera(make_look(view_id=str(number)))
    assert list(worker._cameras) == [str(number) for number in range(1000 - MAX_VIEWS, 1000)]
