"""The map's topic over DDS: whoever joins, and whenever, rebuilds the publisher's map."""

import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import Pose, Quaternion
from rclpy.duration import Duration
from rclpy.node import Node

from rosplat_msgs.msg import GaussianArray
from rosplat_tools.map_publisher import HISTORY_MAPS, MapPublisher
from rosplat_tools.program.running import Cancelled
from rosplat_tools.splats import Splats
from rosplat_tools.testing import Listener

Maker = Callable[..., Splats]
Received = dict[str, np.ndarray]
RECEIVER = Path(__file__).with_name("receive_map.py")


@contextmanager
def receiver(node: Node, until: int, out: Path, *options: str) -> Iterator[Received]:
    """A subscriber in a process of its own, there in the block; what it got is there after it."""
    topic = node.resolve_topic_name("gaussians")
    command = [sys.executable, str(RECEIVER), topic, str(until), str(out), *options]

    def matched() -> int:  # what is sent before a publisher knows a receiver may miss it
        return sum(
            publisher.get_subscription_count()
            for publisher in node.publishers
            if publisher.topic_name == topic
        )

    before = matched()
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout
        assert process.stdout.readline() == "listening\n"
        patient_until = time.monotonic() + 5  # another receiver may leave meanwhile
        while matched() == before and time.monotonic() < patient_until:
            time.sleep(0.01)
        received: Received = {}
        try:
            yield received
            assert process.wait(90) == 0
        finally:
            process.kill()
    received |= np.load(out)


def assert_same_map(received: Received, publisher: MapPublisher) -> None:
    slots, splats = publisher.snapshot()
    np.testing.assert_array_equal(received["slots"], slots)
    np.testing.assert_array_equal(received["positions"], splats.positions + splats.origin)
    np.testing.assert_array_equal(received["sh"], splats.without_empty_bands().sh)
    for name in ("orientations", "scales", "opacities"):
        np.testing.assert_array_equal(received[name], getattr(splats, name))


def edit(publisher: MapPublisher, random_splats: Maker, times: int) -> None:
    """Grows, moves and prunes."""
    rng = np.random.default_rng(times)
    for step in range(times):
        have = len(publisher)
        publisher.upsert(range(have, have + 20), random_splats(20, 1, seed=step))
        publisher.upsert(rng.choice(have, 5, replace=False), random_splats(5, 2, seed=step))
        publisher.delete(rng.choice(have, 3, replace=False))


def test_subscribers_of_any_time_rebuild_the_map(
    node: Node, random_splats: Maker, tmp_path: Path
) -> None:
    publisher = MapPublisher(node, chunk_bytes=50_000)
    last = 1 + 8 + 3 * 10  # an empty REPLACE, 1500 splats in chunks, edits
    with receiver(node, last, tmp_path / "early.npz") as early:
        publisher.replace(random_splats(0))
        far = Splats(**(vars(random_splats(1500, 3)) | {"origin": np.array([4.5e6, 5e5, 0])}))
        publisher.upsert(range(1500), far)
        edit(publisher, random_splats, 10)
        assert publisher.revision == last
        with receiver(node, last, tmp_path / "late.npz") as late:
            pass
    for received in (early, late):
        assert received["revisions"].tolist() == list(range(1, last + 1))
        assert_same_map(received, publisher)


def test_groups_are_placed_and_moved_without_their_splats(
    node: Node, random_splats: Maker, listener: Listener
) -> None:
    publisher = MapPublisher(node)
    publisher.upsert(range(5), random_splats(5))
    publisher.upsert(range(1024, 1030), random_splats(6, 3), group=3)
    far = np.eye(4)
    far[0, 3] = 1e6
    publisher.move({3: Pose(orientation=Quaternion(x=2.0, w=0.0)), 9: far})
    listener.wait(lambda: len(listener.batches) == 3)
    moved = listener.batches[-1]
    assert (moved.operation, moved.count, len(moved.positions)) == (GaussianArray.MOVE, 0, 0)
    assert (list(moved.groups), moved.poses[0].orientation.x) == ([3, 9], 1)
    _, splats = publisher.snapshot()
    np.testing.assert_allclose(
        splats.positions[5:], random_splats(6, 3).positions * [1, -1, -1], atol=1e-6
    )
    assert listener.map
    np.testing.assert_array_equal(listener.map.snapshot()[1].positions, splats.positions)
    publisher.replace(random_splats(3))
    listener.wait_for(3)
    assert not listener.map.poses


