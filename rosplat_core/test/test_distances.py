"""Distances to a map's surfaces, against those of the boxes and globes that its splats lie on."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from rosplat_core import distances
from rosplat_core.distances import DistanceField
from rosplat_core.generated import generate
from rosplat_core.generated.rooms import LAMP, Rooms
from rosplat_core.generated.surfaces import constant, quaternions, surface
from rosplat_core.splats import InputError, Splats

EDGE = 0.1  # of voxels [m]


def distances_in(rooms: Rooms, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Exact distances of points (n, 3) to what the rooms are made of, below 0 inside. [m]"""
    found = np.full(len(points), np.inf)
    for low, high in rooms.corners():
        beside = np.abs(points - (low + high) / 2) - (high - low) / 2
        outside = np.linalg.norm(np.maximum(beside, 0), axis=1)
        found = np.minimum(found, outside + np.minimum(beside.max(axis=1), 0))
    for centre in rooms.lamp_centres():
        found = np.minimum(found, np.linalg.norm(points - centre, axis=1) - LAMP)
    return found


def ball(radius: float, count: int = 20_000) -> Splats:
    """Splats all over a ball around the origin."""
    z = 1 - 2 * (np.arange(count) + 0.5) / count
    angle = np.pi * (3 - np.sqrt(5)) * np.arange(count)
    ring = np.sqrt(1 - z**2)
    normals = np.column_stack([ring * np.cos(angle), ring * np.sin(angle), z])
    along = np.column_stack([-np.sin(angle), np.cos(angle), 0 * z])
    spacing = np.full(count, radius * np.sqrt(4 * np.pi / count))
    patch = surface(radius * normals, along, normals, spacing, constant(0 * normals + 0.5), 1.2)
    return Splats(
        positions=patch.points,
        orientations=quaternions(patch.tangents, patch.normals),
        scales=patch.scales,
        opacities=patch.opacities,
        sh=patch.sh[:, :1],
    )


def test_distances_in_rooms() -> None:
    rooms = Rooms(np.random.default_rng(0))  # of seed 0, as the map
    corners = rooms.corners()
    random = np.random.default_rng(1)
    points = random.uniform(corners[:, 0].min(axis=0), corners[:, 1].max(axis=0), (5000, 3))
    expected = distances_in(rooms, points)
    outside = expected > 0
    found, gradients = DistanceField.of(generate(100_000, scene="rooms"), resolution=EDGE).at(
        points
    )
    error = np.abs(found - expected)[outside]
    assert np.median(error) < EDGE / 8
    assert np.mean(error < EDGE) > 0.95
    ahead = distances_in(rooms, points + 0.01 * gradients)
    clear = expected > 2 * EDGE
    gained = (ahead - expected)[clear]  # by a step of 10 mm away, but for ridges between surfaces
    assert np.median(gained) > 0.0095
    assert np.mean(gained > 0.008) > 0.8


def test_a_filled_ball_is_negative_within() -> None:
    splats = ball(0.8)
    pose = np.eye(4)
    pose[:3, 3] = [3.0, -2.0, 1.0]
    points = np.random.default_rng(2).uniform(-1.5, 1.5, (3000, 3))
    expected = np.linalg.norm(points, axis=1) - 0.8
    at = points + pose[:3, 3]
    found, _ = DistanceField.of(splats, pose, resolution=0.05, filled=True).at(at)
    assert np.median(np.abs(found - expected)) < 0.01
    assert np.abs(found - expected).max() < 0.06
    hollow, _ = DistanceField.of(splats, pose, resolution=0.05).at(at)
    assert hollow.min() >= 0
    assert np.median(np.abs(hollow - np.abs(expected))) < 0.01


def test_between_voxels_distances_are_interpolated(tmp_path) -> None:
    random = np.random.default_rng(3)
    field = DistanceField(random.normal(size=(5, 6, 7)).astype(np.float32), np.ones(3), 0.5)
    points = 1 + random.uniform(0, 0.5 * np.array([4, 5, 6]), (200, 3))
    found, gradients = field.at(points)
    places = (points - 1) / 0.5
    np.testing.assert_allclose(
        found, map_coordinates(field.distances.astype(float), places.T, order=1), atol=1e-12
    )
    step = 1e-6
    for axis in range(3):
        ahead = field.at(points + step * np.eye(3)[axis])[0]
        slope = (ahead - found) / step
        within = places[:, axis] % 1 < 0.99
        np.testing.assert_allclose(gradients[within, axis], slope[within], atol=1e-5)
    beyond, _ = field.at([[1.0, 1.0, -3.0]])
    assert beyond[0] == pytest.approx(field.distances[0, 0, 0] + 4)
    assert field.holds(points).all()
    assert field.holds([[1, 1, 1], [3, 3.5, 4], [1, 1, -3], [1, 3.6, 1]]).tolist() == [
        True, True, False, False,
    ]  # fmt: skip
    field.save(tmp_path / "field.npz")
    with np.load(tmp_path / "field.npz") as saved:
        np.testing.assert_array_equal(saved["distances"], field.distances)
        np.testing.assert_array_equal(saved["origin"], field.origin)
        assert saved["resolution"] == 0.5


def test_what_has_no_distances_is_said(tmp_path, monkeypatch) -> None:
    splats = ball(0.8)
    with pytest.raises(InputError, match="no surface"):
        DistanceField.of(splats[:0])
    with pytest.raises(InputError, match="voxels along an axis"):
        DistanceField.of(splats, resolution=0.005)
    field = DistanceField.of(splats, resolution=EDGE)
    monkeypatch.setattr(distances, "MOST_VOXELS", field.distances.size - 1)
    with pytest.raises(InputError, match="coarser resolution"):
        DistanceField.of(splats, resolution=EDGE)
    with pytest.raises(ValueError, match="points: expected finite"):
        field.at([[np.nan, 0, 0]])
    with pytest.raises(InputError, match="nowhere"):
        field.save(tmp_path / "nowhere" / "field.npz")
