"""Splats along rays, through any lens: brute force over all pairs of splats and rays.

For hundreds of splats. A ray's direction d is of any length; a splat has its mean m, axes and
standard deviations in the lens's frame.

Ray (3DGUT; Wu et al. 2025): in the splat's own frame, scaled to a unit ball by A, the line along
A d passes the middle at |A m x A d| / |A d|. Disc (2DGS; Huang et al. 2024): the ray meets the
plane of the first two axes; and a spot, whose middle is that of the outline at one deviation.
"""

from __future__ import annotations

import numpy as np

from rosplat_core import harmonics
from rosplat_core.cameras import Camera
from rosplat_core.models import Model
from rosplat_core.quaternions import to_matrices
from rosplat_core.splats import Splats
from rosplat_lab.reference.conics import SPOT
from rosplat_lab.reference.projection import MAX_ALPHA, MIN_ALPHA, Array


def rays_of(camera: Camera) -> Array:
    """(height, width, 3) rays of a pinhole camera's pixels, whose z is 1."""
    y, x = np.mgrid[: camera.height, : camera.width] + 0.5
    return np.stack(
        [(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, np.ones_like(x)], axis=-1
    )


def along_rays(
    splats: Splats,
    world_to_lens: Array,
    rays: Array,
    *,
    near: float = 0.01,
    behind: bool = False,
    camera: Camera | None = None,
) -> tuple[Array, Array]:
    """(..., 4) premultiplied RGBA and (..., ) mean depths along the lens's z of rays (..., 3).

    Splats count, and are ordered, by their depth along z. behind: by their distance, as for a lens
    that sees behind itself. camera: a pinhole camera whose pixels the rays are, for the spots of
    discs, and as pinhole pictures have what a ray's line meets behind the camera; without one,
    discs have no spots, and that doesn't count.
    """
    world = splats.positions.astype(np.float64) + splats.origin
    rotation = world_to_lens[:3, :3]
    means = world @ rotation.T + world_to_lens[:3, 3]
    axes = rotation @ to_matrices(splats.orientations)
    directions = means @ rotation
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    colors = harmonics.colors(splats.sh.astype(np.float64), directions)
    keys = np.linalg.norm(means, axis=1) if behind else means[:, 2]
    rgba, through = np.zeros((*rays.shape[:-1], 4)), np.ones(rays.shape[:-1])
    depth = np.zeros(rays.shape[:-1])
    for i in np.argsort(keys, kind="stable"):
        if keys[i] < near:
            continue
        distances, steps = _distances(
            splats.model, means[i], axes[i], splats.scales[i].astype(np.float64), rays
        )
        met = np.maximum(steps * rays[..., 2], 0)
        if camera is None:  # the largest response on the half line is at the lens
            to_ball = axes[i].T @ means[i] / splats.scales[i]
            within = np.inf if splats.model is Model.DISC else (to_ball**2).sum()
            distances = np.where(steps > 0, distances, within)
        if camera is not None and splats.model is Model.DISC:
            spot = _spot(means[i], axes[i], splats.scales[i].astype(np.float64), rays, camera)
            met = np.where(spot < distances, means[i, 2], met)
            distances = np.minimum(distances, spot)
        alpha = np.minimum(MAX_ALPHA, splats.opacities[i] * np.exp(-0.5 * distances))
        alpha = np.where(alpha >= MIN_ALPHA, alpha, 0)
        weight = through * alpha
        rgba += weight[..., None] * (*colors[i], 1)
        depth += np.where(weight > 0, weight * met, 0)
        through -= weight
    with np.errstate(invalid="ignore"):
        return rgba, depth / rgba[..., 3]


def _distances(
    model: Model, mean: Array, axes: Array, scales: Array, rays: Array
) -> tuple[Array, Array]:
    """Squared distances of rays from a mean, in standard deviations, and where, in rays."""
    if model is Model.DISC:
        normal = axes[:, 2]
        steps = normal @ mean / (rays @ normal)
        beside = rays * steps[..., None] - mean
        return ((beside @ axes[:, :2] / scales[:2]) ** 2).sum(-1), steps
    to_ball = axes.T / scales[:, None]
    along, middle = rays @ to_ball.T, to_ball @ mean
    square = (along**2).sum(-1)
    distances = (np.cross(middle, along) ** 2).sum(-1) / square
    return distances, along @ middle / square


def _spot(mean: Array, axes: Array, scales: Array, rays: Array, camera: Camera) -> Array:
    """Squared distances of pixels from the middle of a disc's spot, as _distances."""
    focal, centre = np.array([camera.fx, camera.fy]), np.array([camera.cx, camera.cy])
    flat = axes[:, :2] * scales[:2]
    dual = np.outer(mean, mean) - flat @ flat.T  # of the outline at one deviation
    spot = dual[:2, 2] / dual[2, 2] * focal + centre
    pixels = rays[..., :2] / rays[..., 2:] * focal + centre
    squares: Array = SPOT * ((pixels - spot) ** 2).sum(-1)
    return squares
