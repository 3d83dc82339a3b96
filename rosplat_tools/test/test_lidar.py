"""Lidars in generated rooms, and the program. tests/test_lidar_ranges.py has how exact they are."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from point_cloud import points_of
from rclpy.node import Node
from sensor_msgs.msg import LaserScan, PointCloud2

from rosplat_core.generated import generate
from rosplat_core.rendering import CpuRenderer
from rosplat_core.splats import Splats
from rosplat_ros.map_publisher import MapPublisher
from rosplat_testing import Listener
from rosplat_testing.studio import Studio
from rosplat_tools.lidars.scanning import Lidar, Pattern

ROOMS = generate(200_000, scene="rooms")
EYE = np.array([-1.2, -1.2, 0.3])  # in the middle room, between its doors [m]


@pytest.fixture(scope="module")
def renderer() -> CpuRenderer:
    return CpuRenderer(ROOMS)


def test_what_is_not_there_answers_nothing(renderer: CpuRenderer) -> None:
    """Nor does what is too near, or too far; rooms have no ceiling."""
    straight_up = Pattern.of(4, 8, np.radians(80), np.radians(90))
    pose = np.eye(4)
    pose[:3, 3] = -EYE
    scan = Lidar(straight_up).scan(renderer, pose)
    assert np.isinf(scan.ranges).all()
    assert not scan.intensities.any()
    level = Pattern.of(1, 64, 0, 0)
    whole = Lidar(level).scan(renderer, pose).ranges
    short = Lidar(level, 0.8, 1.5).scan(renderer, pose).ranges
    inside = (whole >= 0.8) & (whole <= 1.5)
    assert 0 < inside.sum() < 64
    np.testing.assert_array_equal(short[inside], whole[inside])
    assert np.isinf(short[~inside]).all()


@pytest.mark.parametrize("opacity", [0.3, 0.6])
def test_what_lets_half_of_the_light_through_answers_nothing(opacity: float) -> None:
    veil = Splats(
        positions=np.array([[2, 0, 0]], np.float32),
        orientations=np.array([[0, 0, 0, 1]], np.float32),
        scales=np.array([[0.001, 1, 1]], np.float32),
        opacities=np.array([opacity], np.float32),
        sh=np.zeros((1, 1, 3), np.float32),
    )
    ahead = Pattern.of(1, 1, 0, 0, 0.1)
    scan = Lidar(ahead).scan(CpuRenderer(veil), np.eye(4))
    if opacity < 0.5:
        assert np.isinf(scan.ranges).all()
    else:
        assert scan.ranges[0] == pytest.approx(2, abs=1e-3)


def test_a_scan_leaves_the_renderer_as_it_was(renderer: CpuRenderer) -> None:
    before = renderer.settings.model
    Lidar(Pattern.of(2, 16, -0.1, 0.1)).scan(renderer, np.eye(4))
    assert renderer.settings.model == before


def test_a_solid_state_lidar_looks_ahead_alone() -> None:
    rays = Pattern.of(5, 40, -0.2, 0.2, np.radians(70)).rays
    assert rays.shape == (200, 3)
    np.testing.assert_allclose(np.linalg.norm(rays, axis=1), 1)
    azimuths = np.arctan2(rays[:, 1], rays[:, 0])
    assert np.abs(azimuths).max() < np.radians(35)
    np.testing.assert_allclose(np.sort(azimuths), -np.sort(azimuths)[::-1], atol=1e-12)


def test_the_program_measures_where_the_pose_is(
    node: Node, listener: Listener, start: Callable[..., subprocess.Popen[str]]
) -> None:
    publisher = MapPublisher(node)
    publisher.replace(ROOMS)
    studio = Studio(node, listener, "lidar")
    heard: dict[str, list[Any]] = {"points": [], "scan": []}
    for kind, (topic, messages) in zip((PointCloud2, LaserScan), heard.items(), strict=True):
        node.create_subscription(kind, topic, messages.append, 10)
    start("lidar", poses="topic", rings=8, columns=128, lowest=-10.0, highest=10.0)
    pose = np.eye(4)
    pose[:3, 3] = EYE
    studio.pose(np.linalg.inv(pose))
    listener.wait(lambda: all(heard.values()))
    pattern = Pattern.of(8, 128, -np.radians(10), np.radians(10))
    expected = Lidar(pattern, 0.1, 100).scan(CpuRenderer(ROOMS), np.linalg.inv(pose))
    cloud = heard["points"][0]
    assert cloud.header.frame_id == "lidar"
    points = points_of(cloud)
    answers = np.isfinite(expected.ranges)
    where = pattern.rays[answers] * expected.ranges[answers, None]
    np.testing.assert_allclose(np.column_stack([points[axis] for axis in "xyz"]), where, atol=1e-5)
    np.testing.assert_array_equal(points["ring"], np.tile(np.arange(8), 128)[answers])
    assert (np.diff(points["time"]) >= 0).all()
    scan = heard["scan"][0]
    assert (len(scan.ranges), scan.scan_time) == (128, pytest.approx(0.1))
    bearing = scan.angle_min + scan.angle_increment * np.arange(128)
    np.testing.assert_allclose(bearing, pattern.azimuths, atol=1e-5)
    assert np.isfinite(scan.ranges).mean() > 0.9


def test_there_are_no_more_scans_than_the_rate(
    node: Node, listener: Listener, start: Callable[..., subprocess.Popen[str]]
) -> None:
    publisher = MapPublisher(node)
    publisher.replace(ROOMS[::100])
    studio, scans = Studio(node, listener, "lidar"), list[LaserScan]()
    node.create_subscription(LaserScan, "scan", scans.append, 10)
    start("lidar", poses="topic", rings=1, columns=8, rate=1.0, farthest=10.0)
    for tenths, due in ((100, 1), (108, 2), (116, 2), (124, 3), (130, 3)):
        studio.pose(np.eye(4), tenths // 10, nanosec=tenths % 10 * 10**8)
        listener.wait(lambda due=due: len(scans) >= due)
        for _ in range(20):
            listener.spin_once()  # while the lidar takes what is on its way
    stamps = [scan.header.stamp.sec + 1e-9 * scan.header.stamp.nanosec for scan in scans]
    assert stamps == pytest.approx([10, 10.8, 12.4])


def test_parameters_that_are_no_lidar_are_named(refusal: Callable[..., str]) -> None:
    said = refusal("lidar", poses="topic", lowest=20.0, highest=10.0)
    assert "parameters lowest, highest, nearest, farthest: 20, 10, 0.1, 100 are no ranges" in said
