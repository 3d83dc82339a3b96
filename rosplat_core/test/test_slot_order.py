"""Neighbours of a size become neighbours in the map, and no splat is lost or mixed up."""

import math
from dataclasses import replace

import numpy as np
import pytest

from rosplat_core.generated import generate
from rosplat_core.slot_order import put_in_slot_order, slot_order, space_order


def test_order_is_that_of_a_plain_morton_code() -> None:
    cells = np.random.default_rng(1).integers(0, 2**21, (500, 3))
    cells[0], cells[1] = 0, 2**21 - 1  # so that a cell is one of the cube's

    def code(cell: np.ndarray) -> int:
        bits = (
            (int(cell[axis]) >> bit & 1) << (3 * bit + axis)
            for axis in range(3)
            for bit in range(21)
        )
        return sum(bits)

    expected = sorted(range(500), key=lambda i: code(cells[i]))
    np.testing.assert_array_equal(space_order(cells.astype(np.float32)), expected)


@pytest.mark.parametrize("positions", [np.zeros((0, 3)), np.ones((5, 3)), [[1e38, -1e38, 0]] * 3])
def test_any_finite_positions_have_an_order(positions: np.ndarray) -> None:
    order = space_order(np.asarray(positions, np.float32))
    np.testing.assert_array_equal(np.sort(order), np.arange(len(positions)))


def test_large_splats_come_first_and_those_of_a_size_in_space_order() -> None:
    splats = generate(2000)
    splats = replace(splats, scales=splats.scales * np.geomspace(1e-3, 1e3, 2000)[:, None])
    splats.scales[7] = 0
    rank = np.argsort(space_order(splats.positions))

    def place(i: int) -> tuple[float, int]:
        size = float(splats.scales[i].max())
        return (-math.floor(math.log2(size) / 2) if size else math.inf), rank[i]

    np.testing.assert_array_equal(slot_order(splats), sorted(range(2000), key=place))


def test_each_splat_stays_whole() -> None:
    splats = generate(2000)
    splats = replace(splats, channels={"label": np.arange(2000), "x": splats.positions[:, 0]})
    expected = splats[slot_order(splats)]
    put_in_slot_order(splats)
    for array, wanted in zip(splats.arrays, expected.arrays, strict=True):
        np.testing.assert_array_equal(array, wanted)


def test_nothing_changes_where_an_array_cannot_be_written_or_a_position_is_nowhere() -> None:
    splats = generate(2000)
    before = splats.positions.copy()
    splats.opacities.flags.writeable = False
    with pytest.raises(ValueError, match="read-only"):
        put_in_slot_order(splats)
    np.testing.assert_array_equal(splats.positions, before)
    splats.positions[7, 1] = np.nan
    with pytest.raises(ValueError, match="positions: expected finite numbers"):
        slot_order(splats)


def test_pages_become_small() -> None:
    def size_of_pages(positions: np.ndarray) -> float:
        pages = positions[: len(positions) // 1024 * 1024].reshape(-1, 1024, 3)
        return float(np.median(np.ptp(pages, axis=1)))

    splats = generate(50_000)
    before = size_of_pages(splats.positions)
    put_in_slot_order(splats)
    assert size_of_pages(splats.positions) < before / 2
