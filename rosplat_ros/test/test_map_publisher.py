"""The map's topic over DDS: whoever joins, and whenever, rebuilds the publisher's map."""

import gc
import re
import signal
import subprocess
import sys
import threading
import time
import weakref
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import FunctionType
from typing import Any

import numpy as np
import pytest
import rclpy
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import Point, Pose, Quaternion
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from rclpy.serialization import serialize_message

from rosplat_core import _core, bounded_map, formats, payload
from rosplat_core.cameras import Camera, look_at
from rosplat_core.formats import IntoPacked
from rosplat_core.models import Model
from rosplat_core.scenes import load_scene_into
from rosplat_core.splats import PackedSplats, Splats
from rosplat_msgs.msg import GaussianArray
from rosplat_msgs.srv import PullMap, RepeatMap
from rosplat_ros import map_publisher
from rosplat_ros.batches import array_bytes
from rosplat_ros.map_publisher import CHUNK_BYTES, MapPublisher
from rosplat_ros.poses import to_pose
from rosplat_ros.program.running import Cancelled
from rosplat_ros.qos import MAP_VOLATILE, PULLED_MAP
from rosplat_testing import PATIENCE, Listener
from rosplat_testing.messages import decode

Maker = Callable[..., Splats]
Received = dict[str, np.ndarray]
RECEIVER = Path(__file__).with_name("receive_map.py")
ANSWER_BYTES = 2_000_000  # as PullMap.srv says


@contextmanager
def receiver(node: Node, until: int, out: Path) -> Iterator[Received]:
    """A subscriber in a process of its own, there in the block; what it got is there after it.

    Nobody spins the node.
    """
    topic = node.resolve_topic_name("gaussians")
    command = [sys.executable, str(RECEIVER), topic, str(until), str(out)]

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
            assert process.wait(PATIENCE) == 0
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


def packed(splats: Splats) -> PackedSplats:
    rows = _core.pack_splats(splats, np.ones(len(splats), bool))
    of_all = splats.origin, splats.model, splats.channels
    return PackedSplats(rows, splats.sh_degree, *of_all)


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
    publisher = MapPublisher(node, chunk_bytes=20_000)
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


@pytest.mark.parametrize("first", ["replace", "upsert", "delete", "move"])
def test_a_map_begins_with_a_replace(
    node: Node, random_splats: Maker, listener: Listener, first: str
) -> None:
    """A bag that loops plays it into the map of the round before."""
    publisher = MapPublisher(node)
    if first == "replace":
        publisher.replace(random_splats(3))
    elif first == "upsert":
        publisher.upsert(range(3), random_splats(3))
    elif first == "delete":
        publisher.delete([7])
    else:
        publisher.move({2: np.eye(4)})
    listener.wait(lambda: listener.batches and listener.batches[-1].revision == publisher.revision)
    assert [batch.operation for batch in listener.batches].index(GaussianArray.REPLACE) == 0
    assert [batch.revision for batch in listener.batches] == list(range(1, publisher.revision + 1))


@pytest.mark.parametrize("length", [1e-200, 1e200])
def test_a_quaternion_of_any_length_is_made_a_unit(length: float) -> None:
    orientation = Quaternion(x=0.0, y=0.0, z=length, w=length)
    made = to_pose(Pose(orientation=orientation)).orientation
    assert (made.z, made.w) == pytest.approx((np.sqrt(0.5), np.sqrt(0.5)))


@pytest.mark.parametrize(
    ("poses", "named"),
    [
        ({0: np.eye(3)}, r"poses\[0\]: expected 4x4 finite numbers, got shape \(3, 3\)"),
        ({5: 2 * np.eye(4)}, r"poses\[5\]: expected a rotation"),
        ({1: np.diag([1, 1, -1, 1])}, r"poses\[1\]: expected a rotation"),
        ({-1: np.eye(4)}, "group"),
    ],
)
def test_a_matrix_that_is_no_pose_is_refused(node: Node, poses: Any, named: str) -> None:
    publisher = MapPublisher(node)
    with pytest.raises(ValueError, match=named):
        publisher.move(poses)
    assert publisher.revision == 0


@pytest.mark.parametrize(
    ("poses", "named"),
    [
        ({1: Pose(orientation=Quaternion(w=0.0))}, r"poses\[1\]: not finite, or a quaternion"),
        ({2: Pose(position=Point(y=float("nan")))}, r"poses\[2\]: not finite"),
        ({32768: Pose()}, "group: a number from 0 to 32767, got 32768"),
    ],
)
def test_a_pose_that_is_none_is_refused(node: Node, poses: Any, named: str) -> None:
    publisher = MapPublisher(node)
    with pytest.raises(ValueError, match=named):
        publisher.move(poses)
    assert publisher.revision == 0


