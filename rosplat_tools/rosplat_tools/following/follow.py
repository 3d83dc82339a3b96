"""Publishes maps that other programs write: a file, again and again, or their messages.

Parameter `path`: a scene file, or a pattern, whose newest match is read. A file that is still being
written is read when it is whole.
Topics, each where its message's package is installed:
  cloud                       sensor_msgs/PointCloud2, with a PLY's properties for fields
  gaussian_model              gaussian_interface/GaussianArray
  gaussian_splats             gaussian_splatting_msgs/GaussianSplats
  splat_array                 gsplat_msgs/SplatArray
  gaussian_splat_tile_chunks  gsplat_msgs/SplatTileChunk
  gaussian_splat_blob_chunks  gsplat_msgs/SplatBlobChunk
"""

from __future__ import annotations

import time
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import QoSProfile

from rosplat_core.log_text import shown
from rosplat_core.scenes import load_scene
from rosplat_core.splats import InputError, Splats
from rosplat_ros.map_publisher import MapPublisher
from rosplat_ros.messages import plain_frame
from rosplat_ros.program.parameters import declare, declare_compression, declare_path
from rosplat_ros.program.running import Cancelled, run_node
from rosplat_tools.following.watched_file import WatchedFile
from rosplat_tools.following.whole_maps import WholeMaps
from rosplat_tools.foreign import TYPES, Foreign, MapReader, foreign, message_of
from rosplat_tools.latched import LatchedSubscription

SHOWING = 0.1  # least time between two looks for maps to be shown [s]
REST = 2.0  # a map that takes a second to be shown is shown again so many seconds later
WATCH = 1.0  # time between two looks for topics of other names [s]


class Follow(Node):
    """Publishes on `gaussians` the map that it heard or read last."""

    def __init__(self) -> None:
        super().__init__("follow")
        path = declare_path(
            self, "path", "", "Scene file to follow, or a pattern: its newest match is read."
        )
        period = declare(self, "period", 0.5, "Time between two looks at the file. [s]", 0.05, 60.0)
        frame_id = declare(self, "frame_id", "", "Frame of the map; empty: the message's, or map.")
        self._frame_id = plain_frame(frame_id)
        self._publisher = MapPublisher(
            self, frame_id=self._frame_id or "map", compression=declare_compression(self)
        )
        self._maps = WholeMaps(self._publisher)
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)  # simulated time may stand still
        if path:
            self._file = WatchedFile(path)
            self.create_timer(period, self._check_file, clock=self._steady)
            doing = "following" if self._file.is_there() else "waiting for"
            self.get_logger().info(f"{doing} {shown(path)}")
        else:
            cloud = self.resolve_topic_name("cloud")
            self.get_logger().info(f"no path is given: waiting for {cloud}, or another topic")
        self._heard: dict[str, MapReader] = {}  # by topic, whose map is to be shown
        self._rests_until = 0.0  # of time.monotonic() [s]
        self._hears: dict[str, tuple[str, LatchedSubscription]] = {}  # with the type
        self._unreadable: dict[str, str] = {}  # types, and why; empty once that is said
        self._is_waiting = True
        kinds = list(map(foreign, TYPES))
        for kind in kinds:
            self._subscribe(kind, self.resolve_topic_name(kind.TOPIC))
        self._kinds = {kind.TYPE: kind for kind in kinds[1:]}  # most clouds are no maps
        self.create_timer(SHOWING, self._show_heard, clock=self._steady)
        self.create_timer(WATCH, self._look_for_topics, clock=self._steady)

    def _subscribe(self, kind: Foreign, topic: str) -> None:
        """Hears a foreign type, in place of another that was expected on this topic."""
        try:
            message = message_of(kind)
        except InputError as error:
            self._unreadable[kind.TYPE] = str(error)
            return
        reader = kind.Reader(topic, self.get_logger().warning)

        def on_message(message: Any) -> None:
            self._is_waiting = False
            try:
                if reader.add(message):
                    self._heard[topic] = reader
            except InputError as error:
                self._refuse(error)

        if topic in self._hears:
            self._hears.pop(topic)[1].close()
        profile = QoSProfile(depth=kind.DEPTH)
        heard = LatchedSubscription(self, message, topic, on_message, profile)
        self._hears[topic] = kind.TYPE, heard

    def _look_for_topics(self) -> None:
        """While nothing is heard, hears a topic of another name. Says once what can't be read."""
        namespace = self.get_namespace().rstrip("/") + "/"
        for topic, types in self.get_topic_names_and_types():
            if not topic.startswith(namespace) or self._kinds.keys().isdisjoint(types):
                continue
            for publisher in self.get_publishers_info_by_topic(topic):
                kind = self._kinds.get(publisher.topic_type)
                if kind is None:
                    continue
                if (why := self._unreadable.get(kind.TYPE)) is not None:
                    if why:
                        self.get_logger().warning(f"{topic}: not heard: {why}")
                    self._unreadable[kind.TYPE] = ""
                elif self._is_waiting and self._hears.get(topic, ("",))[0] != kind.TYPE:
                    self.get_logger().info(f"hearing {topic}, which is of {kind.TYPE}")
                    self._subscribe(kind, topic)

    def _check_file(self) -> None:
        version = self._file.poll()
        if version is None:
            return
        try:
            splats = load_scene(str(version.path), self._raise_if_ended, self.get_logger().warning)
        except InputError as error:
            self._refuse(error)  # a file that is being written isn't whole
            return
        if self._file.is_still(version):
            self._show(splats, "", str(version.path))

    def _raise_if_ended(self, _: float) -> None:
        if not self.context.ok():
            raise Cancelled

    def _show_heard(self) -> None:
        """Shows maps that messages made. One that many messages make is not shown after each."""
        began = time.monotonic()
        if not self._heard or began < self._rests_until:
            return
        heard, self._heard = self._heard, {}
        for name, reader in heard.items():
            try:
                self._show(reader.splats(), reader.frame_id, name)
            except (ValueError, MemoryError) as error:
                self._refuse(f"{name}: {error or 'too large for this machine'}")
        self._rests_until = time.monotonic() + REST * (time.monotonic() - began)

    def _show(self, splats: Splats, frame_id: str, source: str) -> None:
        before = self._publisher.frame_id
        self._publisher.frame_id = self._frame_id or frame_id or "map"
        try:
            sent = self._maps.show(splats)
        except (ValueError, MemoryError) as error:
            self._publisher.frame_id = before
            self._refuse(f"{source}: {error or 'too large for this machine'}")
            return
        self.get_logger().info(f"{shown(source)}: {len(splats):,} splats, {sent:,} of them sent")

    def _refuse(self, why: object) -> None:
        self.get_logger().warning(
            f"the map stays: {shown(str(why), 500)}", throttle_duration_sec=1.0
        )


def main() -> None:
    run_node("follow", Follow)
