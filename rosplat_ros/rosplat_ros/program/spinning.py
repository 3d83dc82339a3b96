"""A thread's loop that runs callbacks for as long as a program lives."""

from threading import Event

from rclpy.executors import Executor


def spin_until(executor: Executor, ended: Event) -> None:
    """Runs callbacks until one of them sets an event, or ROS ends.

    rclpy's spin_until_future_complete would keep a function for each callback that it ever ran.
    """
    while executor.context.ok() and not ended.is_set():
        executor.spin_once()
