"""A map that is received and drawn in one process, without a screen."""

from __future__ import annotations

import uuid
from collections.abc import Sequence

from rclpy.node import Node
from std_msgs.msg import Header

from rosplat_core.cameras import Camera
from rosplat_core.rendering import CpuRenderer
from rosplat_msgs.msg import ViewCamera
from rosplat_ros.held_map import MapSubscriber
from rosplat_ros.qos import VIEW, overridable
from rosplat_ros.view_cameras import view_camera


class DrawnMap(MapSubscriber):
    """A map in a renderer. The same thread takes turns and draws."""

    def __init__(self, node: Node) -> None:
        self.renderer = CpuRenderer()
        super().__init__(node, self.renderer)
        self._views = node.create_publisher(ViewCamera, f"{self.topic}/view", **overridable(VIEW))
        self._instance = f"{node.get_name()}_{uuid.uuid4().hex[:8]}"

    @property
    def frame_id(self) -> str:
        """The map's frame."""
        return self.header.frame_id

    def publish_cameras(self, name: str, cameras: Sequence[Camera]) -> None:
        """Tells a publisher that streams its map of the cameras that take a picture.

        name: tells several pictures of a node apart.
        """
        header = Header(stamp=self._node.get_clock().now().to_msg(), frame_id=self.frame_id)
        for number, camera in enumerate(cameras):
            message = view_camera(camera)
            message.header = header
            message.view_id = f"{self._instance}/{name}{number}"
            self._views.publish(message)

    def problem(self) -> str:
        """Why a picture would not show the whole map; empty if it would."""
        empty = "" if self.books.splats else f"{self.topic}: the map is empty"
        return super().problem() or empty