def test_what_groups_don_t_allow_is_refused_and_not_sent(node: Node, random_splats: Maker) -> None:
    publisher = MapPublisher(node)
    publisher.upsert(range(3), random_splats(3))
    with pytest.raises(ValueError, match="slots 0 to 1023 hold splats of group 0, this batch is"):
        publisher.upsert(range(5, 6), random_splats(1), group=2)
    publisher.upsert(range(1024, 1025), random_splats(1), group=2)
    assert (publisher.revision, len(publisher)) == (2, 4)


def test_who_joins_late_pulls_the_map(node: Node, random_splats: Maker, tmp_path: Path) -> None:
    """In several answers, all of one revision."""
    publisher = MapPublisher(node, chunk_bytes=100_000)
    publisher.replace(random_splats(3000))
    edit(publisher, random_splats, 10)
    publisher.move({0: np.eye(4)})
    with receiver(node, publisher.revision, tmp_path / "late.npz") as late:
        pass
    assert_same_map(late, publisher)
    first = late["pulled"].argmax()
    assert late["pulled"][first:].all()
    assert late["operations"][first] == GaussianArray.REPLACE
    assert set(late["revisions"][first:]) == {publisher.revision}
    assert late["operations"].tolist().count(GaussianArray.UPSERT) > 2


def test_who_misses_batches_pulls_what_they_changed(
    node: Node, random_splats: Maker, listener: Listener, monkeypatch: pytest.MonkeyPatch
) -> None:
    publisher = MapPublisher(node)
    publisher.replace(random_splats(5000))
    listener.wait_for(5000)
    with monkeypatch.context() as lost:
        lost.setattr(type(publisher._wire._publisher), "publish", lambda *_: None)
        publisher.upsert(range(2048, 2050), random_splats(2, seed=1))
        publisher.delete(range(3072, 4096))
        publisher.upsert(range(3072, 3080), random_splats(8), group=4)
    publisher.delete([4099])
    heard = len(listener.batches)
    listener.wait_for(5000 - 1024 + 8 - 1)
    pulled = listener.batches[heard:]
    assert {batch.revision for batch in pulled} == {publisher.revision}
    touched: dict[int, set[int]] = {GaussianArray.DELETE: set(), GaussianArray.UPSERT: set()}
    for batch in pulled:
        named = batch.slots or range(batch.first_slot, batch.first_slot + batch.count)
        touched[batch.operation] |= set(named)
    assert touched == {
        GaussianArray.DELETE: {*range(3072, 4096), 4099},
        GaussianArray.UPSERT: {2048, 2049, *range(3072, 3080)},
    }
    assert listener.map
    np.testing.assert_array_equal(
        listener.map.snapshot()[1].positions, publisher.snapshot()[1].positions
    )


@pytest.mark.parametrize(
    ("asked", "answered"),
    [
        ({"map_id": "another"}, []),
        ({}, [0, 1]),
        ({"after_revision": 2}, [1]),  # nothing has changed
        ({"after_revision": 1}, [2]),
        ({"after_revision": 2**64 - 1}, [0, 1]),
        ({"first_block": 1}, [1]),
        ({"first_block": 2**32 - 1}, [1]),
        ({"map_id": ""}, [0, 1]),  # by who knows none
    ],
)
def test_requests_of_any_kind_are_answered(
    node: Node, random_splats: Maker, listener: Listener, asked: dict[str, Any], answered: list[int]
) -> None:
    """By the operations of batches."""
    publisher = MapPublisher(node)
    publisher.replace(random_splats(5))
    publisher.delete([3])
    request = {"map_id": publisher.map_id} | asked
    response = listener.call(PullMap, "gaussians/pull", **request)
    assert [batch.operation for batch in response.batches] == answered
    assert response.next_block == 0
    assert all(batch.expected_slots == 5 for batch in response.batches)


def test_answers_to_pulls_stay_small(node: Node, random_splats: Maker, listener: Listener) -> None:
    """Whatever the size of batches: middleware keeps several answers for each client."""
    publisher = MapPublisher(node, chunk_bytes=10**9)
    publisher.replace(random_splats(50_000, 0))
    sizes, block = [], 0
    while block or not sizes:
        response = listener.call(
            PullMap, "gaussians/pull", map_id=publisher.map_id, first_block=block
        )
        sizes.append(sum(array_bytes(batch) for batch in response.batches))
        block = response.next_block
    assert len(sizes) == 2
    assert max(sizes) <= ANSWER_BYTES


