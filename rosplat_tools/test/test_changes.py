"""A map that is given whole again and again: what of it is sent."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from rclpy.node import Node

from rosplat_tools.changes import WholeMaps
from rosplat_tools.map_publisher import MapPublisher
from rosplat_tools.splats import concatenate
from rosplat_tools.testing import random_splats


@pytest.fixture
def maps(node: Node) -> WholeMaps:
    return WholeMaps(MapPublisher(node))


def test_only_what_differs_is_sent(maps: WholeMaps, listener: Any) -> None:
    first = random_splats(1000, 1)
    assert maps.show(first) == 1000
    assert maps.show(first) == 0
    sh = first.sh.copy()
    sh[[3, 500], 2, 1] += 0.5
    changed = replace(first, sh=sh)
    grown = concatenate([changed, random_splats(200, 2, seed=1)])
    assert maps.show(grown) == 202
    listener.wait_for(1200)
    _, splats = listener.map.snapshot()
    assert sorted(map(tuple, splats.sh.reshape(1200, -1))) == sorted(
        map(tuple, grown.sh.reshape(1200, -1))
    )


def test_rows_that_moved_are_a_new_map(maps: WholeMaps, listener: Any) -> None:
    first = random_splats(1000, 0)
    maps.show(first)
    assert maps.show(first[1:]) == 999
    assert maps.show(first[::-1]) == 1000
    antialiased = replace(first, antialiased=True)
    assert maps.show(antialiased) == 1000
    listener.wait(lambda: listener.map and listener.map.snapshot()[1].antialiased)
    _, splats = listener.map.snapshot()
    np.testing.assert_array_equal(np.sort(splats.opacities), np.sort(first.opacities))
