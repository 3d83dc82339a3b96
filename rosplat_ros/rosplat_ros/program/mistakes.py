"""Mistakes that ROS is silent about: unknown parameters, topics of another type, no /clock."""

from __future__ import annotations

from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.node import Node

PERIOD = 5.0  # [s]


class Mistakes:
    """Finds mistakes of the user who starts a node, and logs each once.

    Make it when the node has declared all of its parameters: Mistakes(node).
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._said: set[str] = set()
        self._find_unknown_parameters()
        steady = Clock(clock_type=ClockType.STEADY_TIME)  # simulated time may stand still
        self._timer = node.create_timer(PERIOD, self._on_timer, clock=steady)

    def _warn_once(self, text: str) -> None:
        if text not in self._said:
            self._said.add(text)
            self._node.get_logger().warning(text)

    def _find_unknown_parameters(self) -> None:
        known = self._node.get_parameters_by_prefix("")
        ours = sorted(name for name in known if not name.startswith(("qos_", "start_type_")))
        for name in self._node._parameter_overrides:  # no public function has them
            # QoS overrides are declared with their publisher or subscription, maybe later.
            if name not in known and not name.startswith("qos_overrides."):
                self._warn_once(
                    f"parameter {name}: not known, ignored; known are {', '.join(ours)}"
                )

    def _on_timer(self) -> None:
        try:
            if not self._node.get_clock().now().nanoseconds:
                self._warn_once("use_sim_time is true, but nobody publishes /clock")
            for subscription in list(self._node.subscriptions):
                self._find_other_types(subscription.topic_name, type_name(subscription.msg_type))
        except Exception:  # RCLError and InvalidHandle
            if self._node.context.ok():  # else ROS has ended meanwhile
                raise

    def _find_other_types(self, topic: str, wanted: str) -> None:
        for publisher in self._node.get_publishers_info_by_topic(topic):
            if publisher.topic_type != wanted:
                self._warn_once(
                    f"{topic}: somebody publishes {publisher.topic_type}, which isn't heard; "
                    f"expected {wanted}"
                )


def type_name(message: Any) -> str:
    """The name of a message's class as ROS writes it: std_msgs/msg/String."""
    package, kind, *_ = message.__module__.split(".")
    return f"{package}/{kind}/{message.__name__}"
