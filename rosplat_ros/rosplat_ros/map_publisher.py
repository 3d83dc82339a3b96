"""Publishes a map of Gaussians and its edits, for SLAM back ends that show maps in rviz2."""

from __future__ import annotations

import threading
import time
import weakref
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Pose
from numpy.typing import ArrayLike, NDArray
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from std_msgs.msg import Header

from rosplat_core.bounded_map import BoundedMap
from rosplat_core.cameras import Camera
from rosplat_core.maps import PublishedBatch, PublishedMap
from rosplat_core.splats import PackedSplats, Splats, check_kind, check_splats, concatenate
from rosplat_core.view import frame_at
from rosplat_msgs.msg import GaussianArray
from rosplat_msgs.srv import PullMap, RepeatMap
from rosplat_ros.batches import array_bytes, pose_values
from rosplat_ros.diagnostics import Diagnostics, Report
from rosplat_ros.messages import NONE, Slots, as_array
from rosplat_ros.poses import pose_of, to_point, to_pose
from rosplat_ros.qos import PULLED_MAP, overridable
from rosplat_ros.service_thread import ServiceThread

CHUNK_BYTES = 8_000_000
# How long `repeat` waits for a subscriber that acknowledges nothing [s]. A subscriber that is gone
# has been given up by the middleware by then.
PATIENCE = 30.0
TELL_BUDGET_EVERY = 30.0  # what a budget costs [s]

Progress = Callable[[int], None]
"""Called with the number of splats that were sent since the last call. An exception from it ends
the sending.
"""

_Time = tuple[int, int]


