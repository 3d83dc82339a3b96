"""Publishes a map of Gaussians and its edits: what a SLAM back end links to be seen in rviz."""

from __future__ import annotations

import contextlib
import uuid
from collections.abc import Callable, Iterable, Iterator, Mapping
from threading import RLock
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Pose
from numpy.typing import ArrayLike, NDArray
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.node import Node
from std_msgs.msg import Header

from rosplat_core.splats import Splats
from rosplat_msgs.msg import GaussianArray
from rosplat_msgs.srv import PullMap, RepeatMap
from rosplat_sorter.qos import PULLED_MAP
from rosplat_tools.map_changes import MapChanges
from rosplat_tools.messages import (
    COMPRESSIONS,
    NONE,
    Slots,
    chunks,
    encode,
    encode_deletion,
    encode_move,
)
from rosplat_tools.poses import to_matrix, to_pose
from rosplat_tools.slot_map import Group, SlotMap

CHUNK_BYTES = 8_000_000
# Of splats in an answer to a pull: each client, idle or not, keeps room for some of the largest.
ANSWER_BYTES = 2_000_000

Progress = Callable[[int], None]
"""Is told how many more splats have gone out; what it raises ends the sending."""


class MapPublisher:
    """Owns the topic of one map: a map_id, its revisions, and a copy of the map by slot.

    Batches go out as they are made, and nobody is waited for. Who joins late, or misses some,
    pulls what has changed since the last revision that it has, as it is now, from the service
    <topic>/pull. It is answered by the node's executor between its other callbacks; where that has
    several threads, beside them. Only splats that a client lacks are copied, 2 MB for an answer at
    most. Who just listens to the topic, a bag say, hears the whole map from
    `repeat` or the service <topic>/repeat.

    Splats may be written in groups, submaps say, and groups placed by `move`: what a loop closure
    takes is a pose for each, no splats. A group that was never placed is where the map's frame is.

    Calls are serialised, from any thread; they return when the middleware has taken the batches.
    Where sending an edit ends by an exception, it is part of the map all the same: who hears the
    next batch pulls it.
    """

    def __init__(
        self,
        node: Node,
        *,
        frame_id: str = "map",
        topic: str = "gaussians",
        chunk_bytes: int = CHUNK_BYTES,
        compression: str = NONE,
    ) -> None:
        """Advertises the topic and its services; the map is empty, and nothing is sent yet.

        chunk_bytes: of splats in a message, at most. compression: NONE, or one of
        messages.COMPRESSIONS: for subscribers beyond a network. Raises ValueError for another, or a
        chunk_bytes under 1.
        """
        if chunk_bytes < 1:
            raise ValueError(f"chunk_bytes: at least 1, got {chunk_bytes}")
        if compression not in COMPRESSIONS:
            known = ", ".join(COMPRESSIONS)
            raise ValueError(f"compression: expected one of {known}, got '{compression}'")
        self.frame_id = frame_id
        self._compression = compression
        self._node = node
        self._topic = node.resolve_topic_name(topic)
        self._chunk_bytes = chunk_bytes
        self._lock = RLock()
        self._map_id = str(uuid.uuid4())
        self._revision = 0
        self._map = SlotMap()
        self._changes = MapChanges()
        self._expected_slots = 0
        self._publisher = node.create_publisher(GaussianArray, topic, PULLED_MAP)
        group = MutuallyExclusiveCallbackGroup()
        for kind, name, serve in (
            (PullMap, "pull", self._on_pull),
            (RepeatMap, "repeat", self._on_repeat),
        ):
            node.create_service(kind, f"{self._topic}/{name}", serve, callback_group=group)

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
                self._send_map([Group(0, range(len(splats)), splats)], stamp, progress)
            except BaseException as error:
                self._map, self._expected_slots = before
                self._revision += 1  # that nobody has
                self._changes = MapChanges(begun=self._revision)
                # To whom a part of the other has come; where that fails, it is pulled.
                if isinstance(error, Exception):  # and nobody is in a hurry to end
                    with contextlib.suppress(Exception):
                        self._send_map(self._map.groups(), stamp)
                raise

    def repeat(self) -> None:
        """Sends the whole map once more, as it is: for bags, and others that only listen."""
        with self._lock:
            self._send_map(self._map.groups(), None)

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
        splats = splats.without_empty_bands()
        with self._lock:
            splats = splats.with_sh_degree(max(splats.sh_degree, self._map.sh_degree))
            self._tell_of(self._map.write(slots, splats, group))
            parts = list(chunks(splats, self._chunk_bytes))
            self._changes.write(slots, self._revision + len(parts), group)
            operation = GaussianArray.UPSERT if self._revision else GaussianArray.REPLACE
            with self._numbering(len(parts)):
                for part in parts:
                    some = Group(group, slots[part], splats[part])
                    self._send(self._splats(operation, some, stamp))
                    operation = GaussianArray.UPSERT

    def delete(self, slots: range | ArrayLike, *, stamp: Time | None = None) -> None:
        """Empties slots. Raises ValueError where one is named twice, or can't be one."""
        _check_stamp(stamp)
        slots = _checked(slots)
        with self._lock:
            self._map.clear(slots)
            self._changes.clear(slots, self._edit_revision)
            self._send_edit(self._deletion(slots, stamp))

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
            self._changes.place(list(checked), self._edit_revision)
            self._send_edit(self._move(checked, stamp))

    def _tell_of(self, left_out: int) -> None:
        if left_out:
            self._node.get_logger().warning(
                f"{self._topic}: {left_out} splats are left out: a value is not finite, a scale "
                "negative or a quaternion zero",
                throttle_duration_sec=5.0,
            )

    # --- Sending ----------------------------------------------------------------------------------

    def _send_map(
        self, groups: list[Group], stamp: Time | None, progress: Progress | None = None
    ) -> None:
        parts = [
            Group(group.group, group.slots[part], group.splats[part])
            for group in groups
            for part in chunks(group.splats, self._chunk_bytes)
        ]
        revision = self._revision + 1
        before = 2 if self._map.poses else 0
        self._changes = MapChanges(begun=revision)
        self._changes.place(list(self._map.poses), revision + 1)
        for number, part in enumerate(parts, revision + before):
            self._changes.write(part.slots, number, part.group)
        operation = GaussianArray.REPLACE
        with self._numbering(before + len(parts)):
            if self._map.poses:  # before any splat, so that none is seen elsewhere
                self._send(self._beginning(groups[0].splats, stamp))
                self._send(self._move(self._poses(), stamp))
                operation = GaussianArray.UPSERT
            for part in parts:
                self._send(self._splats(operation, part, stamp))
                operation = GaussianArray.UPSERT
                if progress:
                    progress(len(part.slots))

    @property
    def _edit_revision(self) -> int:
        """Of an edit without splats. The first follows an empty REPLACE: see _send_edit."""
        return self._revision + 1 if self._revision else 2

    def _send_edit(self, batch: GaussianArray) -> None:
        # Each map begins with a REPLACE: where a bag loops, it empties that of the round before.
        begins = not self._revision
        with self._numbering(2 if begins else 1):
            if begins:
                beginning = self._beginning(self._map.groups()[0].splats, batch.header.stamp)
                self._send(beginning)
            self._send(batch)

    @contextlib.contextmanager
    def _numbering(self, batches: int) -> Iterator[None]:
        """Of batches to send: those that aren't, because sending fails, are lost to all."""
        last = self._revision + batches
        try:
            yield
        finally:
            self._revision = last

    def _send(self, message: GaussianArray) -> None:
        self._revision += 1
        message.revision = self._revision
        self._publisher.publish(message)

    # --- Batches, of the revision that the map has now --------------------------------------------

    def _beginning(self, splats: Splats, stamp: Time | None = None) -> GaussianArray:
        return self._splats(GaussianArray.REPLACE, Group(0, range(0), splats[:0]), stamp)

    def _splats(self, operation: int, some: Group, stamp: Time | None = None) -> GaussianArray:
        return encode(
            some.splats,
            some.slots,
            **self._of_map(stamp),
            operation=operation,
            group=some.group,
            compression=self._compression,
        )

    def _deletion(self, slots: Slots, stamp: Time | None = None) -> GaussianArray:
        return encode_deletion(slots, **self._of_map(stamp))

    def _move(self, poses: Mapping[int, Pose], stamp: Time | None = None) -> GaussianArray:
        return encode_move(poses, **self._of_map(stamp))

    def _of_map(self, stamp: Time | None) -> dict[str, Any]:
        stamp = stamp or self._node.get_clock().now().to_msg()
        return {
            "header": Header(stamp=stamp, frame_id=self.frame_id),
            "map_id": self._map_id,
            "revision": self._revision,
            "expected_slots": self._expected_slots,
        }

    def _poses(self, groups: Iterable[int] | None = None) -> dict[int, Pose]:
        poses = self._map.poses
        return {group: to_pose(poses[group]) for group in (poses if groups is None else groups)}

    # --- Services ---------------------------------------------------------------------------------

    def _on_pull(self, request: PullMap.Request, response: PullMap.Response) -> PullMap.Response:
        if (
            request.map_id not in ("", self._map_id)
            and self._node.count_publishers(self._topic) > 1
        ):
            self._node.get_logger().warning(
                f"{self._topic}: is published by others, too, and receivers see one map in place "
                "of the other: end all publishers but one",
                throttle_duration_sec=5.0,
            )
        try:
            with self._lock:
                if request.map_id in ("", self._map_id) and self._revision:
                    self._fill(request, response)
        except MemoryError:  # no request may end the node
            self._node.get_logger().error(f"{self._topic}/pull: memory is lacking")
            response = PullMap.Response()
        return response

    def _fill(self, request: PullMap.Request, response: PullMap.Response) -> None:
        after, block = request.after_revision, request.first_block
        if not self._changes.begun <= after <= self._revision:
            # Who goes on with a map that was replaced meanwhile gets the new one in the next round.
            after, block = 0, 0 if after else block
        most = min(self._chunk_bytes, ANSWER_BYTES)
        changed = self._changes.since(after, block, self._map, most)
        batches = response.batches
        if not block:
            if not after:
                batches.append(self._beginning(changed.groups[0].splats))
            placed = self._changes.placed(after)
            if placed:
                batches.append(self._move(self._poses(placed)))
        if len(changed.emptied):
            batches.append(self._deletion(changed.emptied))
        batches += [
            self._splats(GaussianArray.UPSERT, group)
            for group in changed.groups
            if len(group.slots) or not batches
        ]
        for batch in batches:
            batch.expected_slots = self._expected_slots or len(self._map)
        response.next_block = changed.next_page

    def _on_repeat(self, _: RepeatMap.Request, response: RepeatMap.Response) -> RepeatMap.Response:
        try:
            self.repeat()
            response.success, response.splats = True, len(self)
        except Exception as error:  # no request may end the node
            response.message = str(error) or "not enough memory"
        return response


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
