"""Merging of neighbours, against moments and errors worked out otherwise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from rosplat_lab.reference.projection import rotation_matrices
from rosplat_lab.simplify.merging import MOST, Pairs, areas, find_pairs, merge
from rosplat_tools.splats import Splats

Make = Callable[..., Splats]


def covariances(splats: Splats) -> np.ndarray:
    axes = rotation_matrices(splats.orientations.astype(float)) * splats.scales[:, None, :]
    return axes @ axes.transpose(0, 2, 1)


def all_pairs(splats: Splats, count: int) -> Pairs:
    """Splats 0 and 1, 2 and 3, and so on."""
    return Pairs(np.arange(0, 2 * count, 2), np.arange(1, 2 * count, 2))


def test_a_merged_splat_has_the_moments_of_the_two(random_splats: Make) -> None:
    splats = random_splats(40)
    weights = np.random.default_rng(1).uniform(1, 9, 40)
    merged, sums = merge(splats, weights, all_pairs(splats, 20), 20)
    share = (weights / np.repeat(sums, 2)).reshape(-1, 2)
    means = splats.positions.reshape(-1, 2, 3)
    expected = np.einsum("pi,pik->pk", share, means)
    np.testing.assert_allclose(merged.positions, expected, atol=1e-5)
    offsets = means - expected[:, None]
    spread = covariances(splats).reshape(-1, 2, 3, 3) + offsets[..., None] * offsets[..., None, :]
    expected = np.einsum("pi,pikl->pkl", share, spread)
    np.testing.assert_allclose(covariances(merged), expected, atol=1e-4)
    colours = np.einsum("pi,pikc->pkc", share, splats.sh.reshape(20, 2, *splats.sh.shape[1:]))
    np.testing.assert_allclose(merged.sh, colours, atol=1e-5)
    assert sums.sum() == pytest.approx(weights.sum())


def test_merging_keeps_what_splats_cover(random_splats: Make) -> None:
    splats = replace(random_splats(40), opacities=np.full(40, 0.2))
    merged, _ = merge(splats, np.ones(40), all_pairs(splats, 20), 20)
    covered = (splats.opacities * areas(splats)).reshape(-1, 2).sum(axis=1)
    np.testing.assert_allclose(merged.opacities * areas(merged), covered, rtol=1e-4)
    assert merged.opacities.max() <= 1


def test_only_the_first_pairs_are_merged(random_splats: Make) -> None:
    splats = random_splats(10)
    merged, weights = merge(splats, np.ones(10), all_pairs(splats, 5), 2)
    assert (len(merged), len(weights)) == (8, 8)
    np.testing.assert_array_equal(merged.positions[2:], splats.positions[4:])


def test_pairs_are_disjoint_and_the_most_alike_come_first(random_splats: Make) -> None:
    scattered = random_splats(200)
    scattered.scales[:] = 0.02
    twins = replace(scattered[:20], positions=scattered[:20].positions + np.float32(1e-4))
    splats = Splats(
        *(
            np.concatenate([getattr(scattered, name), getattr(twins, name)])
            for name in ("positions", "orientations", "scales", "opacities", "sh")
        )
    )
    pairs = find_pairs(splats, np.ones(220), pixel=0.001)
    assert len(pairs) <= MOST * 220
    assert len(np.unique([pairs.first, pairs.second])) == 2 * len(pairs)
    assert {*zip(pairs.first[:20], pairs.second[:20], strict=True)} == {
        (i, 200 + i) for i in range(20)
    }


def test_what_contributes_little_goes_first(random_splats: Make) -> None:
    splats = random_splats(400)
    splats.scales[:] = 0.02
    weights = np.where(np.arange(400) % 10 == 0, 1e-3, 1.0)
    pairs = find_pairs(splats, weights, pixel=0.001)
    light = (weights[pairs.first] < 1) | (weights[pairs.second] < 1)
    assert light[:20].all() and not light.all()


def test_of_pairs_as_far_apart_that_of_one_colour_goes_first() -> None:
    colours = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, 1]], np.float32)
    splats = Splats(
        positions=np.array([[0, 0, 0], [0.01, 0, 0], [9, 0, 0], [9.01, 0, 0]]),
        orientations=np.tile([0, 0, 0, 1.0], (4, 1)),
        scales=np.full((4, 3), 0.02),
        opacities=np.full(4, 0.5),
        sh=colours[:, None],
    )
    pairs = find_pairs(splats, np.ones(4), pixel=0.001)
    assert (pairs.first.tolist(), pairs.second.tolist()) == ([2], [3])


@pytest.mark.parametrize("count", [0, 1, 2, 3])
def test_few_splats(random_splats: Make, count: int) -> None:
    splats = random_splats(count)
    pairs = find_pairs(splats, np.ones(count), pixel=0.001)
    assert len(pairs) == (count > 1)
    merged, _ = merge(splats, np.ones(count), pairs, len(pairs))
    assert len(merged) == count - len(pairs)


def test_splats_of_one_place_and_of_any_size_merge(random_splats: Make) -> None:
    splats = random_splats(300)
    splats.positions[:] = 1
    splats.scales[:100] = 0
    splats.scales[100:200] = 1e6
    weights = np.ones(300)
    while len(splats) > 1:
        pairs = find_pairs(splats, weights, pixel=0.001)
        splats, weights = merge(splats, weights, pairs, len(pairs))
        for array in (splats.positions, splats.orientations, splats.scales, splats.opacities):
            assert np.isfinite(array).all()
