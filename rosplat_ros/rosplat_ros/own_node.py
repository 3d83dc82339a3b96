"""A node in a participant of its own."""

from __future__ import annotations

import atexit
from contextlib import suppress
from threading import Thread

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node


def node_of_its_own(node: Node) -> Node:
    """A node that joins the network beside a node, and ends with the node's ROS, or the program. A
    thread of its own runs its callbacks.
    """
    context = rclpy.Context()
    rclpy.init(args=[], context=context, domain_id=node.context.get_domain_id())
    own = rclpy.create_node(
        f"{node.get_name()}_anew",
        namespace=node.get_namespace(),
        context=context,
        use_global_arguments=False,
        start_parameter_services=False,
    )
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(own)

    def spin() -> None:
        with suppress(ExternalShutdownException):
            while node.context.ok():
                executor.spin_once(0.1)
        executor.shutdown()
        own.destroy_node()
        context.try_shutdown()

    thread = Thread(target=spin, daemon=True)
    thread.start()

    def end() -> None:
        context.try_shutdown()
        thread.join()

    atexit.register(end)  # a thread that is in ROS as Python ends aborts the process
    return own
