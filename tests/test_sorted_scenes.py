"""Every backend's order of the trained scenes is the reference order, slot by slot."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from std_msgs.msg import Header

from rosplat_core import depth, formats, view
from rosplat_core.cameras import load_cameras
from rosplat_msgs.msg import GaussianArray
from rosplat_ros import view_cameras
from rosplat_ros.view_cameras import view_camera
from rosplat_sorter import backends
from rosplat_sorter.map import SplatMap
from rosplat_testing.messages import encode


@dataclass(frozen=True)
class Scene:
    """A trained scene, and the slots that each of its cameras sees, back to front."""

    map: SplatMap
    orders: list[tuple[view.SortView, NDArray[np.integer]]]


@pytest.fixture(
    scope="module",
    params=[("wolf", "wolf.spz"), ("playbot", "playbot")],
    ids=lambda names: names[0],
)
def scene(request: pytest.FixtureRequest, data_folder: Path, reference_folder: Path) -> Scene:
    name, file = request.param
    splats = formats.load(data_folder / file)
    message = encode(
        splats, range(len(splats)), header=Header(frame_id="map"), map_id="test", revision=1,
        operation=GaussianArray.REPLACE, expected_slots=len(splats),
    )  # fmt: skip
    scene_map = SplatMap()
    scene_map.apply(message)
    orders = []
    for which in load_cameras(reference_folder / name / "cameras.json"):
        seen = view.SortView.of(view_cameras.decode(view_camera(which)), scene_map.frames)
        depths = depth.transform(seen, scene_map.positions, 2)
        visible = np.flatnonzero(depth.visible(seen, scene_map.positions, scene_map.extents))
        assert len(visible) > len(splats) / 2
        orders.append((seen, visible[np.argsort(depths[visible], kind="stable")][::-1]))
    return Scene(scene_map, orders)


@pytest.mark.parametrize("name", backends.BACKENDS)
def test_order_equals_the_stable_argsort(scene: Scene, name: str) -> None:
    try:
        backend = backends.open_backend(name)
    except backends.Unavailable as error:
        pytest.skip(f"{name}: {error}")
    backend.update(scene.map, scene.map.changed_rows)
    for seen, expected in scene.orders:
        np.testing.assert_array_equal(backend.order(seen), expected)
