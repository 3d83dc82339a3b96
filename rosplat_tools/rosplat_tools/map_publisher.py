"""Publishes a map of Gaussians and its edits: what a SLAM back end links to be seen in rviz."""

from __future__ import annotations

import contextlib
import time
import uuid
from collections.abc import Callable, Iterator, Mapping
from threading import RLock

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Pose
from numpy.typing import ArrayLike, NDArray
from rclpy.duration import Duration
from rclpy.node import Node
from std_msgs.msg import Header

from rosplat_msgs.msg import GaussianArray
from rosplat_sorter.qos import HISTORY_DEPTH, map_qos
from rosplat_tools.messages import (
    COMPRESSIONS,
    NONE,
    Slots,
    array_bytes,
    chunks,
    encode,
    encode_deletion,
    encode_move,
)
from rosplat_tools.poses import to_matrix, to_pose
from rosplat_tools.slot_map import Group, SlotMap
from rosplat_tools.splats import Splats

CHUNK_BYTES = 8_000_000

# What a history takes at most, in maps, and what it may always take [bytes].
HISTORY_MAPS = 2
HISTORY_FLOOR = 64_000_000

# How long a new writer waits for the subscribers of the one before it. [s]
REMATCH_TIMEOUT = 1.0

# How long slow subscribers are waited for before a snapshot that can't be put off; then they get it
# as a new map. [s]
ACKNOWLEDGE_TIMEOUT = 1.0

Progress = Callable[[int], None]
"""Is told how many more splats have gone out; what it raises ends the sending."""