def test_numbers_may_be_of_numpy_s_kinds(
    node: Node, random_splats: Maker, listener: Listener
) -> None:
    publisher = MapPublisher(node)
    publisher.replace(random_splats(3), expected_slots=np.int64(8))  # type: ignore[arg-type]
    publisher.expect(np.int64(9))  # type: ignore[arg-type]
    publisher.upsert(range(1024, 1025), random_splats(1), group=np.int64(3))  # type: ignore[arg-type]
    publisher.move({np.int64(3): np.eye(4)})  # type: ignore[dict-item]
    listener.wait(lambda: len(listener.batches) == 3)
    assert [batch.expected_slots for batch in listener.batches] == [8, 9, 9]
    assert (listener.batches[1].group, list(listener.batches[2].groups)) == (3, [3])


@pytest.mark.parametrize(
    ("poses", "named"),
    [
        ({0: np.eye(3)}, r"poses\[0\]: expected a Pose or a matrix"),
        ({5: 2 * np.eye(4)}, r"poses\[5\]: expected a rotation"),
        ({1: np.diag([1, 1, -1, 1])}, r"poses\[1\]: expected a rotation"),
        ({1: Pose(orientation=Quaternion(w=0.0))}, r"poses\[1\]: not finite, or a quaternion"),
        ({32768: np.eye(4)}, "group: a number from 0 to 32767, got 32768"),
        ({-1: np.eye(4)}, "group"),
    ],
)
def test_a_pose_that_is_none_is_refused(node: Node, poses: Any, named: str) -> None:
    publisher = MapPublisher(node)
    with pytest.raises(ValueError, match=named):
        publisher.move(poses)
    assert publisher.revision == 0


def test_what_groups_don_t_allow_is_refused_and_not_sent(node: Node, random_splats: Maker) -> None:
    publisher = MapPublisher(node, history_depth=8)
    publisher.upsert(range(3), random_splats(3))
    with pytest.raises(ValueError, match="slots 0 to 1023 hold splats of group 0, this batch is"):
        publisher.upsert(range(5, 6), random_splats(1), group=2)
    publisher.upsert(range(1024, 1025), random_splats(1), group=2)
    with pytest.raises(ValueError, match="history_depth of 8 has room for 2 groups"):
        publisher.upsert(range(2048, 2049), random_splats(1), group=3)
    assert (publisher.revision, len(publisher)) == (2, 4)


def test_the_history_never_loses_its_beginning(
    node: Node, random_splats: Maker, tmp_path: Path
) -> None:
    """More edits than the history holds: a latecomer gets a whole map in fewer batches."""
    publisher = MapPublisher(node, history_depth=12, chunk_bytes=20_000)
    publisher.replace(random_splats(300))
    edit(publisher, random_splats, 25)
    with receiver(node, publisher.revision, tmp_path / "late.npz") as late:
        pass
    assert_same_map(late, publisher)
    assert late["operations"][0] == GaussianArray.REPLACE
    assert (np.diff(late["revisions"]) == 1).all()
    assert len(late["revisions"]) <= 12


def test_who_has_the_map_never_sees_a_snapshot_for_latecomers(
    node: Node, random_splats: Maker, tmp_path: Path
) -> None:
    publisher = MapPublisher(node, history_depth=12, chunk_bytes=20_000)
    last = 1 + 4 + 3 * 25  # an empty REPLACE, 300 splats in chunks, edits
    with receiver(node, last, tmp_path / "early.npz") as early:
        publisher.replace(random_splats(0))
        publisher.upsert(range(300), random_splats(300))
        edit(publisher, random_splats, 25)
        assert publisher.revision == last
        with receiver(node, last, tmp_path / "late.npz") as late:
            pass
    assert early["revisions"].tolist() == list(range(1, last + 1))
    assert early["operations"].tolist().count(GaussianArray.REPLACE) == 1
    assert late["operations"].tolist().count(GaussianArray.REPLACE) == 1
    assert 1 < len(late["revisions"]) <= 12
    for received in (early, late):
        assert_same_map(received, publisher)


