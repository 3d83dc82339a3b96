"""A map that is given whole again and again: what of it is sent."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from core_fixtures import random_splats
from rclpy.node import Node

from rosplat_core.models import Model
from rosplat_core.slot_order import slot_order
from rosplat_core.splats import Splats, concatenate
from rosplat_ros.map_publisher import MapPublisher
from rosplat_testing.messages import as_held
from rosplat_tools.following.whole_maps import WholeMaps


@pytest.fixture
def publisher(node: Node) -> MapPublisher:
    return MapPublisher(node)


@pytest.fixture
def maps(publisher: MapPublisher) -> WholeMaps:
    return WholeMaps(publisher)


def contents(splats: Splats) -> list[tuple[float, ...]]:
    """What is in a map, in whatever order."""
    arrays = (splats.positions, splats.orientations, splats.scales, splats.opacities, splats.sh)
    rows = np.concatenate([array.reshape(len(splats), -1) for array in arrays], axis=1)
    return sorted(map(tuple, rows))


def test_only_what_differs_is_sent(maps: WholeMaps, listener: Any) -> None:
    first = random_splats(1000, 1)
    assert maps.show(first) == 1000
    assert maps.show(first) == 0
    sh = first.sh.copy()
    sh[[3, 500], 2, 1] += 0.5
    grown = concatenate([replace(first, sh=sh), random_splats(200, 2, seed=1)])
    assert maps.show(grown) == 202
    listener.wait_for(1200)
    assert contents(listener.map.snapshot()[1]) == contents(as_held(grown))


def test_a_value_of_a_channel_is_a_difference(maps: WholeMaps, listener: Any) -> None:
    labels = np.array([0, 1, np.nan, 3, 4, 5])
    splats = replace(random_splats(6), channels={"label": labels})
    assert maps.show(splats) == 6
    labels = np.array([0, 1, np.nan, 9, 4, np.nan])
    splats = replace(splats, channels={"label": labels})
    assert maps.show(splats) == 2
    assert maps.show(splats) == 0
    listener.wait(lambda: len(listener.batches) == 2)
    heard = listener.map.snapshot()[1].channels["label"]
    np.testing.assert_array_equal(np.sort(heard), np.sort(labels))


def test_what_is_not_finite_is_sent_once(maps: WholeMaps, publisher: MapPublisher) -> None:
    splats, ids = random_splats(100, 1), np.arange(100)
    splats.positions[:60, 0] = np.nan
    splats.scales[7] = np.inf
    assert maps.show(splats, ids) == 100
    slots, held = publisher.snapshot()
    assert slots == range(40)
    np.testing.assert_array_equal(slot_order(held), slots)
    assert maps.show(splats, ids) == 0
    splats.positions[3] = 0
    assert maps.show(splats, ids) == 1
    assert len(publisher) == 41
    splats.positions[80] = np.nan
    assert maps.show(splats, ids) == 1
    assert len(publisher) == 40


def test_a_frame_is_told_even_where_no_splat_differs(
    maps: WholeMaps, publisher: MapPublisher, listener: Any
) -> None:
    splats = random_splats(100, 1)
    for frame in ("map", "odom", "odom", "map"):
        publisher.frame_id = frame
        maps.show(splats)
    listener.wait(lambda: listener.batches and listener.batches[-1].revision == 3)
    assert [batch.header.frame_id for batch in listener.batches] == ["map", "odom", "map"]
    assert len(listener.map) == 100


def test_what_keeps_its_id_keeps_its_slot(
    maps: WholeMaps, publisher: MapPublisher, listener: Any
) -> None:
    """Whatever a trainer does to its arrays, and without sending what stayed."""
    rng = np.random.default_rng(0)
    splats, ids, next_id = random_splats(400, 0), np.arange(400), 400
    maps.show(splats, ids)
    for _ in range(8):
        kept = rng.permutation(len(ids))[: rng.integers(300, 380)]
        slot_of = slots_of(publisher, splats, ids)
        grown = int(rng.integers(0, 100))
        splats = concatenate([splats[kept], random_splats(grown, 0, seed=next_id)])
        before, ids = ids[kept], np.concatenate([ids[kept], np.arange(next_id, next_id + grown)])
        next_id += grown
        assert maps.show(splats, ids) == grown
        now = slots_of(publisher, splats, ids)
        assert all(now[i] == slot_of[i] for i in before.tolist())
        assert max(now.values()) < 500  # free slots are taken again
    listener.wait(lambda: listener.batches and listener.batches[-1].revision == publisher.revision)
    assert contents(listener.map.snapshot()[1]) == contents(as_held(splats))


def slots_of(publisher: MapPublisher, splats: Splats, ids: Any) -> dict[int, int]:
    slots, held = publisher.snapshot()
    by_place = dict(zip(map(tuple, held.positions), list(slots), strict=True))
    return {int(i): by_place[p] for i, p in zip(ids, map(tuple, splats.positions), strict=True)}


def test_rows_without_ids_that_moved_are_a_new_map(maps: WholeMaps, listener: Any) -> None:
    first = random_splats(1000, 0)
    maps.show(first)
    assert maps.show(first[1:]) == 999
    assert maps.show(first[::-1]) == 1000
    assert maps.show(replace(first, model=Model.RAY)) == 1000
    listener.wait(lambda: listener.map and listener.map.snapshot()[1].model is Model.RAY)
    assert contents(listener.map.snapshot()[1]) == contents(as_held(first))


def test_what_was_written_into_the_same_arrays_is_sent(maps: WholeMaps) -> None:
    splats, ids = random_splats(100, 1), np.arange(100)
    assert maps.show(splats, ids) == 100
    splats.positions[[3, 50]] += 1
    splats.sh[7] = 0
    assert maps.show(splats, ids) == 3
    splats.opacities[9] /= 2
    assert maps.show(splats, ids) == 1


def test_ids_may_be_hashes(maps: WholeMaps) -> None:
    splats, ids = random_splats(3, 0), np.array([2**64 - 1, 5, 2**63], np.uint64)
    assert maps.show(splats, ids) == 3
    assert maps.show(splats[::-1], ids[::-1]) == 0


def test_ids_that_are_none_are_refused(maps: WholeMaps) -> None:
    splats = random_splats(3, 0)
    with pytest.raises(ValueError, match="ids: one is there twice"):
        maps.show(splats, [1, 2, 1])
    with pytest.raises(ValueError, match="ids: expected integers, got float64"):
        maps.show(splats, [0.2, 0.7, 1.2])
    with pytest.raises(ValueError, match="shape"):
        maps.show(splats, [1, 2])
    assert maps.show(splats[:0]) == 0
    assert maps.show(splats) == 3
