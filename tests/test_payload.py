"""Splats as a payload: decoded alike in C++ and NumPy, and drawn as those that went in."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from rosplat_lab.bench.embedded import insert_all, pose
from rosplat_lab.metrics import psnr
from rosplat_sorter.edits import is_usable
from rosplat_sorter.payload import Arrays, decode, encode
from rosplat_tools.cameras import Camera, look_at
from rosplat_tools.generate import generate
from rosplat_tools.splats import Splats
from rviz_gaussian_plugin import offscreen

LEAST = 55.0  # [dB]


def arrays_of(splats: Splats) -> Arrays:
    return Arrays(splats.positions, splats.orientations, splats.scales, splats.opacities, splats.sh)


@pytest.mark.parametrize("sh_degree", range(4))
def test_cpp_and_numpy_decode_alike(sh_degree: int) -> None:
    splats = generate(5000).with_sh_degree(sh_degree)
    rng = np.random.default_rng(sh_degree)
    splats = replace(splats, sh=splats.sh + rng.normal(size=splats.sh.shape))
    arrays = arrays_of(splats)
    packed = encode(arrays, rng.random(5000) < 0.9)
    expected = decode(packed, 5000, sh_degree)
    got = offscreen.decode_payload(packed, 5000, sh_degree)
    for name in ("positions", "orientations", "opacities"):
        np.testing.assert_array_equal(got[name], getattr(expected, name).ravel())
    for name in ("scales", "sh"):  # tables of exponentials, which libraries round as they like
        np.testing.assert_allclose(got[name], getattr(expected, name).ravel(), rtol=2e-7)
    assert np.isnan(got["scales"]).any()


def test_the_picture_is_that_of_the_arrays() -> None:
    splats = generate(30_000)
    arrays = arrays_of(splats)
    packed = encode(arrays, is_usable(arrays))
    pictures = []
    for shown in (splats, replace(splats, **vars(decode(packed, len(splats), splats.sh_degree)))):
        renderer = offscreen.CpuRenderer(threads=2)
        insert_all(renderer, shown)
        for eye in ((4.0, 1.0, 1.5), (-1.0, 2.5, 0.8)):
            camera = Camera(
                id=0, width=320, height=240, fx=250.0, fy=250.0, cx=160.0, cy=120.0,
                world_to_camera=look_at(eye, (0, 0, 0)),
            )  # fmt: skip
            drawn = renderer.draw(offscreen.Camera(*pose(camera)))
            pictures.append(np.clip(drawn["colour"][..., :3], 0, 1))
    for picture, expected in zip(pictures[2:], pictures[:2], strict=True):
        assert expected.std() > 0.05
        assert psnr(picture, expected) > LEAST
