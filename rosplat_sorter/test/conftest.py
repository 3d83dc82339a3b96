"""Maps, cameras and messages that tests start from."""

from __future__ import annotations

import numpy as np
import pytest

from rosplat_msgs.msg import GaussianArray, ViewCamera
from rosplat_sorter.edits import UPSERT, Edit

pytest_plugins = ["core_fixtures"]


@pytest.fixture
def make_edit():
    """An edit that writes positions (n, 3) with extents (n,) or one for all."""

    def make(positions, extents=0.1, slots=None, **given) -> Edit:
        positions = np.asarray(positions, np.float32).reshape(-1, 3)
        slots = slice(0, len(positions)) if slots is None else np.asarray(slots, np.uint32)
        values = {
            "map_id": "map",
            "revision": 1,
            "frame_id": "map",
            "operation": UPSERT,
            "origin": np.zeros(3),
            "slots": slots,
            "end": slots.stop if isinstance(slots, slice) else int(slots.max()) + 1,
            "positions": positions,
            "extents": np.broadcast_to(np.float32(extents), len(positions)),
            "rejected": 0,
        }
        return Edit(**(values | given))

    return make


@pytest.fixture
def make_batch():
    """A GaussianArray of count splats in a row along z, with fields or header fields as given."""

    def make(count=3, map_id="map", revision=1, operation=GaussianArray.UPSERT, **given):
        message = GaussianArray(map_id=map_id, revision=revision, operation=operation, count=count)
        message.header.frame_id = given.pop("frame_id", "map")
        if operation in (GaussianArray.REPLACE, GaussianArray.UPSERT):
            rows = np.zeros((count, 3), np.float32)
            rows[:, 2] = 1 + np.arange(count)
            message.positions = rows.ravel().tolist()
            message.orientations = [0.0, 0.0, 0.0, 1.0] * count
            message.scales = [0.1] * (3 * count)
            message.opacities = [1.0] * count
            message.sh = [0.0] * (3 * (given.get("sh_degree", 0) + 1) ** 2 * count)
        for field, value in given.items():
            setattr(message, field, value)
        return message

    return make


@pytest.fixture
def make_look():
    """A ViewCamera at the map's origin that looks along z, with fields as given."""

    def make(view_id="view", sequence=1, frame_id="map", x=0.0, **given) -> ViewCamera:
        values = {
            "fx": 500.0,
            "fy": 500.0,
            "cx": 320.0,
            "cy": 240.0,
            "width": 640,
            "height": 480,
            "near_clip": 0.1,
            "far_clip": 100.0,
        }
        message = ViewCamera(view_id=view_id, sequence=sequence, **(values | given))
        message.header.frame_id = frame_id
        message.pose.position.x = x
        return message

    return make
