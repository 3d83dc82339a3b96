"""Procedural scenes as they are seen."""

from dataclasses import replace

import numpy as np

from rosplat_core.cameras import Camera, look_at
from rosplat_core.generated import generate
from rosplat_core.quaternions import to_matrices
from rosplat_lab.bench import scenes
from rosplat_lab.reference import render


def test_the_ground_is_flat_and_closed() -> None:
    splats = generate(30_000)
    sand = splats[np.abs(splats.positions[:, 2]) < 0.014]
    normals = to_matrices(sand.orientations)[:, 2, 2]
    assert np.median(np.abs(normals)) > 0.8
    below = Camera(0, 64, 64, 90, 90, 32, 32, look_at((0.3, -1.2, -3), (0.3, -1.2, 0), (0, 1, 0)))
    alpha = render(replace(sand), below, crop=(20, 20, 44, 44)).rgba[..., 3]
    assert alpha.min() > 0.9


def test_sheen_depends_on_the_view() -> None:
    splats = generate(20_000)
    left, right = (
        render(splats, Camera(0, 48, 48, 40, 40, 24, 24, look_at((x, -2, 1.2), (0, 0, 0.9)))).rgba
        for x in (-1.5, 1.5)
    )
    flat = generate(20_000, sh_degree=0)
    same = render(
        flat, Camera(0, 48, 48, 40, 40, 24, 24, look_at((-1.5, -2, 1.2), (0, 0, 0.9)))
    ).rgba
    assert np.abs(left - same).max() > 0.1
    assert np.abs(left - right).max() > 0.1


def test_walls_hide_the_other_rooms() -> None:
    splats = generate(80_000, scene="rooms", sh_degree=0)
    camera = scenes.room(splats, 640, 360, 1)[0]
    x, y, _ = np.abs(splats.positions).T
    room = splats[np.maximum(x, y) < 2.15]  # the middle one, of nine
    assert len(room) < len(splats) / 5
    wall = (60, 90, 100, 130)
    alone, among_all = (render(part, camera, crop=wall).rgba for part in (room, splats))
    assert alone[..., 3].min() > 0.99
    np.testing.assert_allclose(alone, among_all, atol=0.01)
