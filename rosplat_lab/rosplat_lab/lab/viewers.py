"""What another viewer makes of the same splats: a model after its public source.

RVizSplat 1.0.0 (Sorted, its defaults but all bands of harmonics): 8-bit base colours, bands above
along one direction for the whole picture, clamped at 0 and 1; covariances in half floats, without
the low-pass filter; splats fainter than 0.4 and fragments fainter than 0.05 left out, alpha up to
1. It blends by z. Not modelled: its orders of earlier frames, its target of 8 bits, and the samples
at its quads' edges.
"""

from __future__ import annotations

import numpy as np

from rosplat_core import harmonics
from rosplat_core.cameras import Camera
from rosplat_core.quaternions import to_matrices
from rosplat_core.splats import Splats
from rosplat_lab.reference.projection import Array, Projected, jacobians
from rosplat_lab.reference.renderer import blended


def rvizsplat(splats: Splats, camera: Camera, crop: tuple[int, int, int, int]) -> Array:
    """(height, width, 3) RGB over black of a crop; for perspective cameras."""
    projected = _projected(splats, camera)
    projected = projected[np.argsort(projected.depths, kind="stable")]
    return blended(projected, crop, min_alpha=0.05, max_alpha=1.0).rgba[..., :3]


def _projected(splats: Splats, camera: Camera) -> Projected:
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
    extents = np.sqrt(2 * np.log(1 / 0.05) * np.maximum(0, np.column_stack([xx, yy])))
    return Projected(
        slots=kept,
        centers=centers[kept],
        conics=np.column_stack([yy, -xy, xx]) / np.where(solid, determinant, 1)[:, None],
        tilts=np.zeros((len(kept), 2)),
        nearness=np.zeros(len(kept)),
        spots=np.full((len(kept), 2), np.nan),
        low=centers[kept] - extents,
        high=centers[kept] + extents,
        opacities=opacities,
        colors=np.clip(base / 255 + above, 0, 1),
        depths=means[:, 2],
        planes=np.zeros((len(kept), 2)),
        keys=means[:, 2],
        shares=np.ones(len(kept)),
    )[solid]
