"""Splats along rays: a picture of Gaussians without linearising the projection.

Each pixel's ray takes the largest density that it meets of each splat (Moenne-Loccoz et al. 2024,
Wu et al. 2025: 3DGRT, 3DGUT), where EWA splatting draws the ellipse of a first-order approximation.
Brute force over all pairs of splats and pixels, for hundreds of splats.
"""

from __future__ import annotations

import numpy as np

from rosplat_core import harmonics
from rosplat_core.cameras import Camera
from rosplat_core.quaternions import to_matrices
from rosplat_core.splats import Splats
from rosplat_lab.reference.projection import MIN_ALPHA, Array


def picture(splats: Splats, camera: Camera) -> Array:
    """(height, width, 3) RGB over black, by z of the means, without a low-pass filter.

    For perspective cameras. In a splat's own frame, scaled to a unit ball, the ray from o along d
    passes the middle at |o x d| / |d|.
    """
    world = splats.positions.astype(np.float64) + splats.origin
    depths = (world - camera.position) @ camera.world_to_camera[2, :3]
    seen = np.flatnonzero(depths > camera.near)
    seen = seen[np.argsort(depths[seen], kind="stable")]
    directions = world[seen] - camera.position
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    colors = harmonics.colors(splats.sh[seen].astype(np.float64), directions)
    y, x = np.mgrid[: camera.height, : camera.width] + 0.5
    rays = np.stack([(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, np.ones_like(x)], -1)
    rays = rays @ camera.world_to_camera[:3, :3]
    rgb = np.zeros((camera.height, camera.width, 3))
    through = np.ones((camera.height, camera.width, 1))
    axes = to_matrices(splats.orientations[seen])
    axes /= splats.scales[seen].astype(np.float64)[:, None, :]
    for index, slot in enumerate(seen):
        origin = (camera.position - world[slot]) @ axes[index]
        along = rays @ axes[index]
        square = (np.cross(origin, along) ** 2).sum(-1) / (along**2).sum(-1)
        # A splat whose peak on the ray is behind the camera is left out.
        ahead = along @ origin < 0
        alpha = splats.opacities[slot] * np.exp(-0.5 * square) * ahead
        alpha = np.where(alpha >= MIN_ALPHA, np.minimum(alpha, 0.99), 0)[..., None]
        rgb += through * alpha * colors[index]
        through *= 1 - alpha
    return rgb