class MapPublisher:
    """Owns the topic of one map: a map_id, its revisions, and a copy of the map by slot.

    The copy is packed as displays hold splats, 100 bytes each at degree 3, and so are messages.

    A batch is sent as soon as it is made; the publisher waits for nobody. A receiver that joins
    late or misses batches pulls what has changed since its last revision from the service
    <topic>/pull. An answer copies only splats that the client lacks, at most 2 MB. For listeners
    that can't pull, such as a recorder, `repeat` sends the whole map again; so does the service
    <topic>/repeat. Each service has a thread and a hidden node of its own, so the node needn't be
    spun.

    Splats may be written in groups, one for each submap for example, and `move` places groups: a
    loop closure sends a pose for each group and no splats. A group that was never placed is at
    the identity.

    With a budget, receivers hold that many splats at most: those that views need most, which
    `look_from` tells. The others stay with the publisher, and come back when a view needs them.
    `snapshot`, `len`, slots and edits are of the whole map; receivers number slots anew.

    Calls may come from any thread and run one after another. They return when the middleware has
    taken the batches. If sending an edit raises an exception, the edit stays part of the map:
    receivers of the next batch pull it.

    `with MapPublisher(node) as publisher:` closes the publisher at the end.
    """

    def __init__(
        self,
        node: Node,
        *,
        frame_id: str = "map",
        topic: str = "gaussians",
        chunk_bytes: int = CHUNK_BYTES,
        compression: str = NONE,
        budget: int | None = None,
    ) -> None:
        """Advertises the topic and its services. The map is empty, and nothing is sent yet.

        chunk_bytes: the most bytes of a message's arrays. compression: NONE, or another of
        messages.COMPRESSIONS for subscribers across a network. budget: the most splats that
        receivers hold, by default all. Raises ValueError for an unknown compression, a chunk_bytes
        under 1, or a budget that isn't 1 to MAX_SLOTS.
        """
        check_kind(node, Node, "node")
        self._node = node
        self._topic = node.resolve_topic_name(topic)
        self._wire = _Wire(node, topic)
        self.frame_id = frame_id
        arguments = (
            _whole("chunk_bytes", chunk_bytes, 2**63 - 1),
            compression,
            self._wire.send,
            self._wire.warn,
            self._wire.settle,
        )
        self._map: PublishedMap | BoundedMap
        if budget is None:
            self._map = PublishedMap(*arguments)
        else:
            budget = _whole("budget", budget, GaussianArray.MAX_SLOTS)
            self._map = BoundedMap(*arguments, budget)
        self._told_budget = -TELL_BUDGET_EVERY  # when the log last told its cost [s]
        self._wire.advertise()
        served = self._map, self._wire
        pulls = ServiceThread(node, PullMap, f"{self._topic}/pull", partial(_answer, *served))
        # A repeat waits for subscribers, which pull meanwhile. Its thread keeps this object until
        # the node ends.
        repeats = ServiceThread(node, RepeatMap, f"{self._topic}/repeat", self._on_repeat)
        reports = Diagnostics(node, self._topic, partial(_report, *served), spun=pulls.node)
        # Before Python ends, which no thread outlives. The wire first: a repeat waits no longer.
        self._end = weakref.finalize(self, _close, self._wire, pulls, repeats, reports)
        pulls.start()
        repeats.start()

    def close(self) -> None:
        """Ends the topic and its services. Subscribers keep what they have. No edit may follow."""
        self._end()

    def __enter__(self) -> MapPublisher:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def frame_id(self) -> str:
        """The map's frame. A new value, a str, holds from the next batch on."""
        return self._wire.frame_id

    @frame_id.setter
    def frame_id(self, frame_id: str) -> None:
        if not isinstance(frame_id, str):
            raise TypeError(f"frame_id: expected a str, got {frame_id!r}")
        self._wire.frame_id = frame_id

    @property
    def map_id(self) -> str:
        """Identifies this run of the publisher."""
        return self._map.map_id

    @property
    def revision(self) -> int:
        """Revision of the last batch that was sent, 0 before the first."""
        return self._map.revision()

    def __len__(self) -> int:
        """Number of slots in use."""
        return len(self._map)

    def snapshot(self) -> tuple[Slots, Splats]:
        """A copy of the map as it is: the slots in use, ascending, and their splats.

        The splats are as displays hold them, in the map's frame, each group at its pose.
        """
        slots, parts = [], []
        for _, pose, own_slots, arrays in self._map.groups():
            splats = Splats(**arrays)
            slots.append(own_slots)
            parts.append(splats.moved(frame_at(pose[:3], pose[3:])) if pose else splats)
        if len(parts) == 1:
            return _in_short(slots[0]), parts[0]
        all_slots = np.concatenate(slots)
        places = np.argsort(all_slots)
        return _in_short(all_slots[places]), concatenate(parts)[places]

    def replace(
        self,
        splats: Splats | PackedSplats,
        *,
        expected_slots: int | None = None,
        stamp: Time | None = None,
        progress: Progress | None = None,
    ) -> None:
        """Makes splats the map, in slots 0 to n - 1 and group 0, and forgets the poses of groups.

        expected_slots: how many slots the finished map will need, by default n without the splats
        that are left out. stamp: time of the map, by default now. The map uses the rows of
        PackedSplats in place, and makes them read-only. Raises ValueError if splats or
        expected_slots exceed MAX_SLOTS. If sending fails, the previous map stays and is sent again.
        """
        _check_splats(splats)
        if expected_slots is not None:
            expected_slots = _whole("expected_slots", expected_slots, GaussianArray.MAX_SLOTS)
        when = _checked_stamp(stamp)
        with self._wire.replacing(progress):
            self._map.replace(splats, expected_slots, when)
        if isinstance(splats, PackedSplats):
            for array in splats.arrays:
                array.flags.writeable = False

    def repeat(self) -> None:
        """Sends the whole map again, for listeners that can't pull, such as a recorder.

        Waits after each batch until the subscribers have it. Other calls and pulls are served in
        between.
        """
        self._map.repeat()

    def expect(self, slots: int) -> None:
        """Announces, from the next batch on, how many slots the finished map needs; 0 if unknown.

        Raises ValueError for more than MAX_SLOTS.
        """
        self._map.expect(_whole("expected_slots", slots, GaussianArray.MAX_SLOTS))

    def upsert(
        self,
        slots: range | ArrayLike,
        splats: Splats | PackedSplats,
        *,
        group: int = 0,
        stamp: Time | None = None,
    ) -> None:
        """Writes the i-th splat to the i-th slot, in use or not. All belong to one group.

        Slots form blocks of GaussianArray.SLOTS_PER_BLOCK; the splats of a block belong to one
        group. Raises ValueError, and sends nothing, if a slot is named twice or isn't below
        MAX_SLOTS, if slots and splats differ in number, if a block holds splats of another group,
        or if the splats' model differs from the map's.
        """
        _check_splats(splats)
        when = _checked_stamp(stamp)
        slots = _checked(slots)
        group = _whole("group", group, GaussianArray.MAX_GROUPS - 1)
        if len(slots) != len(splats):
            raise ValueError(f"{len(splats)} splats for {len(slots)} slots")
        named = slots.start if isinstance(slots, range) else slots
        self._map.upsert(named, splats, group, when)

    def append(
        self, splats: Splats | PackedSplats, *, group: int = 0, stamp: Time | None = None
    ) -> NDArray[np.uint32]:
        """Writes splats to free slots, and returns the slots, (n,) ascending.

        The publisher chooses slots of blocks that the group has, then of blocks that no splat uses.
        Raises ValueError, and sends nothing, where the map has no room, or as upsert.
        """
        _check_splats(splats)
        when = _checked_stamp(stamp)
        group = _whole("group", group, GaussianArray.MAX_GROUPS - 1)
        slots: NDArray[np.uint32] = self._map.append(splats, group, when)
        return slots

    def delete(self, slots: range | ArrayLike, *, stamp: Time | None = None) -> None:
        """Empties slots. Raises ValueError if a slot is named twice or isn't below MAX_SLOTS."""
        when = _checked_stamp(stamp)
        slots = _checked(slots)
        if isinstance(slots, range):
            self._map.erase_from(slots.start, len(slots), when)
        else:
            self._map.erase(slots, when)

    def move(self, poses: Mapping[int, Pose | ArrayLike], *, stamp: Time | None = None) -> None:
        """Places groups in the map's frame: {group: a Pose or a rigid transform (4, 4)}.

        A matrix whose rotation is off by up to 1e-2 becomes the nearest rotation, and the log says
        so once. Raises ValueError, and sends nothing, if a pose isn't a rigid transform.
        """
        if not isinstance(poses, Mapping):
            kind = type(poses).__name__
            raise TypeError(f"poses: expected {{group: pose}}, such as {{0: pose}}, got {kind}")
        when = _checked_stamp(stamp)
        values: dict[Any, tuple[float, ...]] = {}
        for group, pose in poses.items():
            position, orientation = pose_values(to_pose(pose, f"poses[{group}]"))
            number = _whole("group", group, GaussianArray.MAX_GROUPS - 1)
            values[number] = (*position, *orientation)
        self._map.move(values, when)

    def look_from(self, camera: Camera) -> None:
        """Spends the budget on what a camera in the map's frame sees, and on what others saw.

        The newest view counts most, but what any view has needed counts for more than what none
        has. Call it with each frame: cameras are passed over where they would take more than a
        quarter of the time. Raises ValueError if the publisher has no budget.
        """
        check_kind(camera, Camera, "camera")
        bounded, now = self._bounded(), time.monotonic()
        if not bounded.look_from(camera) or now < self._told_budget + TELL_BUDGET_EVERY:
            return
        if (count := bounded.published()) < len(bounded):
            self._told_budget = now
            self._wire.inform(
                f"{count:,} of {len(bounded):,} splats are published: the last views have "
                f"{bounded.psnr():.1f} dB of the whole map's"
            )

    def budget_psnr(self) -> float:
        """What the budget costs: PSNR of the published map at the last four views. [dB]

        Against the whole map, over what shows it, in colours of band 0; 150 where both are equal,
        NaN before the first view. Draws both. Raises ValueError if the publisher has no budget.
        """
        return self._bounded().psnr()

    def _bounded(self) -> BoundedMap:
        if not isinstance(self._map, BoundedMap):
            raise ValueError("budget: the publisher has none, and publishes all splats")
        return self._map

    def _on_repeat(self, _: RepeatMap.Request, response: RepeatMap.Response) -> RepeatMap.Response:
        try:
            self.repeat()
            response.success, response.splats = True, _published(self._map)
        except Exception as error:  # no request may end the node
            response.message = str(error) or "not enough memory"
        return response


