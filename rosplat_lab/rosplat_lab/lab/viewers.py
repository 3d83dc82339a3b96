"""What other viewers make of the same splats: models after their public sources.

RVizSplat 1.0.0 (Sorted, its defaults but all bands of harmonics): 8-bit base colours, bands above
along one direction for the whole picture, clamped at 0 and 1; covariances in half floats, without
the low-pass filter; splats fainter than 0.4 and fragments fainter than 0.05 left out, alpha up to
1.
shadygm/ROSplat (8eb76fc): quads as wide and high as 3 sigma; colours raised to 1/2.2 before they
are blended. Both blend back to front, by z, in RGBA8. Not modelled: RVizSplat's orders of earlier
frames, and the samples at its quads' edges.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rosplat_core import harmonics
from rosplat_core.cameras import Camera
from rosplat_core.quaternions import to_matrices
from rosplat_core.splats import Splats
from rosplat_lab.lab import fragments
from rosplat_lab.reference.projection import (
    Array,
    Projected,
    jacobians,
    project,
)

GAMMA = 2.2


def rvizsplat(splats: Splats, camera: Camera) -> Array:
    """(height, width, 3) RGB over black; for perspective cameras."""
    return fragments.blended(
        fragments.nearest_first(_rvizsplat(splats, camera)), camera, fragments.rounded(255),
        alphas=fragments.Alphas(least=0.05, most=1.0),
    )  # fmt: skip


def _rvizsplat(splats: Splats, camera: Camera) -> Projected:
    world = splats.positions.astype(np.float64) + splats.origin
    rotation, translation = camera.world_to_camera[:3, :3], camera.world_to_camera[:3, 3]
    means = world @ rotation.T + translation
    with np.errstate(divide="ignore", invalid="ignore"):
        centers = means[:, :2] / means[:, 2:] * (camera.fx, camera.fy) + (camera.cx, camera.cy)
        reach = np.abs(2 * centers / (camera.width, camera.height) - 1).max(axis=1)
    opacities = np.rint(255 * splats.opacities.astype(np.float64)) / 255
    kept = np.flatnonzero((means[:, 2] > camera.near) & (reach < 1.2) & (opacities >= 0.4))

    splats, means, opacities = splats[kept], means[kept], opacities[kept]
    axes = to_matrices(splats.orientations)
    axes *= splats.scales.astype(np.float64)[:, None, :]
    covariances = (axes @ axes.transpose(0, 2, 1)).astype(np.float16).astype(np.float64)
    half = jacobians(means, camera) @ rotation
    flat = half @ covariances @ half.transpose(0, 2, 1)
    xx, xy, yy = flat[:, 0, 0], flat[:, 0, 1], flat[:, 1, 1]
    determinant = xx * yy - xy * xy
    solid = determinant > 0

    base = np.rint(255 * np.clip(harmonics.C0 * splats.sh[:, 0].astype(np.float64) + 0.5, 0, 1))
    basis = harmonics.basis(rotation[2:], splats.sh_degree)[0, 1:]
    above = np.einsum("k,nkc->nc", basis, splats.sh[:, 1:].astype(np.float64))
    return Projected(
        slots=kept,
        centers=centers[kept],
        conics=np.column_stack([yy, -xy, xx]) / np.where(solid, determinant, 1)[:, None],
        extents=np.sqrt(2 * np.log(1 / 0.05) * np.maximum(0, np.column_stack([xx, yy]))),
        opacities=opacities,
        colors=np.clip(base / 255 + above, 0, 1),
        depths=means[:, 2],
        shares=np.ones(len(kept)),
    )[solid]


def shadygm(splats: Splats, camera: Camera, gamma: float = GAMMA) -> Array:
    """(height, width, 3) RGB over black, as shadygm/ROSplat draws; gamma 1 leaves colours alone."""
    projected = fragments.nearest_first(project(splats, camera))
    reach = np.abs(2 * projected.centers / (camera.width, camera.height) - 1).max(axis=1)
    projected = projected[reach <= 1.3]
    xx, xy, yy = projected.conics.T
    sigmas = np.sqrt(np.column_stack([yy, xx]) / (xx * yy - xy * xy)[:, None])
    return fragments.blended(
        replace(
            projected,
            extents=np.minimum(projected.extents, 3 * sigmas),
            colors=np.minimum(1, projected.colors) ** (1 / gamma),
        ),
        camera, fragments.rounded(255),
    )  # fmt: skip
