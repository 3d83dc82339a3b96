"""What a user gives in place of splats and cameras is named in a sentence."""

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from core_fixtures import random_splats

import rosplat_core as rc

SPLATS = random_splats(20, 0)
CAMERA = rc.Camera(0, 64, 48, 50, 50, 32, 24, rc.look_at((3, 0, 0), (0, 0, 0)))
ARRAY = np.zeros((3, 3))
PICTURE = np.zeros((48, 64, 3), np.uint8)


@pytest.mark.parametrize(
    ("error", "call"),
    [
        ("splats: expected Splats, got ndarray", lambda: rc.depth_order(ARRAY, CAMERA)),
        ("splats: expected Splats, got ndarray", lambda: rc.put_in_slot_order(ARRAY)),
        ("splats: expected Splats, got ndarray", lambda: rc.first_view(ARRAY)),
        ("splats: expected Splats, got ndarray", lambda: rc.find_up(ARRAY)),
        ("count is '20k', expected a whole number", lambda: rc.generate("20k")),
        ("scene is 'city', expected garden or rooms", lambda: rc.generate(9, scene="city")),
        ("parts: expected Splats, got int", lambda: rc.concatenate([1, 2])),
        ("Splats: a slice picks splats, such as [0:1]", lambda: rc.concatenate(SPLATS)),
        ("camera: expected Camera, got list", lambda: rc.render(SPLATS, [CAMERA])),
        ("camera: expected Camera, got ndarray", lambda: rc.align(SPLATS, CAMERA, PICTURE)),
        ("camera: expected Camera, got str", lambda: rc.depth_order(SPLATS, "c.json")),
        ("camera: expected Camera, got int", lambda: rc.first_view(SPLATS, cameras=[1])),
        ("cameras: expected several of Camera, got str",
         lambda: rc.simplify(SPLATS, max_splats=9, cameras="c.json")),
        ("cameras: expected several of Camera, got Camera",
         lambda: rc.save_cameras("c.json", CAMERA)),
        ("bounds: expected two corners (2, 3), got (1, 3)", lambda: rc.orbit([[0, 0, 0]], 8)),
        ("up: expected three numbers, not all 0, got 'z'", lambda: rc.first_view(SPLATS, "z")),
        ("up: expected three numbers, not all 0, got 'z'", lambda: replace(SPLATS, up="z")),
        ("degree is '2', expected 0 to 3", lambda: SPLATS.with_sh_degree("2")),
        ("threads is '2', expected 0 to 1024", lambda: rc.CpuRenderer(threads="2")),
        ("tries is 0, expected 1 or more", lambda: rc.align(SPLATS, PICTURE, CAMERA, tries=0)),
        ("resolution is 0 m, expected more than 0",
         lambda: rc.DistanceField.of(SPLATS, resolution=0)),
        ("margin is -1 m, expected 0 or more", lambda: rc.DistanceField.of(SPLATS, margin=-1)),
        ("Splats.positions: could not convert", lambda: replace(SPLATS, positions="abc")),
        ("Splats.channels: expected {name: values}", lambda: replace(SPLATS, channels=["a"])),
    ],
)  # fmt: skip
def test_it_is_named(error: str, call: Callable[[], object]) -> None:
    with pytest.raises((TypeError, ValueError), match=re.escape(error)):
        call()
