"""Splats as a payload: decoded alike in C++ and NumPy, and drawn as those that went in."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from rosplat_core import maps, rendering
from rosplat_core.cameras import Camera, look_at
from rosplat_core.generated import generate
from rosplat_core.payload import Arrays, decode, encode, suits
from rosplat_core.rendering import insert_all, posed
from rosplat_core.splats import Splats
from rosplat_lab.metrics import psnr
from rosplat_sorter.edits import is_usable

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
    got = maps.decode_payload(packed, 5000, sh_degree)
    for name in ("positions", "orientations", "opacities"):
        np.testing.assert_array_equal(got[name], getattr(expected, name).ravel())
    for name in ("scales", "sh"):  # tables of exponentials, which libraries round as they like
        np.testing.assert_allclose(got[name], getattr(expected, name).ravel(), rtol=2e-7)
    assert np.isnan(got["scales"]).any()


def pictures(splats: Splats) -> list[np.ndarray]:
    renderer = rendering.CpuRenderer(threads=2)
    insert_all(renderer, splats)
    drawn = []
    for eye in ((4.0, 1.0, 1.5), (-1.0, 2.5, 0.8)):
        camera = Camera(
            id=0, width=320, height=240, fx=250.0, fy=250.0, cx=160.0, cy=120.0,
            world_to_camera=look_at(eye, (0, 0, 0)),
        )  # fmt: skip
        picture = renderer.draw(posed(camera))["colour"]
        drawn.append(np.clip(picture[..., :3], 0, 1))
    return drawn


@pytest.mark.parametrize(
    ("far", "large", "suited"),
    [(0, 0, True), (1e3, 0, True), (1e7, 0, False), (1e37, 0, False),
     (0, 1e2, True), (0, 1e6, False), (0, 1e37, False)],
)  # fmt: skip
def test_the_picture_is_that_of_the_arrays_where_no_stray_splat_is(
    far: float, large: float, suited: bool
) -> None:
    splats = generate(30_000)
    splats.positions[0] += np.float32(far)
    splats.scales[0] += np.float32(large)
    splats.opacities[0] = 0  # what it costs the others is meant
    arrays = arrays_of(splats)
    usable = is_usable(arrays)
    packed = encode(arrays, usable)
    got = pictures(replace(splats, **vars(decode(packed, len(splats), splats.sh_degree))))
    for picture, expected in zip(got, pictures(splats), strict=True):
        assert expected.std() > 0.05
        assert (psnr(picture, expected) > LEAST) == suited
    assert suits(arrays, usable) == suited
