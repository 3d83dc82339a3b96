"""The vertical of scenes whose files don't tell it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from rosplat_core.cameras import Camera, look_at
from rosplat_core.formats import load
from rosplat_core.generated import generate
from rosplat_core.splats import Splats
from rosplat_core.upright import _stands, find_up

Y_DOWN = Rotation.from_euler("x", 90, degrees=True)  # z becomes -y


def turned(splats: Splats, rotation: Rotation) -> Splats:
    pose = np.eye(4)
    pose[:3, :3] = rotation.as_matrix()
    return splats.moved(pose)


def degrees_between(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    return float(np.degrees(np.arccos(np.clip(a @ b, -1, 1))))


@pytest.mark.parametrize("scene", ["garden", "rooms"])
@pytest.mark.parametrize("tilt", [(0, 0, 0), (25, 0, 10), (-15, 30, 20)])
def test_a_tilted_scene_stands_on_its_ground(scene: str, tilt: tuple[float, float, float]) -> None:
    rotation = Rotation.from_euler("xyz", tilt, degrees=True) * Y_DOWN
    splats = turned(generate(20_000, scene=scene), rotation)
    assert degrees_between(find_up(splats), rotation.as_matrix()[:, 2]) < 1.5


def test_z_up_is_found_far_from_zero_and_in_any_unit() -> None:
    splats = generate(20_000, scene="rooms")
    far = replace(splats, positions=1e4 * splats.positions, scales=1e4 * splats.scales)
    far = replace(far, origin=np.array([5e6, 4e5, 100.0]))
    assert degrees_between(find_up(far), np.array([0, 0, 1])) < 0.5


@pytest.mark.parametrize("euler", [(-90, 0, 0), (180, 0, 0)])
def test_what_lies_on_its_ground_tells_it_in_rare_axes(euler: tuple[float, float, float]) -> None:
    rotation = Rotation.from_euler("xyz", euler, degrees=True)
    splats = turned(generate(20_000, scene="garden"), rotation)
    assert degrees_between(find_up(splats), rotation.as_matrix()[:, 2]) < 1.5


@pytest.mark.parametrize("up", [(0, -1, 0), (0, 0, 1)])
def test_a_statue_stands_on_its_plinth(up: tuple[float, float, float]) -> None:
    random = np.random.default_rng(0)
    heights = np.concatenate([random.uniform(0, 2, 15_000), random.uniform(0, 0.1, 5000)])
    radii = np.repeat([0.2, 0.5], [15_000, 5000]) * np.sqrt(random.uniform(size=20_000))
    angles = random.uniform(0, 2 * np.pi, 20_000)
    statue = Splats(
        positions=np.column_stack([radii * np.cos(angles), radii * np.sin(angles), heights]),
        orientations=np.tile([0, 0, 0, 1], (20_000, 1)), scales=np.full((20_000, 3), 0.02),
        opacities=np.full(20_000, 0.9), sh=np.zeros((20_000, 1, 3)),
    )  # fmt: skip
    rotation = Rotation.align_vectors([up], [[0, 0, 1]])[0]
    assert degrees_between(find_up(turned(statue, rotation)), np.array(up)) < 1


def test_an_animal_stands_on_its_legs() -> None:
    parts = [  # low and high corners: z [m], y up, x
        ((-0.5, 0.5, -0.4), (0.5, 0.85, 0.4)),
        ((0.45, 0.8, -0.2), (0.75, 1.1, 0.2)),
        *(((x, 0, z), (x + 0.08, 0.5, z + 0.08)) for x in (-0.45, 0.37) for z in (-0.4, 0.32)),
    ]
    random = np.random.default_rng(0)
    positions = np.concatenate([random.uniform(*part, (2000, 3)) for part in parts])[:, ::-1]
    up = np.array([0.0, 1.0, 0.0])
    assert _stands(positions, up) > 5 * _stands(positions, -up)


@pytest.mark.parametrize("tilt", [0, -90])
def test_the_wolf_stands_on_its_legs_without_its_file_telling(
    scene: Callable[[str], Path], tilt: int
) -> None:
    rotation = Rotation.from_euler("x", tilt, degrees=True)
    wolf = turned(replace(load(scene("wolf.spz")), up=None), rotation)
    assert degrees_between(find_up(wolf), rotation.as_matrix()[:, 1]) < 5


def test_cameras_tell_the_vertical_where_customs_mislead() -> None:
    rotation = Rotation.from_euler("x", 180, degrees=True)  # z down, which nobody has
    splats = turned(generate(20_000, scene="rooms"), rotation)
    down = np.array([0.0, 0.0, -1.0])
    cameras = [
        Camera(0, 64, 48, 50, 50, 32, 24, look_at((x, 1, -1.5), (0, 0, -1.2), down))
        for x in (-2.0, 2.0)
    ]
    assert degrees_between(find_up(splats, cameras), down) < 0.5


def test_nothing_to_tell_by_is_y_down() -> None:
    one = generate(1, scene="garden")
    assert find_up(one).tolist() == [0, -1, 0]
    assert find_up(one[:0]).tolist() == [0, -1, 0]
    same = replace(one[np.zeros(50, int)], opacities=np.ones(50))
    assert find_up(same).tolist() == [0, -1, 0]