def test_harmonics_that_nobody_wants_are_not_pulled(
    node: Node, random_splats: Maker, listener: Listener
) -> None:
    publisher = MapPublisher(node)
    splats = random_splats(1000, 3)
    publisher.replace(splats)
    response = listener.call(PullMap, "gaussians/pull", most_sh_degree=1)
    last = response.batches[-1]
    assert (last.count, last.sh_degree) == (1000, 1)
    _, pulled = decode(last)
    np.testing.assert_allclose(pulled.sh, splats.sh[:, :4], atol=np.abs(splats.sh).max() / 500)


def pulled_bytes(listener: Listener, publisher: MapPublisher, after: int) -> list[int]:
    """What each of the answers takes on the wire by which a client gets what it lacks."""
    sizes, block = [], 0
    while block or not sizes:
        response = listener.call(
            PullMap,
            "gaussians/pull",
            map_id=publisher.map_id,
            after_revision=after,
            first_block=block,
        )
        sizes.append(sum(len(serialize_message(batch)) for batch in response.batches))
        block = response.next_block
    return sizes


def test_what_goes_to_other_groups_is_pulled_in_small_answers(
    node: Node, random_splats: Maker, listener: Listener
) -> None:
    """Blocks that are emptied, and many poses, count as splats do."""
    publisher = MapPublisher(node)
    block = GaussianArray.SLOTS_PER_BLOCK
    slots = np.arange(2000) * block
    publisher.upsert(slots, random_splats(2000, 0))
    after = publisher.revision
    publisher.delete(slots)
    publisher.upsert(slots, random_splats(2000, 0), group=1)
    groups = range(GaussianArray.MAX_GROUPS)
    publisher.move({group: Pose(position=Point(x=float(group))) for group in groups})
    sizes = pulled_bytes(listener, publisher, after)
    assert 4 < len(sizes) < 10
    assert max(sizes) <= ANSWER_BYTES


def test_batches_stay_below_their_size(
    node: Node, random_splats: Maker, monkeypatch: pytest.MonkeyPatch
) -> None:
    publisher = MapPublisher(node)
    sent: list[GaussianArray] = []

    def keep(_: object, message: object) -> None:
        if isinstance(message, GaussianArray):  # diagnostics come from publishers of this type, too
            sent.append(message)

    monkeypatch.setattr(type(publisher._wire._publisher), "publish", keep)
    every_other = np.arange(0, 600_000, 2)
    publisher.upsert(every_other, random_splats(300_000, 0))
    publisher.delete(np.arange(0, 10_000_000, 2))
    publisher.delete(range(1, 20_000_000))
    assert [batch.operation for batch in sent] == [0, 1, 2, 2, 2, 2]
    assert all(array_bytes(batch) <= CHUNK_BYTES for batch in sent)
    assert sum(batch.count for batch in sent[2:-1]) == 5_000_000
    assert [batch.revision for batch in sent] == list(range(1, 7))


def test_a_pull_doesn_t_wait_for_a_map_that_is_being_sent(
    node: Node, random_splats: Maker, listener: Listener
) -> None:
    publisher = MapPublisher(node, chunk_bytes=20_000)
    answers: list[PullMap.Response] = []

    def ask(_: int) -> None:  # the parts that are still to go are pulled as well
        answers.append(listener.call(PullMap, "gaussians/pull", map_id=publisher.map_id))

    publisher.replace(random_splats(1000, 1), progress=ask)
    assert len(answers) > 1
    for part, answer in enumerate(answers):
        assert sum(batch.count for batch in answer.batches) == 1000
        assert answer.batches[0].revision == part + 1


def test_nothing_is_kept_of_an_answer(node: Node, random_splats: Maker, listener: Listener) -> None:
    publisher = MapPublisher(node)
    publisher.replace(random_splats(10))

    def functions() -> int:
        return sum(isinstance(each, FunctionType) for each in gc.get_objects())

    for count in range(300):
        if count == 50:
            before = functions()
        listener.call(PullMap, "gaussians/pull")
    assert functions() - before < 50


def test_a_map_without_a_batch_is_not_pulled(node: Node, listener: Listener) -> None:
    publisher = MapPublisher(node)
    response = listener.call(PullMap, "gaussians/pull", map_id=publisher.map_id)
    assert not response.batches


