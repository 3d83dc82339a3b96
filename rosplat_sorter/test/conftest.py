"""Maps, cameras and messages that tests start from."""

from __future__ import annotations

import math

import numpy as np
import pytest
from geometry_msgs.msg import Point, Pose, Quaternion

from rosplat_msgs.msg import GaussianArray, ViewCamera

pytest_plugins = ["core_fixtures"]


RADII = math.sqrt(2 * math.log(255))  # of an opaque splat, in standard deviations


@pytest.fixture
def make_edit():
    """A batch that writes positions (n, 3) with extents (n,) or one for all; below 0: invisible.

    poses: position and quaternion of groups, by number.
    """

    def make(
        positions, extents=0.1, slots=None, poses=(), origin=(0.0, 0.0, 0.0), **given
    ) -> GaussianArray:
        positions = np.asarray(positions, np.float32).reshape(-1, 3)
        count = len(positions)
        batch = GaussianArray(map_id="map", revision=1, operation=GaussianArray.UPSERT, count=count)
        for name, value in given.items():
            setattr(batch, name, value)
        if slots is not None:
            batch.slots = np.asarray(slots, np.uint32)
        batch.origin = Point(**dict(zip("xyz", map(float, origin), strict=True)))
        for group, (position, orientation) in dict(poses).items():
            batch.groups.append(group)
            at = Point(**dict(zip("xyz", map(float, position), strict=True)))
            turn = Quaternion(**dict(zip("xyzw", map(float, orientation), strict=True)))
            batch.poses.append(Pose(position=at, orientation=turn))
        if batch.operation in (GaussianArray.REPLACE, GaussianArray.UPSERT):
            extents = np.broadcast_to(np.float32(extents), count)
            scales = np.maximum(extents, 0) / np.float32(RADII)
            batch.positions = positions.ravel()
            batch.orientations = np.tile(np.float32([0, 0, 0, 1]), count)
            batch.scales = np.repeat(scales, 3)
            batch.opacities = np.where(extents < 0, np.float32(0.001), np.float32(1))
            batch.sh = np.zeros(3 * count, np.float32)
        else:
            batch.count = count if batch.operation == GaussianArray.DELETE else 0
        return batch

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
