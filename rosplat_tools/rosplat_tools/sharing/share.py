"""Publishes the map of `gaussians` for the programs of others, in their messages, or in Rerun.

Parameter `as`: point_cloud, gaussian_array, gaussian_splats, splat_array, splat_tiles, splat_blob,
or rerun. A type's topic is the one that its own programs use; remapping gives it another name. A
map that changes is published again, whole.
"""

from __future__ import annotations

import time
from typing import Any

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import Header

from rosplat_core.log_text import shown
from rosplat_core.rendering import CpuRenderer
from rosplat_ros.held_map import MapSubscriber
from rosplat_ros.program.parameters import declare
from rosplat_ros.program.running import run_node
from rosplat_tools.foreign import TYPES, foreign, message_of
from rosplat_tools.sharing.rerun_log import RerunLog

RERUN = "rerun"


class Share(Node):
    """Hears `gaussians`, and publishes it as another type."""

    def __init__(self) -> None:
        super().__init__("share")
        form = declare(self, "as", "point_cloud", "The type", choices=(*TYPES, RERUN))
        self._period = declare(
            self, "period", 1.0, "Least time between two publications. [s]", 0.05, 3600.0
        )
        address = declare(
            self, "rerun", "", "Address of a Rerun viewer, rerun+http://...; empty: starts one."
        )
        if form == RERUN:
            self._log = RerunLog(address)
            self._publisher = None
        else:
            self._kind = foreign(form)
            self._message = message_of(self._kind)
            kept = DurabilityPolicy.TRANSIENT_LOCAL
            self._publisher = self.create_publisher(
                self._message, self._kind.TOPIC, QoSProfile(depth=self._kind.DEPTH, durability=kept)
            )
        self._renderer = CpuRenderer()
        self._map = MapSubscriber(self, self._renderer)

    def work(self) -> None:
        """Publishes whenever the map has changed and is whole, until ROS ends."""
        shared = 0  # edits of the map that was published last
        for _ in self._map.turns(0.1):
            if self._map.edits != shared and not self._map.problem():
                shared = self._map.edits
                self._publish()
                self._wait()

    def _wait(self) -> None:
        end = time.monotonic() + self._period
        while self.context.ok() and (left := end - time.monotonic()) > 0:
            time.sleep(min(left, 0.1))

    def _publish(self) -> None:
        _, splats = self._renderer.snapshot()
        header: Header = self._map.header
        if self._publisher is None:
            self._log.log(splats, header)
            where = RERUN
        else:
            messages: Any = self._kind.messages(self._message, splats, header)
            for message in messages:
                self._publisher.publish(message)
            where = self._publisher.topic_name
        self.get_logger().info(f"{shown(where)}: {len(splats):,} splats")


def main() -> None:
    run_node("share", Share, Share.work)