def test_the_history_takes_no_more_than_some_maps(
    node: Node, random_splats: Maker, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Edits far larger than the map: a latecomer gets few of them, who was there all, once."""
    monkeypatch.setattr("rosplat_tools.map_publisher.HISTORY_FLOOR", 0)
    publisher = MapPublisher(node)
    last = 1 + 10
    with receiver(node, last, tmp_path / "early.npz") as early:
        publisher.replace(random_splats(300))
        for step in range(last - 1):
            if publisher._history_bytes > HISTORY_MAPS * publisher._map.nbytes:
                # Acknowledged with a heartbeat, up to three seconds later.
                publisher._publisher.wait_for_all_acked(Duration(seconds=5))
            publisher.upsert(range(100, 200), random_splats(100, seed=step))
        with receiver(node, last, tmp_path / "late.npz") as late:
            pass
    assert early["revisions"].tolist() == list(range(1, last + 1))
    assert early["operations"].tolist().count(GaussianArray.REPLACE) == 1
    assert late["operations"][0] == GaussianArray.REPLACE
    assert len(late["revisions"]) <= 1 + 4  # the map, another, and what went over it
    for received in (early, late):
        assert_same_map(received, publisher)


def test_who_lags_behind_puts_a_snapshot_off_for_a_while(
    node: Node, random_splats: Maker, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rosplat_tools.map_publisher.HISTORY_FLOOR", 0)
    publisher = MapPublisher(node)
    publisher.replace(random_splats(10))
    monkeypatch.setattr(type(publisher._publisher), "wait_for_all_acked", lambda *_: False)
    sent: list[GaussianArray] = []
    monkeypatch.setattr(type(publisher._publisher), "publish", lambda _, m: sent.append(m))
    for _ in range(8):
        publisher.upsert(range(5), random_splats(5))
    assert [message.revision for message in sent] == list(range(2, 10))
    # The map, and edits until there are more than four: then the map again.
    assert [message.operation for message in sent] == [1, 1, 1, 1, 1, 1, 1, 0]


def test_who_lags_behind_gets_a_snapshot_as_a_new_map(
    node: Node, random_splats: Maker, monkeypatch: pytest.MonkeyPatch
) -> None:
    publisher = MapPublisher(node, history_depth=4)
    publisher.replace(random_splats(10))
    monkeypatch.setattr(type(publisher._publisher), "wait_for_all_acked", lambda *_: False)
    sent: list[GaussianArray] = []
    monkeypatch.setattr(type(publisher._publisher), "publish", lambda _, m: sent.append(m))
    for slot in range(10, 16):
        publisher.upsert(range(slot, slot + 1), random_splats(1))
    assert [message.revision for message in sent] == [2, 3, 4, 5, 6, 7]
    assert [message.operation for message in sent] == [1, 1, 1, 0, 1, 1]
    assert sent[3].count == 14


def test_a_new_map_takes_the_old_one_s_batches_out_of_the_history(
    node: Node, random_splats: Maker, tmp_path: Path
) -> None:
    publisher = MapPublisher(node, chunk_bytes=20_000)
    for seed in range(3):
        publisher.replace(random_splats(400, seed=seed))
    with receiver(node, publisher.revision, tmp_path / "late.npz") as late:
        pass
    assert len(late["revisions"]) == publisher.revision // 3
    assert_same_map(late, publisher)


def test_a_subscriber_without_history_ends_with_the_map_as_well(
    node: Node, random_splats: Maker, tmp_path: Path
) -> None:
    """Each REPLACE comes from another writer, which must be known before it sends."""
    publisher = MapPublisher(node, history_depth=10)
    last = 40
    with receiver(node, last, tmp_path / "volatile.npz", "--volatile") as received:
        while not publisher._publisher.get_subscription_count():
            time.sleep(0.01)
        for step in range(last // 2):
            publisher.replace(random_splats(50, seed=step))
            publisher.upsert(range(50, 60), random_splats(10, seed=step))
    # What a later REPLACE supersedes may be missing, nothing else.
    begin = np.flatnonzero(received["operations"] == GaussianArray.REPLACE)[-1]
    assert received["revisions"][begin:].tolist() == [last - 1, last]
    assert_same_map(received, publisher)


def test_a_slam_map_of_500_batches_reaches_a_latecomer(
    node: Node, random_splats: Maker, tmp_path: Path
) -> None:
    publisher = MapPublisher(node)
    splats = random_splats(1000, 0)
    for first in range(0, 500_000, 1000):
        publisher.upsert(range(first, first + 1000), splats)
    with receiver(node, 500, tmp_path / "late.npz") as late:
        pass
    assert len(late["slots"]) == 500_000
    assert_same_map(late, publisher)


def test_arguments_are_checked_before_anything_is_sent(node: Node, random_splats: Maker) -> None:
    publisher = MapPublisher(node)
    publisher.replace(random_splats(10))
    for slots, match in (
        (np.array([1, 2, 1]), "once"),
        (np.array([-1, 2, 3]), "0 to"),
        (range(-3, 0), "0 to"),
        (np.array([0, 1, 2**25]), "0 to"),
        (range(2**25 - 2, 2**25 + 1), "0 to"),
        (range(5), "3 splats for 5 slots"),
        (range(0, 6, 2), "contiguous"),
        ([0.5, 1.0, 2.0], "float64"),
        (np.array([True, False, True]), "bool"),
        (7, "integers"),
    ):
        with pytest.raises(ValueError, match=match):
            publisher.upsert(slots, random_splats(3))
    n = 2**25 + 1  # which take no memory as long as nobody looks at them
    shapes = {"positions": (n, 3), "orientations": (n, 4), "scales": (n, 3), "opacities": (n,)}
    zeros = {name: np.zeros(shape, np.float32) for name, shape in shapes.items()}
    with pytest.raises(ValueError, match="33554433 splats"):
        publisher.replace(Splats(**zeros, sh=np.zeros((n, 1, 3), np.float32)))
    with pytest.raises(ValueError, match="once"):
        publisher.delete(np.array([4, 4]))
    with pytest.raises(ValueError, match="antialiased"):
        publisher.upsert(range(3), random_splats(3, antialiased=True))
    for wrong in ("scene.ply", np.zeros((3, 3))):
        with pytest.raises(TypeError, match="expected Splats"):
            publisher.replace(wrong)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="expected_slots"):
        publisher.replace(random_splats(3), expected_slots=-1)
    with pytest.raises(ValueError, match="expected_slots"):
        publisher.expect(GaussianArray.MAX_SLOTS + 1)
    now = node.get_clock().now()
    for send in (
        lambda: publisher.replace(random_splats(3), stamp=now),
        lambda: publisher.upsert(range(3), random_splats(3), stamp=now),
        lambda: publisher.delete([1], stamp=now),
    ):
        with pytest.raises(TypeError, match="to_msg"):
            send()
    assert (publisher.revision, len(publisher)) == (1, 10)
    publisher.delete([])
    publisher.delete([2, 3], stamp=now.to_msg())
    assert (publisher.revision, len(publisher)) == (3, 8)


@pytest.mark.parametrize("error", [Cancelled, MemoryError])
def test_a_replace_that_fails_leaves_the_map_as_it_was(
    node: Node, random_splats: Maker, tmp_path: Path, error: type[Exception]
) -> None:
    """With those who have heard a part of the other, too, and for those who come late."""
    publisher = MapPublisher(node, chunk_bytes=20_000)
    publisher.replace(random_splats(300))
    told: list[int] = []

    def progress(count: int) -> None:
        told.append(count)
        if len(told) == 3:
            raise error

    sent = publisher.revision
    with (
        receiver(node, sent + 3 + sent, tmp_path / "early.npz") as early,
        pytest.raises(error),
    ):
        publisher.replace(random_splats(2000, seed=1), progress=progress)
    assert publisher.revision == sent + 3 + sent
    with receiver(node, publisher.revision, tmp_path / "late.npz") as late:
        pass
    assert len(publisher) == 300
    for received in (early, late):
        assert_same_map(received, publisher)


def test_after_an_interrupted_edit_the_whole_map_is_sent(
    node: Node, random_splats: Maker, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not as a snapshot, which subscribers that have its revisions would drop."""
    publisher = MapPublisher(node, chunk_bytes=20_000)
    publisher.replace(random_splats(300, 0))
    sent: list[GaussianArray] = []

    def publish(_: object, message: GaussianArray) -> None:
        if len(sent) == 2:
            sent.clear()
            raise KeyboardInterrupt
        sent.append(message)

    monkeypatch.setattr(type(publisher._publisher), "publish", publish)
    with pytest.raises(KeyboardInterrupt):
        publisher.upsert(range(1000), random_splats(1000, 0))
    last = publisher.revision
    publisher._chunk_bytes = 10**6
    publisher.delete([7])
    (batch,) = sent
    assert (batch.operation, batch.snapshot) == (GaussianArray.REPLACE, False)
    assert (batch.revision, batch.count) == (last + 1, 999)
    publisher.delete([8])
    assert sent[1].operation == GaussianArray.DELETE


def test_calls_of_several_threads_take_turns(
    node: Node, random_splats: Maker, monkeypatch: pytest.MonkeyPatch
) -> None:
    publisher = MapPublisher(node)
    publisher.replace(random_splats(0))
    sent: list[int] = []

    def publish(_: object, message: GaussianArray) -> None:
        time.sleep(0.002)  # in which another thread would send
        sent.append(message.revision)

    monkeypatch.setattr(type(publisher._publisher), "publish", publish)
    with ThreadPoolExecutor(4) as threads:
        list(threads.map(lambda n: publisher.upsert([n], random_splats(1)), range(40)))
    assert sent == list(range(2, 42))
    assert len(publisher) == 40