def test_two_publishers_of_a_topic_are_told(
    node: Node, random_splats: Maker, listener: Listener, capfd: pytest.CaptureFixture[str]
) -> None:
    for _ in range(2):
        publisher = MapPublisher(node)
        publisher.replace(random_splats(1))
    # Both answer, and a client takes whichever answer comes first.
    listener.call(PullMap, "gaussians/pull", map_id=publisher.map_id)
    told = ""

    def is_told() -> bool:
        nonlocal told
        told += capfd.readouterr().err
        return "is published by others, too" in told

    listener.wait(is_told)


def test_who_only_listens_hears_the_map_when_it_is_repeated(
    node: Node, random_splats: Maker, listener: Listener
) -> None:
    publisher = MapPublisher(node)
    publisher.replace(random_splats(3))
    publisher.upsert(range(1024, 1030), random_splats(6, 3), group=3)
    publisher.move({3: np.eye(4)})
    heard: list[GaussianArray] = []
    node.create_subscription(GaussianArray, "gaussians", heard.append, MAP_VOLATILE)
    listener.wait(lambda: node.count_subscribers("gaussians") == 2)
    answer = listener.call(RepeatMap, "gaussians/repeat")
    assert (answer.success, answer.splats) == (True, 9)
    listener.wait(lambda: heard and heard[-1].revision == publisher.revision)
    assert [batch.operation for batch in heard] == [0, 3, 1, 1]
    assert [batch.revision for batch in heard] == [4, 5, 6, 7]


def test_a_map_is_repeated_and_pulled_meanwhile_though_nobody_spins_its_node(
    node: Node, random_splats: Maker, listener: Listener, monkeypatch: pytest.MonkeyPatch
) -> None:
    settled = threading.Event()
    monkeypatch.setattr(map_publisher._Wire, "settle", lambda _: settled.wait(PATIENCE))
    author = rclpy.create_node("author", namespace=node.get_namespace(), context=node.context)
    publisher = MapPublisher(author)
    publisher.replace(random_splats(9))
    answer = listener.request(RepeatMap, "gaussians/repeat")
    pulled = listener.call(PullMap, "gaussians/pull", map_id=publisher.map_id)
    assert pulled.batches
    assert not answer.done()
    settled.set()
    listener.wait(answer.done)
    assert (answer.result().success, answer.result().splats) == (True, 9)
    publisher.close()
    author.destroy_node()


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


@pytest.mark.parametrize(
    ("slots", "named"),
    [
        ([1, 2, 1], "slots: each slot may be named once"),
        ([0, 1, 2**25], "slots: a slot is a number from 0 to 33554431"),
        (range(2**25 - 2, 2**25 + 1), "a slot is a number from 0 to 33554431"),
        (range(5), "3 splats for 5 slots"),
    ],
)
def test_slots_are_checked_before_anything_is_sent(
    node: Node, random_splats: Maker, slots: Any, named: str
) -> None:
    publisher = MapPublisher(node)
    publisher.replace(random_splats(10))
    with pytest.raises(ValueError, match=named):
        publisher.upsert(slots, random_splats(3))
    if len(slots) == 3:
        with pytest.raises(ValueError, match=named):
            publisher.delete(slots)
    assert (publisher.revision, len(publisher)) == (1, 10)


def test_what_is_refused_changes_nothing(node: Node, random_splats: Maker) -> None:
    publisher = MapPublisher(node)
    publisher.replace(random_splats(10))
    with pytest.raises(ValueError, match="model"):
        publisher.upsert(range(3), random_splats(3, model=Model.RAY))
    channels = {f"c{i}": np.zeros(3) for i in range(9)}
    with pytest.raises(ValueError, match="channel_names: 9 in all"):
        publisher.upsert(range(3), replace(random_splats(3), channels=channels))
    with pytest.raises(ValueError, match="group: a number from 0 to 32767, got 32768"):
        publisher.upsert(range(3), random_splats(3), group=32768)
    most = GaussianArray.MAX_SLOTS
    with pytest.raises(ValueError, match="expected_slots: a number from 0 to 33554432"):
        publisher.replace(random_splats(3), expected_slots=most + 1)
    with pytest.raises(ValueError, match="expected_slots"):
        publisher.expect(most + 1)
    assert (publisher.revision, len(publisher)) == (1, 10)
    publisher.delete([])
    stamp = Time(sec=12, nanosec=34)
    publisher.delete([2, 3], stamp=stamp)
    assert (publisher.revision, len(publisher)) == (3, 8)


def test_options_are_checked(node: Node) -> None:
    with pytest.raises(ValueError, match="chunk_bytes: at least 1, got 0"):
        MapPublisher(node, chunk_bytes=0)
    with pytest.raises(
        ValueError, match="compression: expected one of none, quantised, got 'draco'"
    ):
        MapPublisher(node, compression="draco")


