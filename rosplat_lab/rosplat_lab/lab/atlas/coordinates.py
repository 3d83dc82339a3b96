"""Where numbers fail: far from the origin, in other units, sheared."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from rosplat_core import harmonics
from rosplat_core.cameras import Camera, look_at
from rosplat_core.quaternions import to_matrices
from rosplat_core.splats import Splats
from rosplat_lab.lab import motion
from rosplat_lab.lab.atlas.case import Cases, Curves
from rosplat_lab.lab.atlas.stage import ahead, cloud, decibels, floats, outside, shown, some, truth
from rosplat_lab.lab.bench import Bench

CASES = Cases()


@CASES.enter("Far from the origin", "offset [m]")
def far_away(bench: Bench, quick: bool) -> tuple[Sequence[float], Curves]:
    offsets = some([0, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7], quick)
    splats = cloud(400)
    curves: Curves = {"rebased in float64 (ours)": [], "float32 without an origin": []}
    for offset in offsets:
        there = offset * np.array([0.8, -0.5, 0.3])
        camera = outside(world_to_camera=look_at(there + outside().position, there))
        rebased = replace(splats, origin=there)
        expected = truth(rebased, camera)
        naive = replace(splats, positions=(splats.positions + there).astype(np.float32))
        for name, form in (
            ("rebased in float64 (ours)", rebased), ("float32 without an origin", naive),
        ):  # fmt: skip
            curves[name].append(decibels(shown(bench, form, camera), expected))
    return offsets, curves


@CASES.enter("The same scene in other units", "scale of scene and camera")
def scaled(bench: Bench, quick: bool) -> tuple[Sequence[float], Curves]:
    factors = some([1e-6, 1e-4, 1e-2, 1, 1e2, 1e4, 1e6], quick)
    splats = cloud(400)
    curves: Curves = {"scaled": [], "scaled and mirrored": []}
    mirror = floats(-1, 1, 1)
    signs = np.sign(_mirrored_harmonics())
    for factor in factors:
        larger = replace(
            splats,
            positions=splats.positions * np.float32(factor),
            scales=splats.scales * np.float32(factor),
        )
        camera = motion.placed(outside(), outside().position * factor)
        camera = replace(camera, near=0.01 * factor)
        curves["scaled"].append(decibels(shown(bench, larger, camera), truth(splats, outside())))
        # Mirrored in x: a quaternion's y and z turn round, harmonics odd in x change sign.
        flipped = replace(
            larger,
            positions=larger.positions * mirror,
            orientations=larger.orientations * floats(1, -1, -1, 1),
            sh=larger.sh * signs[None, : larger.sh.shape[1], None].astype(np.float32),
        )
        facing = look_at(camera.position * mirror, (0, 0, 0))
        seen = shown(bench, flipped, replace(camera, world_to_camera=facing))
        curves["scaled and mirrored"].append(decibels(seen[:, ::-1], truth(splats, outside())))
    return factors, curves


@CASES.enter("Sheared maps", "shear, metres a metre")
def sheared(bench: Bench, quick: bool) -> tuple[Sequence[float], Curves]:
    """Against the map as it was, seen by a camera that is sheared in its place."""
    shears = some([0, 0.1, 0.3, 1, 3, 10], quick)
    splats = cloud(400, degree=0)
    curves: Curves = {"axes found anew": [], "means alone sheared": []}
    for shear in shears:
        change = np.eye(4)
        change[0, 1] = shear
        slanted = outside(
            near=1e-3
        )  # no camera has such a pose, but the projection is linear in it
        object.__setattr__(slanted, "world_to_camera", slanted.world_to_camera @ change)
        expected = truth(splats, slanted)
        moved = replace(splats, positions=(splats.positions @ change[:3, :3].T).astype("f4"))
        curves["axes found anew"].append(
            decibels(shown(bench, _reshaped(moved, change[:3, :3]), outside(near=1e-3)), expected)
        )
        curves["means alone sheared"].append(
            decibels(shown(bench, moved, outside(near=1e-3)), expected)
        )
    return shears, curves


def _reshaped(splats: Splats, change: NDArray[np.float64]) -> Splats:
    """With the covariances M C M^T of a linear change (3, 3), as orientations and scales again."""
    axes = to_matrices(splats.orientations)
    roots = change @ axes * splats.scales.astype(np.float64)[:, None, :]
    axes, scales, _ = np.linalg.svd(roots)
    axes *= np.linalg.det(axes)[:, None, None]
    quaternions = np.array([_looking(turn).orientation for turn in axes])
    return replace(
        splats, orientations=quaternions.astype(np.float32), scales=scales.astype(np.float32)
    )


def _looking(turn: NDArray[np.float64]) -> Camera:
    """The camera that a rotation (3, 3) turns from looking along z."""
    pose = np.eye(4)
    pose[:3, :3] = turn.T
    return ahead(world_to_camera=pose)


def _mirrored_harmonics() -> NDArray[np.float64]:
    """(16,) 1 for harmonics even in x, -1 for odd ones."""
    direction = np.array([[0.3, 0.5, 0.81]])
    mirrored = direction * (-1, 1, 1)
    signs: NDArray[np.float64] = harmonics.basis(mirrored, 3)[0] / harmonics.basis(direction, 3)[0]
    return signs
