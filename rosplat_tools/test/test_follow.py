"""The node that follows what others write and send."""

import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rclpy
from core_fixtures import random_splats
from point_cloud import cloud
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import String

from rosplat_core import formats
from rosplat_msgs.srv import PullMap
from rosplat_ros.program.running import spinning
from rosplat_tools.following.follow import Follow
from rosplat_tools.foreign import MapReader, gaussian_splats, splat_array

Start = Callable[..., subprocess.Popen[str]]


def test_a_file_is_shown_each_time_it_was_written(
    start: Start, listener: Any, tmp_path: Path
) -> None:
    path = tmp_path / "map.ply"
    path.write_bytes(b"ply\nformat binary_little_endian 1.0\n")  # its trainer has just begun
    start("follow", path=path, period=0.05)
    for count in (500, 800):
        splats = random_splats(count, 1, seed=count)
        formats.save(path, splats, overwrite=True)
        listener.wait_for(count)
        _, shown = listener.map.snapshot()
        np.testing.assert_allclose(np.sort(shown.opacities), np.sort(splats.opacities), atol=1e-5)


def test_a_file_is_followed_where_simulated_time_stands_still(
    start: Start, listener: Any, tmp_path: Path
) -> None:
    path = tmp_path / "map.ply"
    process = start("follow", path=path, period=0.05, use_sim_time=True)
    assert process.stdout
    assert f"waiting for {path}" in process.stdout.readline()
    formats.save(path, random_splats(50, 1))
    listener.wait_for(50)
    assert "50 of them sent" in process.stdout.readline()
    assert "use_sim_time is true, but nobody publishes /clock" in process.stdout.readline()


def test_a_cloud_is_shown_in_its_frame(start: Start, listener: Any, node: Node) -> None:
    start("follow")
    publisher = node.create_publisher(PointCloud2, "cloud", 1)
    message = cloud(random_splats(300, 0))
    message.header.frame_id = "camera_init"
    listener.wait(publisher.get_subscription_count)
    publisher.publish(message)
    listener.wait_for(300)
    assert listener.batches[-1].header.frame_id == "camera_init"
    message.header.frame_id = "odom"  # the same splats elsewhere
    publisher.publish(message)
    listener.wait(lambda: listener.batches[-1].header.frame_id == "odom")
    assert not listener.batches[-1].count


def test_a_cloud_that_was_published_once_is_shown(start: Start, listener: Any, node: Node) -> None:
    """By a latched publisher; a volatile one that comes later is heard, too."""
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    publisher = node.create_publisher(PointCloud2, "cloud", latched)
    publisher.publish(cloud(random_splats(300, 0)))
    start("follow")
    listener.wait_for(300)
    volatile = node.create_publisher(PointCloud2, "cloud", 1)
    listener.wait(volatile.get_subscription_count)
    volatile.publish(cloud(random_splats(200, 0)))
    listener.wait_for(200)


def test_a_cloud_that_is_refused_moves_nothing(start: Start, listener: Any, node: Node) -> None:
    process = start("follow")
    publisher = node.create_publisher(PointCloud2, "cloud", 1)
    message = cloud(random_splats(300, 0))
    message.header.frame_id = "camera_init"
    listener.wait(publisher.get_subscription_count)
    publisher.publish(message)
    listener.wait_for(300)
    message.header.frame_id = "odom"
    message.data = message.data[:-1]
    publisher.publish(message)
    assert process.stdout
    assert any("the map stays" in line for line in process.stdout)
    answer = listener.call(PullMap, "gaussians/pull", map_id=listener.batches[-1].map_id)
    assert {batch.header.frame_id for batch in answer.batches} == {"camera_init"}


class Word(MapReader):
    """Says what it hears."""

    def add(self, message: String) -> bool:
        self._splats = random_splats(len(message.data), 0)
        return True


def test_a_known_type_is_heard_on_any_topic(
    monkeypatch: pytest.MonkeyPatch, node: Node, listener: Any
) -> None:
    """Even on one on which another type was expected."""
    for module, kind in ((splat_array, "String"), (gaussian_splats, "Header")):
        monkeypatch.setattr(module, "TYPE", f"std_msgs/msg/{kind}")
        monkeypatch.setattr(module, "FIELDS", ())
        monkeypatch.setattr(module, "Reader", Word)
    rclpy.init(args=["--ros-args", "-r", f"__ns:={node.get_namespace()}"])
    try:
        with spinning(Follow()):
            publisher = node.create_publisher(String, "gaussian_splats", 1)
            listener.wait(publisher.get_subscription_count)
            publisher.publish(String(data="heard"))
            listener.wait_for(5)
    finally:
        rclpy.try_shutdown()
