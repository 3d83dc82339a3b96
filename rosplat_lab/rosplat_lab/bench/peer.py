"""The other end of a line, for benchmarks: answers each question with a message of a given size.

A program of its own: `python -m rosplat_lab.bench.peer`. A question is a ViewCamera: view_id says
what to send, width how much of it. An answer's first header has the question's sequence as its
frame_id, and as its stamp the time at which making it began.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Pose, PoseArray, Quaternion, Vector3
from numpy.typing import NDArray
from rclpy.node import Node
from std_msgs.msg import ColorRGBA, Header

from rosplat_core import payload
from rosplat_core.generated import generate
from rosplat_core.maps import PublishedBatch, PublishedMap
from rosplat_core.splats import Splats
from rosplat_msgs.msg import GaussianArray, SplatOrder, ViewCamera
from rosplat_ros.map_publisher import as_message
from rosplat_ros.messages import NONE, as_array
from rosplat_ros.program.running import run, spinning, wait_for_end
from rosplat_ros.qos import ORDER
from rosplat_sorter.order_slots import PACKED, SHARED, SLOTS, OrderReader, pack
from rosplat_sorter.shared_orders import OrderBuffer, SharedOrders

try:
    from visualization_msgs.msg import Marker, MarkerArray
except ImportError:  # not among the wheels
    MarkerArray = None

ONE_BATCH = 2**40  # a size that no map exceeds [bytes]


class Orders:
    """Makes and reads orders in one of the ways in which they travel."""

    def __init__(self, encoding: int) -> None:
        self._encoding = encoding
        self._slots = np.zeros(0, np.uint32)
        self._reader = OrderReader()
        self._buffer: OrderBuffer | None = None

    def make(self, splats: Splats, header: Header) -> SplatOrder:
        """An order of as many slots as there are splats."""
        count = len(splats)
        if len(self._slots) != count:
            self._slots = np.arange(count, dtype=np.uint32)
        message = SplatOrder(header=header, encoding=self._encoding, count=count)
        if self._encoding == SLOTS:
            message.slots = as_array("I", self._slots)
        elif self._encoding == PACKED:
            message.slot_bits = max(1, (count - 1).bit_length())
            message.packed = pack(self._slots, message.slot_bits)
        else:
            if self._buffer is None:
                self._buffer = OrderBuffer(SharedOrders())
            self._buffer.begin(count)[:] = self._slots
            message.segment, message.generation = self._buffer.finish()
        return message

    def read(self, message: SplatOrder) -> NDArray[np.uint32]:
        """The slots of an order."""
        return self._reader.read(message)

    def close(self) -> None:
        """Takes shared memory away."""
        if self._buffer:
            self._buffer.close()


def make_batch(splats: Splats, header: Header) -> GaussianArray:
    """All of the splats, as a map's publisher sends them: 59 numbers each with three bands of
    harmonics, packed."""
    batches: list[PublishedBatch] = []
    published = PublishedMap(ONE_BATCH, NONE, batches.append, print, lambda: None)
    published.replace(splats, None, None)
    return as_message(batches[0], header)


def read_batch(message: GaussianArray) -> list[NDArray[np.float32]]:
    rows = np.frombuffer(message.payload, np.uint8)
    arrays = payload.decode(rows, message.count, message.sh_degree, message.format)
    return list(vars(arrays).values())


def make_poses(splats: Splats, header: Header) -> PoseArray:
    """A message for each splat within one: position and orientation, 7 of the 59 numbers."""
    message = PoseArray(header=header)
    rows = zip(splats.positions.tolist(), splats.orientations.tolist(), strict=True)
    for (x, y, z), (qx, qy, qz, qw) in rows:
        message.poses.append(
            Pose(position=Point(x=x, y=y, z=z), orientation=Quaternion(x=qx, y=qy, z=qz, w=qw))
        )
    return message


def read_poses(message: PoseArray) -> NDArray[np.float32]:
    return np.array(
        [
            (p.position.x, p.position.y, p.position.z,
             p.orientation.x, p.orientation.y, p.orientation.z, p.orientation.w)
            for p in message.poses
        ],
        np.float32,
    )  # fmt: skip


def make_markers(splats: Splats, header: Header) -> Any:
    """What rviz draws without a plugin: an ellipsoid for each splat, without harmonics."""
    message = MarkerArray()
    rows = zip(
        splats.positions.tolist(), splats.orientations.tolist(), splats.scales.tolist(),
        splats.opacities.tolist(), splats.sh[:, 0].tolist(), strict=True,
    )  # fmt: skip
    for number, ((x, y, z), (qx, qy, qz, qw), (sx, sy, sz), opacity, (r, g, b)) in enumerate(rows):
        marker = Marker(
            header=header, id=number, type=Marker.SPHERE,
            pose=Pose(
                position=Point(x=x, y=y, z=z), orientation=Quaternion(x=qx, y=qy, z=qz, w=qw)
            ),
            scale=Vector3(x=sx, y=sy, z=sz), color=ColorRGBA(r=r, g=g, b=b, a=opacity),
        )  # fmt: skip
        message.markers.append(marker)
    return message


def read_markers(message: Any) -> NDArray[np.float32]:
    return np.array(
        [
            (
                m.pose.position.x, m.pose.position.y, m.pose.position.z,
                m.pose.orientation.x, m.pose.orientation.y, m.pose.orientation.z,
                m.pose.orientation.w, m.scale.x, m.scale.y, m.scale.z,
                m.color.r, m.color.g, m.color.b, m.color.a,
            )
            for m in message.markers
        ],
        np.float32,
    )  # fmt: skip


ORDERS = {"inline": Orders(SLOTS), "packed": Orders(PACKED), "shared memory": Orders(SHARED)}

# What is sent, by name: message, how it is made, how its numbers are taken out again.
KINDS: dict[str, tuple[Any, Callable[..., Any], Callable[..., Any]]] = {
    **{kind: (SplatOrder, orders.make, orders.read) for kind, orders in ORDERS.items()},
    "gaussians": (GaussianArray, make_batch, read_batch),
    "poses": (PoseArray, make_poses, read_poses),
}
if MarkerArray is not None:
    KINDS["markers"] = (MarkerArray, make_markers, read_markers)

QUESTIONS = "questions"


def topic(kind: str) -> str:
    """The topic of answers of a kind."""
    return kind.replace(" ", "_")


class Peer(Node):
    """Answers on a topic for each kind."""

    def __init__(self) -> None:
        super().__init__("peer")
        self._splats = generate(1)
        self._answers = {
            kind: self.create_publisher(message, topic(kind), ORDER)
            for kind, (message, _, _) in KINDS.items()
        }
        self.create_subscription(ViewCamera, QUESTIONS, self._answer, ORDER)

    def _answer(self, question: ViewCamera) -> None:
        if len(self._splats) != question.width:
            small = question.view_id in ORDERS  # whose splats are only counted
            made = generate(min(question.width, 1000) if small else question.width)
            self._splats = made[np.resize(np.arange(len(made)), question.width)] if small else made
        seconds, nanoseconds = divmod(time.time_ns(), 10**9)
        stamp = Time(sec=seconds, nanosec=nanoseconds)
        header = Header(stamp=stamp, frame_id=str(question.sequence))
        _, make, _ = KINDS[question.view_id]
        self._answers[question.view_id].publish(make(self._splats, header))


def main() -> None:
    """Answers until it is told to end."""
    run("peer", _serve)


def _serve() -> None:
    node = Peer()
    try:
        with spinning(node):
            wait_for_end(node)
    finally:
        for orders in ORDERS.values():
            orders.close()


if __name__ == "__main__":
    main()