def _close(*parts: _Wire | ServiceThread | Diagnostics) -> None:
    for part in parts:
        part.close()


def _published(map_: PublishedMap | BoundedMap) -> int:
    """Number of splats that receivers hold."""
    return map_.published() if isinstance(map_, BoundedMap) else len(map_)


def _answer(
    published: PublishedMap | BoundedMap,
    wire: _Wire,
    request: PullMap.Request,
    response: PullMap.Response,
) -> PullMap.Response:
    """Answers a pull with the batches that it asks for."""
    if request.map_id not in ("", published.map_id) and wire.rivals:
        wire.warn(
            "is published by others, too, and receivers see one map in place of the other: "
            "end all publishers but one"
        )
    try:
        batches, response.next_block = published.pull(
            request.map_id, request.after_revision, request.first_block, request.most_sh_degree
        )
        response.batches = [wire.message(batch) for batch in batches]
        wire.pulls += 1
        wire.pulled_bytes += sum(map(array_bytes, response.batches))
    except Exception as error:  # no request may end the thread
        wire.warn(f"a pull is not answered: {error or 'memory is lacking'}")
        response = PullMap.Response()
    return response


def _report(published: PublishedMap | BoundedMap, wire: _Wire) -> Report:
    values = {
        "Map": published.map_id,
        "Revision": published.revision(),
        "Splats": _published(published),
        "Splats hidden": len(published) - _published(published),
        "Subscribers": wire.subscribers,
        "Bytes sent": wire.sent_bytes + wire.pulled_bytes,
        "Pulls answered": wire.pulls,
    }
    if wire.rivals:
        return Report("others publish to the topic, too", values, warns=True)
    return Report("publishes" if published.revision() else "nothing is published yet", values)


