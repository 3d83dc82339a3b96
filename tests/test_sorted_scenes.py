"""Every backend's order of the trained scenes is the reference order, slot by slot."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from std_msgs.msg import Header

from rosplat_msgs.msg import GaussianArray
from rosplat_sorter import backends, camera, depth, edits, view
from rosplat_sorter.map import SplatMap
from rosplat_tools import formats
from rosplat_tools.cameras import load_cameras
from rosplat_tools.messages import encode
from rosplat_tools.view_messages import view_camera


@pytest.mark.parametrize("name", backends.BACKENDS)
@pytest.mark.parametrize(("scene", "file"), [("wolf", "wolf.spz"), ("playbot", "playbot")])
def test_order_equals_the_stable_argsort(
    data_folder: Path, reference_folder: Path, scene: str, file: str, name: str
) -> None:
    try:
        backend = backends.open_backend(name)
    except backends.Unavailable as error:
        pytest.skip(f"{name}: {error}")
    splats = formats.load(data_folder / file)
    message = encode(
        splats, range(len(splats)), header=Header(frame_id="map"), map_id="test", revision=1,
        operation=GaussianArray.REPLACE, expected_slots=len(splats),
    )  # fmt: skip
    scene_map = SplatMap()
    changed = scene_map.apply(edits.decode(message))
    backend.update(scene_map, changed)
    for which in load_cameras(reference_folder / scene / "cameras.json"):
        seen = view.View.of(camera.decode(view_camera(which)), scene_map.frames)
        depths = depth.transform(seen, scene_map.positions, 2)
        visible = np.flatnonzero(depth.visible(seen, scene_map.positions, scene_map.extents))
        expected = visible[np.argsort(depths[visible], kind="stable")][::-1]
        np.testing.assert_array_equal(backend.order(seen), expected)
        assert len(expected) > len(splats) / 2
