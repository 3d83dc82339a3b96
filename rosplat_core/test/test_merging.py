"""Merging of neighbours, against moments and errors worked out otherwise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from rosplat_core.quaternions import to_matrices
from rosplat_core.simplification.merging import (
    MOST,
    Contributions,
    _Field,
    _neighbours,
    _pairs_of,
    areas,
    combine,
    find_pairs,
    merge,
)
from rosplat_core.splats import Splats

Make = Callable[..., Splats]

PIXEL = 0.001  # [m]


def covariances(splats: Splats) -> np.ndarray:
    axes = to_matrices(splats.orientations) * splats.scales[:, None, :]
    return axes @ axes.transpose(0, 2, 1)


def combined(splats: Splats, weights: np.ndarray) -> tuple[Splats, Contributions]:
    """Of splats 0 and 1, 2 and 3, and so on."""
    even, odd = slice(0, None, 2), slice(1, None, 2)
    return combine(splats[even], splats[odd], seen(weights[even]), seen(weights[odd]), PIXEL)


def seen(weights: np.ndarray) -> Contributions:
    """What splats contribute that are all a tenth as bright as what is behind them."""
    return Contributions(weights, weights**2, 0.1 * weights**2)


def test_a_merged_splat_has_the_moments_of_the_two(random_splats: Make) -> None:
    splats = random_splats(40)
    weights = np.random.default_rng(1).uniform(1, 9, 40)
    merged, found = combined(splats, weights)
    sums = found.weight
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
    merged, _ = combined(splats, np.ones(40))
    covered = (splats.opacities * areas(splats)).reshape(-1, 2).sum(axis=1)
    np.testing.assert_allclose(merged.opacities * areas(merged), covered, rtol=1e-4)
    assert merged.opacities.max() <= 1


def test_only_the_first_pairs_are_merged(random_splats: Make) -> None:
    splats = random_splats(10)
    pairs = find_pairs(splats, seen(np.ones(10)), PIXEL)
    merged, found = merge(splats, seen(np.ones(10)), pairs, 1)
    assert len(merged) == len(found.weight) == len(found.energy) == len(found.error) == 9
    others = np.setdiff1d(np.arange(10), [pairs.first[0], pairs.second[0]])
    assert {*map(tuple, splats.positions[others])} <= {*map(tuple, merged.positions)}


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
    pairs = find_pairs(splats, seen(np.ones(220)), PIXEL)
    assert len(pairs) <= MOST * 220
    apart = pairs.first != pairs.second
    members = np.concatenate([pairs.first, pairs.second[apart]])
    assert len(np.unique(members)) == len(members)
    assert {*zip(pairs.first[:20], pairs.second[:20], strict=True)} == {
        (i, 200 + i) for i in range(20)
    }


def test_pairs_are_those_that_taking_the_cheapest_of_all_one_by_one_finds(
    random_splats: Make,
) -> None:
    count = 300
    splats = random_splats(count)
    splats.positions[:] *= 0.05
    found = seen(np.random.default_rng(2).uniform(0.01, 9, count))
    field = _Field.of(splats, found, PIXEL)
    low, high = _pairs_of(_neighbours(splats.positions), slice(0, count))
    first, second = np.append(low, np.arange(count)), np.append(high, np.arange(count))
    costs = np.append(field.cost(low, high), field.errors)
    expected: list[tuple[int, int]] = []
    for i in np.argsort(costs, kind="stable"):
        if not {first[i], second[i]} & {*np.ravel(expected)}:
            expected.append((first[i], second[i]))
    pairs = find_pairs(splats, found, PIXEL)
    assert [*zip(pairs.first, pairs.second, strict=True)] == expected[: int(MOST * count)]
    assert (pairs.first == pairs.second).any() and (pairs.first != pairs.second).any()


def test_what_contributes_little_goes_first(random_splats: Make) -> None:
    splats = random_splats(400)
    splats.scales[:] = 0.02
    weights = np.where(np.arange(400) % 10 == 0, 1e-3, 1.0)
    pairs = find_pairs(splats, seen(weights), PIXEL)
    light = (weights[pairs.first] < 1) | (weights[pairs.second] < 1)
    assert light[:20].all() and not light.all()


def test_what_looks_like_what_is_behind_it_is_left_out(random_splats: Make) -> None:
    """And first; nothing is put in its place."""
    splats = random_splats(100)
    splats.scales[:] = 0.02
    alike = np.arange(100) % 10 == 0
    found = Contributions(np.ones(100), np.ones(100), np.where(alike, 1e-9, 0.1))
    pairs = find_pairs(splats, found, PIXEL)
    assert {*pairs.first[:10]} == {*pairs.second[:10]} == {*np.flatnonzero(alike)}
    fewer, _ = merge(splats, found, pairs, 10)
    np.testing.assert_array_equal(fewer.positions, splats.positions[~alike])
    np.testing.assert_array_equal(fewer.opacities, splats.opacities[~alike])


def test_what_is_merged_has_as_much_energy_as_its_field(random_splats: Make) -> None:
    """Of two in one place, which add up: four times that of one."""
    _, found = combined(random_splats(1)[np.zeros(2, np.intp)], np.ones(2))
    assert found.energy == pytest.approx([4.0], rel=1e-3)
    assert found.error == pytest.approx([0.4], rel=1e-3)


def test_of_pairs_as_far_apart_that_of_one_colour_goes_first() -> None:
    colours = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, 1]], np.float32)
    splats = Splats(
        positions=np.array([[0, 0, 0], [0.01, 0, 0], [9, 0, 0], [9.01, 0, 0]]),
        orientations=np.tile([0, 0, 0, 1.0], (4, 1)),
        scales=np.full((4, 3), 0.02),
        opacities=np.full(4, 0.5),
        sh=colours[:, None],
    )
    pairs = find_pairs(splats, seen(np.ones(4)), PIXEL)
    assert (pairs.first.tolist(), pairs.second.tolist()) == ([2], [3])


@pytest.mark.parametrize("count", [0, 1, 2, 3])
def test_few_splats(random_splats: Make, count: int) -> None:
    splats = random_splats(count)
    pairs = find_pairs(splats, seen(np.ones(count)), PIXEL)
    assert len(pairs) == (count > 1)
    merged, _ = merge(splats, seen(np.ones(count)), pairs, len(pairs))
    assert len(merged) == count - len(pairs)


def test_splats_of_one_place_and_of_any_size_merge(random_splats: Make) -> None:
    splats = random_splats(300)
    splats.positions[:] = 1
    splats.scales[:100] = 0
    splats.scales[100:200] = 1e6
    found = seen(np.ones(300))
    while len(splats) > 1:
        pairs = find_pairs(splats, found, PIXEL)
        splats, found = merge(splats, found, pairs, len(pairs))
        for array in (splats.positions, splats.orientations, splats.scales, splats.opacities):
            assert np.isfinite(array).all()