class _Wire:
    """Sends batches as messages. Holds no reference to the map, which ends with its publisher."""

    def __init__(self, node: Node, topic: str) -> None:
        self.frame_id = ""
        self._node = node
        self._topic = topic
        self._publisher: Publisher | None = None
        self._call = _Call()
        self.sent_bytes = 0  # of the arrays of batches on the topic
        self.pulls = self.pulled_bytes = 0  # pulls answered, and the bytes of their arrays

    def advertise(self) -> None:
        self._publisher = self._node.create_publisher(
            GaussianArray, self._topic, **overridable(PULLED_MAP)
        )

    def close(self) -> None:
        publisher, self._publisher = self._publisher, None
        if publisher:
            self._node.destroy_publisher(publisher)

    @contextmanager
    def replacing(self, progress: Progress | None) -> Iterator[None]:
        """Reports the splats that this thread sends in the block to progress.

        An exception that is no Exception, KeyboardInterrupt say, ends all sending in the block.
        """
        self._call.progress, self._call.replaces = progress, True
        try:
            yield
        finally:
            self._call.progress, self._call.replaces, self._call.ended = None, False, False

    def send(self, batch: PublishedBatch) -> None:
        publisher = self._publisher
        if publisher is None:
            raise RuntimeError(f"{self._topic}: its publisher is closed")
        if self._call.ended:
            raise RuntimeError(f"{self._topic}: sending was ended")
        progress, self._call.progress = self._call.progress, None  # an error of it ends the sending
        try:
            message = self.message(batch)
            publisher.publish(message)
            self.sent_bytes += array_bytes(message)
            if progress and batch.count:
                progress(batch.count)
        except BaseException as error:
            self._call.ended = self._call.replaces and not isinstance(error, Exception)
            raise
        self._call.progress = progress

    @property
    def subscribers(self) -> int:
        """Number of the topic's subscribers."""
        publisher = self._publisher
        return publisher.get_subscription_count() if publisher else 0

    @property
    def rivals(self) -> bool:
        """Whether the topic has other publishers."""
        return bool(self._node.count_publishers(self._topic) > 1)

    def inform(self, text: str) -> None:
        self._node.get_logger().info(f"{self._topic}: {text}")

    def warn(self, text: str) -> None:
        self._node.get_logger().warning(f"{self._topic}: {text}", throttle_duration_sec=5.0)

    def settle(self) -> None:
        """Waits until subscribers have acknowledged all batches, for PATIENCE at most."""
        until = time.monotonic() + PATIENCE
        now = Duration()  # no timeout: rclpy would wait with the interpreter's lock held
        while (publisher := self._publisher) and not publisher.wait_for_all_acked(now):
            if time.monotonic() > until or not self._node.context.ok():
                return
            time.sleep(0.002)

    def message(self, batch: PublishedBatch) -> GaussianArray:
        """The GaussianArray of a batch."""
        if batch.stamp:
            stamp = Time(sec=batch.stamp[0], nanosec=batch.stamp[1])
        else:
            stamp = self._node.get_clock().now().to_msg()
        return as_message(batch, Header(stamp=stamp, frame_id=self.frame_id))


