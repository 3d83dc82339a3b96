"""EWA projection of 3D Gaussians to the picture (Zwicker et al. 2001, Kerbl et al. 2023)."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from rosplat_core import harmonics
from rosplat_core.cameras import Camera
from rosplat_core.quaternions import to_matrices
from rosplat_core.splats import LOW_PASS, Splats

Array = NDArray[np.float64]

MIN_ALPHA = 1 / 255  # what is fainter is not drawn
GUARD_BAND = 0.3  # of tan(fov / 2) beyond the picture, where the Jacobian stops growing


@dataclass(frozen=True)
class Projected:
    """The m splats that reach the picture, as a camera sees them."""

    slots: NDArray[np.intp]
    """(m,) indices of the splats."""
    centers: Array
    """(m, 2) x, y in the picture. [px]"""
    conics: Array
    """(m, 3) xx, xy, yy of the inverse 2D covariance. [1/px^2]"""
    extents: Array
    """(m, 2) half size of the box outside of which alpha is below MIN_ALPHA. [px]"""
    opacities: Array
    """(m,) peak opacities."""
    colors: Array
    """(m, 3) RGB, 0 or more."""
    depths: Array
    """(m,) z in the camera. [m]"""
    shares: Array
    """(m,) how much of each is drawn: 1 - (1 - alpha)^share."""

    def __getitem__(self, index: NDArray[np.intp] | NDArray[np.bool_]) -> Projected:
        """The splats that an index array or a mask picks, in its order."""
        return Projected(*(getattr(self, field.name)[index] for field in fields(self)))


def project(splats: Splats, camera: Camera, shares: Array | None = None) -> Projected:
    """Projects splats and leaves out those that no pixel of the picture can see.

    shares: (n,) how much of each is drawn, 1 if not given.
    """
    world = splats.positions.astype(np.float64) + splats.origin
    rotation, translation = camera.world_to_camera[:3, :3], camera.world_to_camera[:3, 3]
    depths = world @ rotation[2] + translation[2]
    slots = np.flatnonzero((depths >= camera.near) & (depths <= camera.far))
    seen, world = splats[slots], world[slots]
    means = world @ rotation.T + translation

    covariance = _covariances_2d(seen, means, camera)
    sharp = np.linalg.det(covariance)
    covariance[:, [0, 1], [0, 1]] += LOW_PASS
    determinant = np.linalg.det(covariance)
    opacities = seen.opacities.astype(np.float64)
    if splats.antialiased:  # what the filter spreads out, it must not add (Mip-Splatting)
        opacities *= np.sqrt(np.maximum(0, sharp / determinant))

    xx, xy, yy = covariance[:, 0, 0], covariance[:, 0, 1], covariance[:, 1, 1]
    sigmas = np.sqrt(2 * np.log(np.maximum(1, opacities / MIN_ALPHA)))
    extents = sigmas[:, None] * np.sqrt(np.column_stack([xx, yy]))
    scale = 1.0 if camera.orthographic else means[:, 2:]
    centers = means[:, :2] / scale * (camera.fx, camera.fy) + (camera.cx, camera.cy)
    inside = (centers + extents > 0).all(axis=1)
    inside &= (centers - extents < (camera.width, camera.height)).all(axis=1)
    inside &= (opacities >= MIN_ALPHA) & (determinant > 0)

    if camera.orthographic:  # all rays are parallel
        directions = np.broadcast_to(rotation[2], world.shape)
    else:
        directions = world - camera.position
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return Projected(
        slots=slots[inside],
        centers=centers[inside],
        conics=(np.column_stack([yy, -xy, xx]) / determinant[:, None])[inside],
        extents=extents[inside],
        opacities=opacities[inside],
        colors=harmonics.colors(seen.sh[inside].astype(np.float64), directions[inside]),
        depths=means[inside, 2],
        shares=np.ones(inside.sum()) if shares is None else shares[slots][inside],
    )


def _covariances_2d(splats: Splats, means: Array, camera: Camera) -> Array:
    """(n, 2, 2) covariances in the picture, J W R S S^T R^T W^T J^T. [px^2]"""
    axes = to_matrices(splats.orientations)
    axes *= splats.scales.astype(np.float64)[:, None, :]
    half = jacobians(means, camera) @ camera.world_to_camera[:3, :3] @ axes
    product: Array = half @ half.transpose(0, 2, 1)
    return product


def jacobians(means: Array, camera: Camera) -> Array:
    """(n, 2, 3) derivatives of the picture's x, y [px] by the mean (n, 3) in the camera [m]."""
    jacobians = np.zeros((len(means), 2, 3))
    if camera.orthographic:
        jacobians[:, 0, 0], jacobians[:, 1, 1] = camera.fx, camera.fy
        return jacobians
    z = means[:, 2]
    for axis, (focal, center, size) in enumerate(
        [(camera.fx, camera.cx, camera.width), (camera.fy, camera.cy, camera.height)]
    ):
        guard = GUARD_BAND * 0.5 * size / focal
        tangent = np.clip(
            means[:, axis] / z, -center / focal - guard, (size - center) / focal + guard
        )
        jacobians[:, axis, axis] = focal / z
        jacobians[:, axis, 2] = -focal * tangent / z
    return jacobians
