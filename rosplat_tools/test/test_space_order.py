"""Neighbours in space become neighbours in the map, and no splat is lost or mixed up."""

from dataclasses import replace

import numpy as np
import pytest

from rosplat_tools.generate import generate
from rosplat_tools.space_order import put_in_space_order, space_order


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


def test_each_splat_stays_whole() -> None:
    splats = generate(2000)
    splats = replace(splats, channels={"label": np.arange(2000), "x": splats.positions[:, 0]})
    order = space_order(splats.positions)
    expected = splats[order]
    put_in_space_order(splats)
    for array, wanted in zip(splats.arrays, expected.arrays, strict=True):
        np.testing.assert_array_equal(array, wanted)


def test_pages_become_small() -> None:
    def size_of_pages(positions: np.ndarray) -> float:
        pages = positions[: len(positions) // 1024 * 1024].reshape(-1, 1024, 3)
        return float(np.median(np.ptp(pages, axis=1)))

    splats = generate(50_000)
    before = size_of_pages(splats.positions)
    put_in_space_order(splats)
    assert size_of_pages(splats.positions) < before / 2
