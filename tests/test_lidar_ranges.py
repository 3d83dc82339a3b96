"""Ranges of a lidar, against the surfaces that generated rooms are made of."""

from __future__ import annotations

import numpy as np
import pytest

from rosplat_core.generated import generate
from rosplat_core.generated.rooms import Rooms
from rosplat_core.rendering import CpuRenderer
from rosplat_lab.reference.room_rays import GLOBE, NOTHING, meet, off_edges
from rosplat_tools.lidars.scanning import Lidar, Pattern

EYE = np.array([-1.2, -1.2, 0.3])  # in the middle room, between its doors [m]
WIDE = 0.05  # about a splat of so many [m]
STEEP = np.radians(60)


def test_ranges_are_those_to_the_surfaces() -> None:
    rooms = Rooms(np.random.default_rng(0))  # of seed 0, as the map
    renderer = CpuRenderer(generate(200_000, scene="rooms"))
    pattern = Pattern.of(16, 512, -np.radians(15), np.radians(15))
    pose = np.eye(4)
    pose[:3, :3] = [[0.8, -0.6, 0], [0.6, 0.8, 0], [0, 0, 1]]
    pose[:3, 3] = EYE
    scan = Lidar(pattern).scan(renderer, np.linalg.inv(pose))
    rays = pattern.rays @ pose[:3, :3].T
    eyes = np.broadcast_to(EYE, rays.shape)
    met = meet(rooms, eyes, rays)
    flat = met.angles < STEEP
    assert flat.mean() > 0.3
    error = np.abs(scan.ranges - met.distances)
    assert np.median(error[flat]) < 0.005
    clear = flat & off_edges(rooms, eyes, rays, met.sides, WIDE)
    assert clear.mean() > 0.2
    assert np.mean(error[clear] < 0.03) > 0.99
    assert scan.intensities.min() > 0
    assert scan.intensities.max() <= 255


def test_the_reference_meets_what_is_there() -> None:
    rooms = Rooms(np.random.default_rng(0))
    lamp = rooms.lamp_centres()[0]
    eyes = np.array([(*lamp[:2], 1.0), (0, 0, 9), (0, 0, 9), (-1.2, -1.2, 0.3)])
    rays = np.array([(0, 0, 1), (0, 0, 1), (1, 0, 0), (0, -1, 0)], np.float64)
    met = meet(rooms, eyes, rays)
    np.testing.assert_array_equal(met.sides[:3], [GLOBE, NOTHING, NOTHING])
    assert met.distances[0] == pytest.approx(lamp[2] - 0.16 - 1)
    assert met.distances[3] == pytest.approx(0.73)  # of the wall's inner side
    np.testing.assert_allclose(met.angles[[0, 3]], 0, atol=1e-6)
