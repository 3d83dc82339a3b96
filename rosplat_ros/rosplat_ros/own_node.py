"""A node in a participant of its own."""

from __future__ import annotations

from threading import Thread

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node


def node_of_its_own(node: Node) -> Node:
    """A node that joins the network beside a node, and ends with the node's ROS. A thread of its
    own runs its callbacks.
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
    node.context.on_shutdown(context.try_shutdown)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(own)

    def spin() -> None:
        try:
            executor.spin()
        except ExternalShutdownException:
            pass
        finally:
            executor.shutdown()
            own.destroy_node()

    Thread(target=spin, daemon=True).start()
    return own