def test_what_means_nothing_is_left_out(
    node: Node, random_splats: Maker, listener: Listener
) -> None:
    publisher = MapPublisher(node)
    splats = random_splats(5)
    splats.positions[1] = np.nan
    splats.scales[2] = -1
    splats.orientations[3] = 0
    publisher.replace(splats)
    listener.wait_for(2)
    assert len(publisher) == 2
    publisher.upsert(range(2), random_splats(2, seed=1))
    listener.wait_for(3)


@pytest.mark.parametrize("sh_degree", [0, 3])
def test_splats_may_be_compressed(
    node: Node, random_splats: Maker, listener: Listener, sh_degree: int
) -> None:
    publisher = MapPublisher(node, compression="quantised")
    splats = random_splats(3000, sh_degree)
    splats.opacities[17] = np.nan
    publisher.replace(splats)
    listener.wait_for(2999)
    (batch,) = listener.batches
    assert (batch.format, len(batch.positions)) == ("quantised", 0)
    assert len(batch.payload) == payload.size(batch.count, sh_degree)
    assert listener.map
    _, got = listener.map.snapshot()
    kept = np.delete(np.arange(3000), 17)
    np.testing.assert_allclose(got.positions, splats.positions[kept], rtol=0, atol=1e-6)
    np.testing.assert_allclose(got.scales, splats.scales[kept], rtol=2e-3)
    np.testing.assert_allclose(got.opacities, splats.opacities[kept], rtol=0, atol=1e-3)
    np.testing.assert_allclose(got.sh, splats.sh[kept], rtol=0, atol=0.025)
    turn = np.abs(np.einsum("nk,nk->n", got.orientations, splats.orientations[kept]))
    np.testing.assert_allclose(turn, 1, rtol=0, atol=1e-6)


def test_a_stray_splat_is_not_compressed(
    node: Node, random_splats: Maker, listener: Listener
) -> None:
    publisher = MapPublisher(node, compression="quantised")
    splats = random_splats(3000, 0)
    splats.positions[0] = 1e7
    publisher.replace(splats)
    listener.wait_for(3000)
    (batch,) = listener.batches
    assert batch.format == payload.PACKED


def test_arguments_may_be_of_many_kinds_but_not_of_all(node: Node, random_splats: Maker) -> None:
    publisher = MapPublisher(node)
    publisher.replace(random_splats(10))
    for slots, match in (
        (np.array([-1, 2, 3]), "0 to"),
        (range(-3, 0), "0 to"),
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
    with pytest.raises(TypeError, match="frame_id: expected a str, got 5"):
        publisher.frame_id = 5
    for wrong in ("scene.ply", np.zeros((3, 3))):
        with pytest.raises(TypeError, match="expected Splats"):
            publisher.replace(wrong)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="expected_slots"):
        publisher.replace(random_splats(3), expected_slots=-1)
    now = node.get_clock().now()
    for send in (
        lambda: publisher.replace(random_splats(3), stamp=now),
        lambda: publisher.upsert(range(3), random_splats(3), stamp=now),
        lambda: publisher.delete([1], stamp=now),
    ):
        with pytest.raises(TypeError, match="to_msg"):
            send()
    assert (publisher.revision, len(publisher)) == (1, 10)


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

    sent, other = publisher.revision, random_splats(2000, seed=1)
    assert other.nbytes > 4 * 20_000
    last = sent + 3 + 1 + sent  # a revision that nobody has tells those who heard the three
    with receiver(node, last, tmp_path / "early.npz") as early, pytest.raises(error):
        publisher.replace(other, progress=progress)
    assert publisher.revision == last
    with receiver(node, publisher.revision, tmp_path / "late.npz") as late:
        pass
    assert len(publisher) == 300
    for received in (early, late):
        assert_same_map(received, publisher)


def test_an_edit_that_was_not_sent_is_pulled(
    node: Node, random_splats: Maker, listener: Listener, monkeypatch: pytest.MonkeyPatch
) -> None:
    publisher = MapPublisher(node, chunk_bytes=20_000)
    publisher.replace(random_splats(300, 0))
    listener.wait_for(300)
    with monkeypatch.context() as failing:

        def publish(_: object, message: GaussianArray) -> None:
            raise KeyboardInterrupt

        failing.setattr(type(publisher._wire._publisher), "publish", publish)
        with pytest.raises(KeyboardInterrupt):
            publisher.upsert(range(1000), random_splats(1000, 0))
    publisher.delete([7])
    listener.wait_for(999)


