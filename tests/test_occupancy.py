"""Voxels of maps against their float64 twin, and against the rooms that were generated."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from rosplat_core import harmonics
from rosplat_core.generated import generate
from rosplat_core.generated.rooms import Rooms
from rosplat_core.occupancy import OccupancyMap, depth_of
from rosplat_core.quaternions import to_matrices
from rosplat_core.rendering import insert_all
from rosplat_core.splats import Splats
from rosplat_lab.reference import occupancy as reference

RESOLUTION = 0.05  # [m]
ROUNDING = 4e-3  # what packing may move a point by [voxels]


@pytest.fixture(scope="module")
def splats() -> Splats:
    random = np.random.default_rng(8)
    count = 3000
    orientations = random.normal(size=(count, 4))
    scales = 0.1 * np.exp(random.uniform(-4, 0, (count, 3)))
    # None where packing decides on how many points it is spread over.
    steps = 4 * scales / RESOLUTION
    scales[np.abs(steps % 1 - 0.5) < 0.01] *= 1.03
    return Splats(
        positions=random.normal(scale=0.6, size=(count, 3)).astype(np.float32),
        orientations=orientations / np.linalg.norm(orientations, axis=1, keepdims=True),
        scales=scales,
        opacities=random.uniform(0.1, 1, count),
        sh=random.normal(scale=0.8, size=(count, 4, 3)),
        origin=np.array([3.0, -2.0, 1.0]),
    )


@pytest.fixture(scope="module")
def doubtful(splats: Splats) -> NDArray[np.int64]:
    """Keys of the voxels that a point lies at the border of."""
    keys = []
    for _, _, _, places in reference.spread(splats, RESOLUTION):
        near = places[(np.abs(places - np.rint(places)) < ROUNDING).any(axis=1)]
        for corner in np.stack(np.meshgrid(*[(-1, 1)] * 3), axis=-1).reshape(-1, 3):
            cells = np.floor(near + ROUNDING * corner).astype(np.int64)
            keys.append(reference.keys_of(cells))
    return np.unique(np.concatenate(keys))


def test_depths_are_those_of_the_twin(splats: Splats, doubtful: NDArray[np.int64]) -> None:
    voxels = OccupancyMap(RESOLUTION, 1024)
    insert_all(voxels, splats)
    cells, depths = voxels.find(0.0)
    keys = reference.keys_of(cells.astype(np.int64))
    expected_keys, expected = reference.depths(splats, RESOLUTION)
    assert np.array_equal(keys, np.sort(keys))
    np.testing.assert_allclose(depths.sum(axis=0), expected.sum(axis=0), rtol=1e-3)
    sure, theirs = ~np.isin(keys, doubtful), ~np.isin(expected_keys, doubtful)
    assert sure.sum() > 5000
    assert np.array_equal(keys[sure], expected_keys[theirs])
    np.testing.assert_allclose(depths[sure], expected[theirs], rtol=3e-3, atol=2e-4)


def test_surfaces_are_those_of_the_twin(splats: Splats, doubtful: NDArray[np.int64]) -> None:
    voxels = OccupancyMap(RESOLUTION, 1024)
    insert_all(voxels, splats)
    surface = voxels.surface(0.05)
    keys = reference.keys_of(surface["cells"].astype(np.int64))
    # Each splat counts by the area of its largest face.
    shortest = splats.scales.argmin(axis=1)
    normals = to_matrices(splats.orientations)[np.arange(len(splats)), :, shortest]
    scales = np.sort(splats.scales.astype(np.float64), axis=1)
    area = 2 * np.pi * splats.opacities * scales[:, 1] * scales[:, 2] / RESOLUTION**2
    colors = np.clip(0.5 + harmonics.C0 * splats.sh[:, 0], 0, 1)
    products = np.einsum("ni,nj->nij", normals, normals).reshape(-1, 9)
    of = area[:, None] * np.column_stack([np.ones(len(splats)), colors, products])
    expected_keys, sums = reference.sums(splats, RESOLUTION, of)
    places = sum_of_places(splats, area, expected_keys)
    order = np.searchsorted(expected_keys, keys)
    sure = ~np.isin(keys, doubtful) & (sums[order, 0] > 0.02)
    assert sure.sum() > 2000
    order = order[sure]
    whole = sums[order, :1]
    np.testing.assert_allclose(surface["colors"][sure], sums[order, 1:4] / whole, atol=0.02)
    np.testing.assert_allclose(
        surface["positions"][sure], RESOLUTION * places[order] / whole, atol=0.02 * RESOLUTION
    )
    values, vectors = np.linalg.eigh(sums[order, 4:].reshape(-1, 3, 3))
    clear = values[:, 2] > 1.3 * values[:, 1]  # else any direction will do
    cosines = (vectors[:, :, 2] * surface["normals"][sure]).sum(axis=1)
    assert clear.sum() > 1000
    assert (np.abs(cosines[clear]) > 0.99).all()
    np.testing.assert_allclose(np.linalg.norm(surface["normals"], axis=1), 1, atol=1e-5)


def sum_of_places(
    splats: Splats, area: NDArray[np.float64], keys: NDArray[np.int64]
) -> NDArray[np.float64]:
    """(n, 3) of the points in each voxel, by key, times their share of the area. [voxels]"""
    sums = np.zeros((len(keys), 3))
    for splat, key, weight, places in reference.spread(splats, RESOLUTION):
        np.add.at(sums, np.searchsorted(keys, key), (area[splat] * weight)[:, None] * places)
    return sums


@pytest.mark.parametrize("resolution", [0.05, 0.1])
def test_walls_are_found_and_nothing_else(resolution: float) -> None:
    """`bench occupancy` has more of this."""
    voxels = OccupancyMap(resolution, 512)
    insert_all(voxels, generate(100_000, 2, 0, scene="rooms"))
    cells, _ = voxels.find(depth_of(0.5))
    keys = reference.keys_of(cells.astype(np.int64))
    rooms = Rooms(np.random.default_rng(2))
    assert np.isin(keys, reference.truth(rooms, resolution, 1e-3)).mean() > 0.97
    points = reference.surface_points(rooms, 20_000, 0)
    assert reference.met(points, keys, resolution, 1e-3).mean() > 0.97
