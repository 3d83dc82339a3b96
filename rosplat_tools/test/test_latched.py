"""What was published once, before a subscription began."""

import time
from collections.abc import Callable
from functools import partial

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from sensor_msgs.msg import CameraInfo

from rosplat_testing import Listener
from rosplat_tools.latched import WATCH_PERIOD, LatchedSubscription

PLAIN = QoSProfile(depth=1)
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def test_it_is_heard_and_so_is_a_volatile_publisher_beside(node: Node, listener: Listener) -> None:
    heard: list[int] = []

    def hear(info: CameraInfo) -> None:
        heard.append(info.width)

    def comes(width: int, publish: Callable[[], None] = lambda: None) -> bool:
        publish()
        return heard[-1:] == [width]

    latched = node.create_publisher(CameraInfo, "info", LATCHED)
    latched.publish(CameraInfo(width=1))
    LatchedSubscription(node, CameraInfo, "info", hear, qos_profile_sensor_data)
    listener.wait(partial(comes, 1))
    volatile = node.create_publisher(CameraInfo, "info", 1)
    listener.wait(partial(comes, 2, lambda: volatile.publish(CameraInfo(width=2))))
    latched.publish(CameraInfo(width=3))
    listener.wait(partial(comes, 3))


def test_nothing_is_heard_twice(node: Node, listener: Listener) -> None:
    heard: list[int] = []
    LatchedSubscription(
        node, CameraInfo, "info", lambda info: heard.append(info.width), qos_profile_sensor_data
    )
    latched = node.create_publisher(CameraInfo, "info", LATCHED)
    listener.wait(latched.get_subscription_count)
    latched.publish(CameraInfo(width=1))
    listener.wait(lambda: heard)
    volatile = node.create_publisher(CameraInfo, "info", 1)

    def newer() -> bool:
        volatile.publish(CameraInfo(width=2))
        return heard[-1] == 2

    listener.wait(newer)
    node.destroy_publisher(volatile)
    until = time.monotonic() + 2 * WATCH_PERIOD
    listener.wait(lambda: time.monotonic() > until)
    assert (heard.count(1), heard[-1]) == (1, 2)


def test_a_best_effort_publisher_is_heard_beside_a_reliable_one(
    node: Node, listener: Listener
) -> None:
    heard: list[int] = []
    LatchedSubscription(node, CameraInfo, "info", lambda info: heard.append(info.width), PLAIN)
    publishers = [
        node.create_publisher(CameraInfo, "info", qos) for qos in (qos_profile_sensor_data, 1)
    ]

    def comes(width: int) -> bool:
        publishers[width].publish(CameraInfo(width=width))
        return width in heard

    listener.wait(lambda: comes(0))
    listener.wait(lambda: comes(1))