def test_calls_of_several_threads_take_turns(
    node: Node, random_splats: Maker, monkeypatch: pytest.MonkeyPatch
) -> None:
    publisher = MapPublisher(node)
    publisher.replace(random_splats(0))
    sent: list[int] = []

    def publish(_: object, message: GaussianArray) -> None:
        time.sleep(0.002)  # in which another thread would send
        sent.append(message.revision)

    monkeypatch.setattr(type(publisher._wire._publisher), "publish", publish)
    with ThreadPoolExecutor(4) as threads:
        list(threads.map(lambda n: publisher.upsert([n], random_splats(1)), range(40)))
    assert sent == list(range(2, 42))
    assert len(publisher) == 40


RECORDER = """
import sys, rclpy
from rosplat_msgs.msg import GaussianArray
from rosplat_ros.qos import MAP_VOLATILE

rclpy.init()
node = rclpy.create_node("recorder")
heard = []
node.create_subscription(
    GaussianArray, sys.argv[1], lambda batch: heard.append(batch.revision), MAP_VOLATILE
)
print("listening", flush=True)
while not heard or heard[-1] < int(sys.argv[2]):
    rclpy.spin_once(node, timeout_sec=1.0)
print(*heard, flush=True)
rclpy.shutdown()
"""


def test_a_recorder_that_is_slow_misses_nothing_of_a_repeat(
    node: Node, random_splats: Maker
) -> None:
    """A publisher keeps eight batches: it waits for who listens. Others at the map don't wait."""
    publisher = MapPublisher(node, chunk_bytes=40_000)
    publisher.replace(random_splats(20_000, 3))
    parts, last = publisher.revision, 2 * publisher.revision + 1
    assert parts > 40
    topic = node.resolve_topic_name("gaussians")
    command = [sys.executable, "-c", RECORDER, topic, str(last)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as recorder:
        try:
            assert recorder.stdout
            assert recorder.stdout.readline() == "listening\n"
            until = time.monotonic() + 10
            while not node.count_subscribers("gaussians") and time.monotonic() < until:
                time.sleep(0.01)
            time.sleep(0.5)  # until it knows the publisher, too
            recorder.send_signal(signal.SIGSTOP)
            repeating = threading.Thread(target=publisher.repeat)
            repeating.start()
            time.sleep(1.0)
            assert repeating.is_alive()
            publisher.delete([3])
            recorder.send_signal(signal.SIGCONT)
            repeating.join(60)
            assert not repeating.is_alive()
            heard = [int(revision) for revision in recorder.stdout.readline().split()]
        finally:
            recorder.kill()
    assert heard == list(range(parts + 1, last + 1))


def test_a_publisher_ends_with_its_block(node: Node, random_splats: Maker) -> None:
    splats = packed(random_splats(10))
    with MapPublisher(node) as publisher:
        publisher.replace(splats)
        kept = weakref.ref(splats.rows)
    assert node.count_publishers("gaussians") == 0
    topic = node.resolve_topic_name("gaussians")
    assert not [each for each in threading.enumerate() if each.name.startswith(topic)]
    assert not [service for service in node.services if "gaussians" in service.srv_name]
    with pytest.raises(RuntimeError, match=r"gaussians: its publisher is closed"):
        publisher.delete([3])
    publisher.close()
    del publisher, splats
    gc.collect()
    assert kept() is None  # nor does the node hold the map any longer


def test_a_map_is_not_pulled_once_its_node_is_destroyed(node: Node, random_splats: Maker) -> None:
    author = rclpy.create_node("author", context=node.context)
    publisher = MapPublisher(author, topic="/authors_map")  # which nobody closes
    publisher.replace(random_splats(10))
    client = node.create_client(PullMap, "/authors_map/pull")
    assert client.wait_for_service(30.0)
    threads = [each for each in threading.enumerate() if each.name.startswith("/authors_map")]
    assert len(threads) == 2
    author.destroy_node()
    for thread in threads:
        thread.join(PATIENCE)
        assert not thread.is_alive()
    deadline = time.monotonic() + PATIENCE
    while client.service_is_ready():
        assert time.monotonic() < deadline
        time.sleep(0.05)
    publisher.close()


def test_a_map_may_go_on_in_its_author_s_rows(node: Node, random_splats: Maker) -> None:
    splats = packed(replace(random_splats(3000), channels={"label": np.arange(3000)}))
    publisher = MapPublisher(node)
    publisher.replace(splats)
    with pytest.raises(ValueError, match="read-only"):
        splats.rows[0] = 0
    _, before = publisher.snapshot()
    other = packed(random_splats(2, 0, seed=1))
    publisher.upsert([5, 2999], other)
    publisher.delete(range(7, 10))
    slots, held = publisher.snapshot()
    kept = np.delete(np.arange(3000), [7, 8, 9])
    np.testing.assert_array_equal(slots, kept)
    expected = before.sh.copy()
    expected[[5, 2999]] = 0
    expected[[5, 2999], 0] = other.rows[:, 7:].astype("<u4").view(np.float16)[:, :3]
    np.testing.assert_array_equal(held.sh, expected[kept])
    np.testing.assert_array_equal(held.channels["label"][5:8], [np.nan, 6, 10])
    assert publisher.append(other).tolist() == [7, 8]
    assert len(publisher) == 2999


def test_a_packed_map_travels_as_it_is(
    node: Node, listener: Any, random_splats: Maker, tmp_path: Path
) -> None:
    """So does a page that was written to since."""
    splats = random_splats(3000, 3)
    splats = replace(splats, origin=np.array([5e5, 0, 0]), channels={"label": np.arange(3000)})
    formats.save(tmp_path / "scene.ply", splats)
    packed = load_scene_into(IntoPacked(), str(tmp_path / "scene.ply"), lambda _: None, print)
    publisher = MapPublisher(node)
    publisher.replace(packed)
    listener.wait_for(3000)
    _, heard = listener.map.snapshot()
    sent = b"".join(bytes(batch.payload) for batch in listener.batches)
    assert sent == packed.rows.tobytes()
    np.testing.assert_array_equal(heard.channels["label"], packed.channels["label"])
    assert np.ptp(packed.channels["label"][:10]) > 9  # in the order of slots

    rest = np.arange(3000) != 5
    publisher.upsert([5], splats[:1])
    slots, held = publisher.snapshot()
    assert slots == range(3000)
    np.testing.assert_array_equal(held.positions[5], splats.positions[0])
    np.testing.assert_array_equal(held.sh[rest], heard.sh[rest])
    _, pulled = publisher._map.pull("", 0, 0, 3)[0]  # after the REPLACE
    expected = packed.rows.copy()
    expected[5] = _core.pack_splats(splats[:1], np.ones(1, bool))
    assert pulled.payload.tobytes() == expected.tobytes()


def test_progress_may_look_at_the_map(node: Node, random_splats: Maker) -> None:
    publisher = MapPublisher(node, chunk_bytes=50_000)
    told: list[tuple[int, int]] = []
    publisher.replace(
        random_splats(1000), progress=lambda count: told.append((count, len(publisher)))
    )
    assert sum(count for count, _ in told) == 1000
    assert {size for _, size in told} == {1000}


def test_who_is_in_a_hurry_is_not_kept_by_the_map_before(
    node: Node, random_splats: Maker, monkeypatch: pytest.MonkeyPatch
) -> None:
    publisher = MapPublisher(node)
    publisher.replace(random_splats(3))
    sent: list[int] = []

    def publish(_: object, message: GaussianArray) -> None:
        sent.append(message.revision)
        raise KeyboardInterrupt

    with monkeypatch.context() as failing:
        failing.setattr(type(publisher._wire._publisher), "publish", publish)
        with pytest.raises(KeyboardInterrupt):
            publisher.replace(random_splats(5))
    assert (sent, len(publisher)) == ([2], 3)
    publisher.upsert([0], random_splats(1))
    assert publisher.revision > 2


def test_diagnostics_tell_of_the_map_though_nobody_spins_its_node(
    node: Node, random_splats: Maker
) -> None:
    heard: list[DiagnosticStatus] = []
    other = rclpy.create_node("other", namespace=node.get_namespace(), context=node.context)
    other.create_subscription(
        DiagnosticArray, "/diagnostics", lambda array: heard.extend(array.status), 10
    )
    name = f"{node.get_namespace()[1:]}/test: {node.resolve_topic_name('gaussians')}"

    def last(level: bytes) -> dict[str, str]:
        heard.clear()
        executor = SingleThreadedExecutor(context=node.context)
        executor.add_node(other)
        deadline = time.monotonic() + PATIENCE
        while not (mine := [s for s in heard if (s.name, s.level) == (name, level)]):
            assert time.monotonic() < deadline
            executor.spin_once(0.1)
        executor.shutdown()
        return {value.key: value.value for value in mine[-1].values}

    with MapPublisher(node, chunk_bytes=400) as publisher:  # more batches than a late joiner hears
        publisher.replace(random_splats(100, 0))
        values = last(DiagnosticStatus.OK)
        assert (values["Splats"], values["Map"]) == ("100", publisher.map_id)
        assert int(values["Revision"]) == publisher.revision
        assert int(values["Bytes sent"]) == 100 * 36
        assert (values["Subscribers"], values["Pulls answered"]) == ("0", "0")
        Listener(other).wait_for(100)  # which pulls
        values = last(DiagnosticStatus.OK)
        assert (values["Subscribers"], values["Pulls answered"]) == ("1", "1")
        assert int(values["Bytes sent"]) == 2 * 100 * 36
        rival = other.create_publisher(GaussianArray, "gaussians", 1)
        last(DiagnosticStatus.WARN)
        other.destroy_publisher(rival)
    assert not [p for p in node.publishers if p.topic_name == "/diagnostics"]
    other.destroy_node()


SEEN = Camera(0, 160, 120, 150, 150, 80, 60, look_at((0, -8, 0), (0, 0, 0)))


def test_receivers_of_any_time_hold_the_budget_and_no_more(
    node: Node,
    random_splats: Maker,
    listener: Listener,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(bounded_map, "REST", 0)
    said: list[str] = []
    with MapPublisher(node, budget=1500) as publisher:
        monkeypatch.setattr(publisher._wire, "inform", said.append)
        for group in range(3):
            slots = publisher.append(random_splats(1000, 2, seed=group), group=group)
            publisher.look_from(SEEN)
        publisher.move({1: Pose(position=Point(z=500.0))})
        publisher.delete(slots[:10])
        publisher.look_from(SEEN)
        assert (len(publisher), len(publisher.snapshot()[0])) == (2990, 2990)
        listener.wait(
            lambda: listener.batches and listener.batches[-1].revision == publisher.revision
        )
        assert listener.map
        assert len(listener.map) == 1500
        with receiver(node, publisher.revision, tmp_path / "late.npz") as late:
            pass
        slots, splats = listener.map.snapshot()
        np.testing.assert_array_equal(late["slots"], slots)
        np.testing.assert_array_equal(late["sh"], splats.sh)
        known = {position.tobytes() for position in publisher.snapshot()[1].positions}
        assert all(position.tobytes() in known for position in splats.positions)
        assert publisher.budget_psnr() > 20
        (line,) = said
        assert re.fullmatch(r"1,500 of 2,\d+ splats are published: .* [\d.]+ dB of .*", line)
        response = listener.call(RepeatMap, "gaussians/repeat")
        assert (response.success, response.splats) == (True, 1500)


def test_a_replaced_map_is_complete_with_its_budget(
    node: Node, random_splats: Maker, listener: Listener
) -> None:
    sent: list[int] = []
    with MapPublisher(node, budget=700) as publisher:
        publisher.replace(packed(random_splats(2000, 1)), progress=sent.append)
        listener.wait_for(700)
        assert sum(sent) == 700
        assert {batch.expected_slots for batch in listener.batches} == {700}


@pytest.mark.parametrize("budget", [0, -1, 1.5, 2**25 + 1])
def test_a_budget_that_is_none_is_refused(node: Node, budget: Any) -> None:
    with pytest.raises(ValueError, match="budget: "):
        MapPublisher(node, budget=budget)


def test_edits_of_nothing_cost_no_budget(node: Node, random_splats: Maker) -> None:
    none = random_splats(0)
    with MapPublisher(node, budget=3) as publisher:
        publisher.replace(none)
        publisher.look_from(SEEN)
        publisher.upsert(range(0), none)
        publisher.upsert([], none)
        publisher.append(none)
        publisher.delete(range(0))
        publisher.delete([])
        assert len(publisher) == 0


def test_who_has_no_budget_looks_from_nowhere(node: Node) -> None:
    publisher = MapPublisher(node)
    with pytest.raises(ValueError, match="budget: the publisher has none"):
        publisher.look_from(SEEN)
    with pytest.raises(TypeError, match="camera: expected Camera, got NoneType"):
        publisher.look_from(None)  # type: ignore[arg-type]


def test_a_parameter_overrides_qos_of_each_publisher_in_turn(random_splats: Maker) -> None:
    """Of the second one, too, whose parameters are declared already."""
    context = rclpy.Context()
    policy = "qos_overrides./gaussians.publisher.reliability"
    rclpy.init(args=["--ros-args", "-p", f"{policy}:=best_effort"], context=context)
    node = rclpy.create_node("test", context=context)
    for _ in range(2):
        with MapPublisher(node) as publisher:
            publisher.replace(random_splats(1))
            (own,) = [p for p in node.publishers if p.topic_name == "/gaussians"]
            assert own.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT
            assert own.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
    assert PULLED_MAP.reliability == ReliabilityPolicy.RELIABLE
    node.destroy_node()
    context.try_shutdown()