class MapPublisher:
    """Owns the topic of one map: a map_id, its revisions, and a copy of the map by slot.

    A late joiner rebuilds the map from the batches that the middleware keeps, the last
    history_depth. So the history always begins with a REPLACE and holds every batch since. Each
    REPLACE starts a new writer, whose history is empty. An edit that the history has no room for
    sends the whole map first, as a REPLACE and UPSERTs of large chunks. These fill at most half
    the history, so the next such snapshot is history_depth / 2 edits away or farther. They repeat
    the last revisions, marked as a snapshot: subscribers that have those drop them.

    Splats may be written in groups, submaps say, and groups placed by `move`: what a loop closure
    takes is a pose for each, no splats. A group that was never placed is where the map's frame is.

    The same is done for memory's sake where the history takes more than twice what the map takes.
    While a subscriber lags behind, that waits until it takes four times as much.

    Calls are serialised, from any thread; they return when the middleware has taken the batches.
    Where sending an edit ends by an exception, the next one sends the whole map, as a new one.
    """

    def __init__(
        self,
        node: Node,
        *,
        frame_id: str = "map",
        topic: str = "gaussians",
        history_depth: int = HISTORY_DEPTH,
        chunk_bytes: int = CHUNK_BYTES,
        compression: str = NONE,
    ) -> None:
        """Advertises the topic; the map is empty, and nothing is sent yet.

        compression: NONE, or one of messages.COMPRESSIONS: for subscribers beyond a network. Raises
        ValueError for another, a history_depth under 2 or a chunk_bytes under 1.
        """
        if history_depth < 2:
            raise ValueError(f"history_depth: at least 2 batches, got {history_depth}")
        if chunk_bytes < 1:
            raise ValueError(f"chunk_bytes: at least 1, got {chunk_bytes}")
        if compression not in COMPRESSIONS:
            known = ", ".join(COMPRESSIONS)
            raise ValueError(f"compression: expected one of {known}, got '{compression}'")
        self.frame_id = frame_id
        self._compression = compression
        self._node = node
        self._topic = topic
        self._depth = history_depth
        self._qos = map_qos(history_depth)
        self._chunk_bytes = chunk_bytes
        self._lock = RLock()
        self._map_id = str(uuid.uuid4())
        self._revision = 0
        self._map = SlotMap()
        self._expected_slots = 0
        self._all_sent = True
        self._publisher = node.create_publisher(GaussianArray, topic, self._qos)
        self._in_history = 0
        self._history_bytes = 0
        # Each takes a batch of a snapshot, which may fill half the history; poses take two.
        self._most_groups = history_depth // 2 - 2

    @property
    def map_id(self) -> str:
        """Names this publisher's run."""
        return self._map_id

    @property
    def revision(self) -> int:
        """Revision of the last batch that was sent, 0 before the first."""
        return self._revision

    def __len__(self) -> int:
        """Number of slots in use."""
        with self._lock:
            return len(self._map)

    def snapshot(self) -> tuple[Slots, Splats]:
        """A copy of the map as it is: the slots in use, ascending, and their splats.

        In the map's frame, each group where it was placed.
        """
        with self._lock:
            return self._map.snapshot()

    def replace(
        self,
        splats: Splats,
        *,
        expected_slots: int | None = None,
        stamp: Time | None = None,
        progress: Progress | None = None,
    ) -> None:
        """Makes splats the map, in slots 0 to n - 1 and group 0; forgets where groups were placed.

        expected_slots is how many slots the finished map will need, by default n; stamp is the time
        of the map, by default now. Raises ValueError for more splats, or expected slots, than a map
        has slots. Where sending fails, the map before stays, and is sent again.
        """
        _check_type(splats)
        _check_stamp(stamp)
        most = GaussianArray.MAX_SLOTS
        if len(splats) > most:
            raise ValueError(f"{len(splats)} splats: a map has {most} slots")
        expected = _whole("expected_slots", expected_slots or 0, most)
        splats = splats.without_empty_bands()
        with self._lock:
            before = self._map, self._expected_slots
            self._map = SlotMap(splats)
            self._tell_of(len(splats) - len(self._map))
            self._expected_slots = len(splats) if expected_slots is None else expected
            try:
                with self._sending():
                    self._send_map([Group(0, range(len(splats)), splats)], stamp, progress)
            except BaseException as error:
                self._map, self._expected_slots = before
                if isinstance(error, Exception):  # and nobody is in a hurry to end
                    self._send_back(stamp)
                raise

    def expect(self, slots: int) -> None:
        """Has the next batches say that the finished map will need so many slots, 0: who knows.

        Raises ValueError for more than a map has.
        """
        slots = _whole("expected_slots", slots, GaussianArray.MAX_SLOTS)
        with self._lock:
            self._expected_slots = slots

    def upsert(
        self,
        slots: range | ArrayLike,
        splats: Splats,
        *,
        group: int = 0,
        stamp: Time | None = None,
    ) -> None:
        """Writes the i-th splat to the i-th slot, in use or not; all are in one group.

        Slots come in blocks of GaussianArray.SLOTS_PER_BLOCK, whose splats are of one group. Raises
        ValueError, and sends nothing, where a slot is named twice or can't be one, where slots and
        splats differ in number, where a block holds splats of another group, or where some of the
        map is antialiased and some is not.
        """
        _check_type(splats)
        _check_stamp(stamp)
        slots = _checked(slots)
        group = _whole("group", group, GaussianArray.MAX_GROUPS - 1)
        if len(slots) != len(splats):
            raise ValueError(f"{len(splats)} splats for {len(slots)} slots")
        with self._lock:
            self._check_room({*self._map.group_numbers, group})
            splats = splats.without_empty_bands()
            self._tell_of(self._map.write(slots, splats, group))
            with self._sending():
                splats = splats.with_sh_degree(self._map.sh_degree)
                parts = list(chunks(splats, self._chunk_bytes))
                if not self._make_room(len(parts), stamp):
                    return
                for part in parts:
                    self._send_splats(
                        GaussianArray.UPSERT, Group(group, slots[part], splats[part]), stamp
                    )

    def delete(self, slots: range | ArrayLike, *, stamp: Time | None = None) -> None:
        """Empties slots. Raises ValueError where one is named twice, or can't be one."""
        _check_stamp(stamp)
        slots = _checked(slots)
        with self._lock:
            self._map.clear(slots)
            with self._sending():
                if not self._make_room(1, stamp):
                    return
                self._revision += 1
                self._send(
                    encode_deletion(
                        slots,
                        header=self._header(stamp),
                        map_id=self._map_id,
                        revision=self._revision,
                        expected_slots=self._expected_slots,
                    )
                )

    def move(self, poses: Mapping[int, Pose | ArrayLike], *, stamp: Time | None = None) -> None:
        """Places groups in the map's frame: {group: a Pose or a rigid transform (4, 4)}.

        Raises ValueError, and sends nothing, for a pose that is none.
        """
        _check_stamp(stamp)
        checked = {
            _whole("group", group, GaussianArray.MAX_GROUPS - 1): to_pose(pose, f"poses[{group}]")
            for group, pose in poses.items()
        }
        if not checked:
            return
        with self._lock:
            self._map.poses |= {group: to_matrix(pose) for group, pose in checked.items()}
            with self._sending():
                if not self._make_room(1, stamp):
                    return
                self._send_poses(checked, stamp)

    def _check_room(self, groups: set[int]) -> None:
        if len(groups) > max(1, self._most_groups):
            raise ValueError(
                f"group: a history_depth of {self._depth} has room for {self._most_groups} groups"
            )

    def _tell_of(self, left_out: int) -> None:
        if left_out:
            self._node.get_logger().warning(
                f"{self._topic}: {left_out} splats are left out: a value is not finite, a scale "
                "negative or a quaternion zero",
                throttle_duration_sec=5.0,
            )

    def _send_back(self, stamp: Time | None) -> None:
        """Sends the map to whom a part of another has come; if that fails, the next edit does."""
        with contextlib.suppress(Exception), self._sending():
            self._send_map(self._map.groups(), stamp)

    @contextlib.contextmanager
    def _sending(self) -> Iterator[None]:
        try:
            yield
        except BaseException:
            self._all_sent = False
            raise

    def _make_room(self, batches: int, stamp: Time | None) -> bool:
        """Whether edits can follow in a history that begins with a REPLACE.

        Where they can't, the map as they leave it has been sent in their place.
        """
        room = max(HISTORY_FLOOR, HISTORY_MAPS * self._map.nbytes)
        if self._all_sent and 0 < self._in_history <= self._depth - batches:
            if self._history_bytes <= room:
                return True
            if self._history_bytes <= 2 * room and not self._all_have_all(0.0):
                return True
        groups = self._map.groups()
        needed = len(self._large_chunks(groups)) + (2 if self._map.poses else 0)
        repeatable = (
            self._all_sent
            and needed <= self._revision
            and needed <= self._depth - batches
            and self._all_have_all(ACKNOWLEDGE_TIMEOUT)
        )
        if repeatable:
            self._revision -= needed
        self._send_map(groups, stamp, snapshot=repeatable)
        return repeatable

    def _all_have_all(self, timeout: float) -> bool:
        """Whether each subscriber has all that was sent, at the latest after a timeout [s].

        Who still lacks a revision that a snapshot repeats would take it for that one.
        """
        deadline = time.monotonic() + timeout
        # Not for as long as that at once: rclpy keeps Python's lock while it waits.
        while not (acknowledged := self._publisher.wait_for_all_acked(Duration())):
            if time.monotonic() > deadline:
                break
            time.sleep(0.005)
        return acknowledged

    def _large_chunks(self, groups: list[Group]) -> list[tuple[Group, slice]]:
        """Parts of groups that fill half the history at most."""
        parts = max(1, self._depth // 2 - len(groups) + 1)
        size = sum(group.splats.nbytes for group in groups) // parts + 1
        return [
            (group, part)
            for group in groups
            for part in chunks(group.splats, max(self._chunk_bytes, size))
        ]

    def _send_map(
        self,
        groups: list[Group],
        stamp: Time | None,
        progress: Progress | None = None,
        snapshot: bool = False,
    ) -> None:
        self._start_history()
        operation = GaussianArray.REPLACE
        if self._map.poses:  # before any splat, so that none is seen elsewhere
            nothing = Group(0, range(0), groups[0].splats[:0])
            self._send_splats(operation, nothing, stamp, snapshot)
            poses = {group: to_pose(pose) for group, pose in self._map.poses.items()}
            self._send_poses(poses, stamp, snapshot)
            operation = GaussianArray.UPSERT
        for group, part in self._large_chunks(groups):
            some = Group(group.group, group.slots[part], group.splats[part])
            self._send_splats(operation, some, stamp, snapshot)
            operation = GaussianArray.UPSERT
            if progress:
                progress(len(some.slots))
        self._all_sent = True

    def _send_splats(
        self, operation: int, some: Group, stamp: Time | None, snapshot: bool = False
    ) -> None:
        self._revision += 1
        self._send(
            encode(
                some.splats,
                some.slots,
                header=self._header(stamp),
                map_id=self._map_id,
                revision=self._revision,
                operation=operation,
                group=some.group,
                expected_slots=self._expected_slots,
                snapshot=snapshot,
                compression=self._compression,
            )
        )

    def _send_poses(
        self, poses: Mapping[int, Pose], stamp: Time | None, snapshot: bool = False
    ) -> None:
        self._revision += 1
        self._send(
            encode_move(
                poses,
                header=self._header(stamp),
                map_id=self._map_id,
                revision=self._revision,
                expected_slots=self._expected_slots,
                snapshot=snapshot,
            )
        )

    def _send(self, message: GaussianArray) -> None:
        self._publisher.publish(message)
        self._in_history += 1
        self._history_bytes += array_bytes(message)

    def _header(self, stamp: Time | None) -> Header:
        return Header(stamp=stamp or self._node.get_clock().now().to_msg(), frame_id=self.frame_id)

    def _start_history(self) -> None:
        """Puts a writer with an empty history in place of one that has sent something.

        What its subscribers have not received yet is lost to them, and superseded by what follows.
        """
        if not self._in_history:
            return
        old = self._publisher
        self._publisher = self._node.create_publisher(GaussianArray, self._topic, self._qos)
        self._in_history = self._history_bytes = 0
        # A subscriber that asks for no history would miss what is sent before it knows the writer.
        deadline = time.monotonic() + REMATCH_TIMEOUT
        while (
            self._publisher.get_subscription_count() < old.get_subscription_count()
            and time.monotonic() < deadline
        ):
            time.sleep(0.002)
        self._node.destroy_publisher(old)


def _checked(slots: range | ArrayLike) -> range | NDArray[np.uint32]:
    if isinstance(slots, range):
        if slots.step != 1:
            raise ValueError(f"slots: a range must be contiguous, got {slots}")
    else:
        slots = np.asarray(slots)
        if not slots.size:
            return np.zeros(0, np.uint32)  # NumPy takes an empty list for floats
        if slots.ndim != 1 or not np.issubdtype(slots.dtype, np.integer):
            raise ValueError(f"slots: expected (n,) integers, got {slots.shape} {slots.dtype}")
        ascending = bool((slots[1:] > slots[:-1]).all())
        if not ascending and len(np.unique(slots)) < len(slots):
            raise ValueError("slots: each slot may be named once")
    if len(slots):
        low, high = (
            (slots[0], slots[-1]) if isinstance(slots, range) else (slots.min(), slots.max())
        )
        if low < 0 or high >= GaussianArray.MAX_SLOTS:
            raise ValueError(f"slots: a slot is a number from 0 to {GaussianArray.MAX_SLOTS - 1}")
    return slots if isinstance(slots, range) else slots.astype(np.uint32)


def _whole(name: str, number: int, most: int) -> int:
    """A number from 0 to most as Python's own: of NumPy's, messages take only some."""
    if not isinstance(number, int | np.integer) or not 0 <= number <= most:
        raise ValueError(f"{name}: a number from 0 to {most}, got {number}")
    return int(number)


def _check_type(splats: Splats) -> None:
    if not isinstance(splats, Splats):
        kind = type(splats).__name__
        raise TypeError(f"splats: expected Splats, got {kind}; scenes.load_scene reads a file")


def _check_stamp(stamp: Time | None) -> None:
    """Before the map changes: a batch that can't be made would be missing from its revisions."""
    if not isinstance(stamp, Time | None):
        raise TypeError(
            f"stamp: expected a builtin_interfaces Time, as to_msg() makes, got {stamp}"
        )
