"""What inspect says of a format's order, against the reference."""

from __future__ import annotations

import numpy as np
import pytest

from drawing import cloud, decibels
from rosplat_core.cameras import orbit, place
from rosplat_lab import reference
from rosplat_tools.inspect_scene import VIEWS, order_costs


@pytest.mark.parametrize("up", [(0.0, 0.0, 1.0), (0.0, -1.0, 0.0)])
def test_the_order_costs_what_it_costs_the_reference(up: tuple[float, float, float]) -> None:
    splats = cloud()[:300]
    splats.scales[:] *= 5
    costs = order_costs(splats, up)
    here = place(splats)
    bounds = here.centre + np.outer([-1, 1], np.ones(3)) * here.radius / np.sqrt(3)
    cameras = orbit(bounds, VIEWS, width=640, height=360, up=up)
    for camera, cost in list(zip(cameras, costs, strict=True))[::4]:
        places = splats.positions + splats.origin - camera.position
        farthest = np.argsort(-np.linalg.norm(places, axis=1), kind="stable")
        by_depth = reference.render(splats, camera).rgba[..., :3]
        by_distance = reference.render(splats, camera, order=farthest).rgba[..., :3]
        expected = decibels(by_distance.clip(0, 1), by_depth.clip(0, 1))
        assert expected < 60
        assert cost == pytest.approx(expected, abs=0.2)