class _Call(threading.local):
    progress: Progress | None = None
    replaces = ended = False


def as_message(batch: PublishedBatch, header: Header) -> GaussianArray:
    """The message of a batch, its arrays filled as blocks of memory."""
    return GaussianArray(
        header=header,
        origin=to_point(batch.origin),
        groups=list(batch.poses),
        poses=[pose_of(pose[:3], pose[3:]) for pose in batch.poses.values()],
        **{
            name: as_array(value.dtype.char, value) if isinstance(value, np.ndarray) else value
            for name, value in ((name, getattr(batch, name)) for name in batch.FIELDS)
        },
    )


def _in_short(slots: NDArray[np.uint32]) -> Slots:
    """Ascending slots, as a range if they have no gap."""
    if not len(slots):
        return range(0)
    first, end = int(slots[0]), int(slots[-1]) + 1
    return range(first, end) if end - first == len(slots) else slots


def _checked(slots: range | ArrayLike) -> range | NDArray[np.uint32]:
    """Slots as PublishedMap takes them; it checks the rest. Raises ValueError."""
    if isinstance(slots, range):
        if slots.step != 1:
            raise ValueError(f"slots: a range must be contiguous, got {slots}")
        ends = (slots[0], slots[-1]) if slots else ()
    else:
        slots = np.asarray(slots)
        if not slots.size:
            return np.zeros(0, np.uint32)  # NumPy makes floats of an empty list
        if slots.ndim != 1 or not np.issubdtype(slots.dtype, np.integer):
            raise ValueError(f"slots: expected (n,) integers, got {slots.shape} {slots.dtype}")
        ends = (slots.min(), slots.max())
    if any(not 0 <= slot < GaussianArray.MAX_SLOTS for slot in ends):
        raise ValueError(f"slots: a slot is a number from 0 to {GaussianArray.MAX_SLOTS - 1}")
    if isinstance(slots, range):
        return slots if slots else range(0)
    return slots.astype(np.uint32)


def _check_splats(splats: Splats | PackedSplats) -> None:
    if not isinstance(splats, PackedSplats):
        check_splats(splats)


def _whole(name: str, number: int, most: int) -> int:
    """A number from 0 to most as an int: messages take only some of NumPy's integers."""
    if not isinstance(number, int | np.integer) or not 0 <= number <= most:
        raise ValueError(f"{name}: a number from 0 to {most}, got {number}")
    return int(number)


def _checked_stamp(stamp: Time | None) -> _Time | None:
    if not isinstance(stamp, Time | None):
        raise TypeError(
            f"stamp: expected a builtin_interfaces Time, as to_msg() makes, got {stamp}"
        )
    return (stamp.sec, stamp.nanosec) if stamp else None
