"""The other end of a line, for benchmarks: answers each question with an order of a given size.

A program of its own: `python -m rosplat_lab.bench.peer`. A question is a ViewCamera: view_id says
in which of ORDERS, width how many slots. An answer's header has the question's sequence as its
frame_id, and as its stamp the time at which making it began.
"""

from __future__ import annotations

import time

import numpy as np
from builtin_interfaces.msg import Time
from numpy.typing import NDArray
from rclpy.node import Node
from std_msgs.msg import Header

from rosplat_msgs.msg import SplatOrder, ViewCamera
from rosplat_ros.messages import as_array
from rosplat_ros.program.running import run, spinning, wait_for_end
from rosplat_ros.qos import ORDER
from rosplat_sorter.order_slots import PACKED, SHARED, SLOTS, OrderReader, pack
from rosplat_sorter.shared_orders import OrderBuffer, SharedOrders


class Orders:
    """Makes and reads orders in one of the ways in which they travel."""

    def __init__(self, encoding: int) -> None:
        self._encoding = encoding
        self._slots = np.zeros(0, np.uint32)
        self._reader = OrderReader()
        self._buffer: OrderBuffer | None = None

    def make(self, count: int, header: Header) -> SplatOrder:
        """An order of so many slots."""
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


ORDERS = {"inline": Orders(SLOTS), "packed": Orders(PACKED), "shared memory": Orders(SHARED)}

QUESTIONS = "questions"


def topic(kind: str) -> str:
    """The topic of answers of a kind."""
    return kind.replace(" ", "_")


class Peer(Node):
    """Answers on a topic for each kind."""

    def __init__(self) -> None:
        super().__init__("peer")
        self._answers = {
            kind: self.create_publisher(SplatOrder, topic(kind), ORDER) for kind in ORDERS
        }
        self.create_subscription(ViewCamera, QUESTIONS, self._answer, ORDER)

    def _answer(self, question: ViewCamera) -> None:
        seconds, nanoseconds = divmod(time.time_ns(), 10**9)
        stamp = Time(sec=seconds, nanosec=nanoseconds)
        header = Header(stamp=stamp, frame_id=str(question.sequence))
        kind = question.view_id
        self._answers[kind].publish(ORDERS[kind].make(question.width, header))


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
