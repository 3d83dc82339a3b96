"""Projection of 3D Gaussians to the picture by each of the models.

EWA: Zwicker et al. 2001, Kerbl et al. 2023; rays: Wu et al. 2025 (3DGUT); discs: Huang et al. 2024
(2DGS). conics.py has what the latter two share. EWA is also projected by a lens: gsplat's fisheye.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from rosplat_core import harmonics
from rosplat_core.cameras import Camera
from rosplat_core.lenses import Lens
from rosplat_core.models import Model
from rosplat_core.quaternions import to_matrices
from rosplat_core.splats import LOW_PASS, Splats
from rosplat_lab.reference.conics import SPOT, Conics

Array = NDArray[np.float64]

MIN_ALPHA = 1 / 255  # what is fainter is not drawn
MAX_ALPHA = 0.999  # a splat's, as in gsplat; INRIA's is 0.99
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
    tilts: Array
    """(m, 2) and nearness (m,): as in Conics; 0 of EWA. [1/px]"""
    nearness: Array
    spots: Array
    """(m, 2) x, y of discs' spots; NaN of others. [px]"""
    low: Array
    """(m, 2) and high (m, 2): the box outside of which alpha is below MIN_ALPHA. [px]"""
    high: Array
    opacities: Array
    """(m,) peak opacities."""
    colors: Array
    """(m, 3) RGB, 0 or more."""
    depths: Array
    """(m,) z in the camera. [m]"""
    planes: Array
    """(m, 2) by which the depth that is expected of EWA grows in the picture. [m/px]"""
    keys: Array
    """(m,) by which they are ordered: depths, or distances. [m]"""
    shares: Array
    """(m,) how much of each is drawn: 1 - (1 - alpha)^share."""

    def __getitem__(self, index: NDArray[np.intp] | NDArray[np.bool_]) -> Projected:
        """The splats that an index array or a mask picks, in its order."""
        return Projected(*(getattr(self, field.name)[index] for field in fields(self)))


def project(
    splats: Splats,
    camera: Camera,
    shares: Array | None = None,
    *,
    lens: Lens | None = None,
    by_distance: bool = False,
) -> Projected:
    """Projects splats and leaves out those that no pixel of the picture can see.

    shares: (n,) how much of each is drawn, 1 if not given. lens: what projects EWA in the camera's
    place, which has its pose and clips. by_distance: clips and order are, not by depth.
    """
    world = splats.positions.astype(np.float64) + splats.origin
    rotation, translation = camera.world_to_camera[:3, :3], camera.world_to_camera[:3, 3]
    means = world @ rotation.T + translation
    keys = np.linalg.norm(means, axis=1) if by_distance else means[:, 2]
    slots = np.flatnonzero((keys >= camera.near) & (keys <= camera.far))
    seen, world, means, keys = splats[slots], world[slots], means[slots], keys[slots]

    opacities = seen.opacities.astype(np.float64)
    ewa = splats.model in (Model.EWA, Model.EWA_ANTIALIASED)
    rows = _rows(seen, means, camera, lens, clamped=ewa)
    conics, planes = Conics.of(rows), np.zeros((len(means), 2))
    if ewa:
        sharp = np.linalg.det(conics.covariances)
        filtered = conics.covariances + LOW_PASS * np.eye(2)
        conics = _flat(filtered)
        # The depth that is expected, given the place in the picture.
        rise = np.einsum("nik,nk->ni", rows[:, :2], _deep(seen, camera))
        planes = np.linalg.solve(filtered, rise[..., None])[..., 0]
        if splats.model is Model.EWA_ANTIALIASED:  # what the filter spreads out, it must not add
            opacities *= np.sqrt(np.maximum(0, sharp / np.linalg.det(filtered)))
    determinant = np.linalg.det(conics.covariances)
    xx, xy, yy = (conics.covariances[:, i, k] for i, k in ((0, 0), (0, 1), (1, 1)))
    if not ewa:
        determinant = np.maximum(determinant, 1e-30)

    cut2 = 2 * np.log(np.maximum(1, opacities / MIN_ALPHA))
    scale = 1.0 if camera.orthographic else means[:, 2:]
    centers = means[:, :2] / scale * (camera.fx, camera.fy) + (camera.cx, camera.cy)
    if lens is not None:
        centers = lens.project(means) + 0.5  # NaN where it images nothing
    middles, halves = conics.outlines(cut2)
    low, high = centers + middles - halves, centers + middles + halves
    spots = np.full_like(centers, np.nan)
    if splats.model is Model.DISC:
        spots = centers + conics.spots()
        reach = np.sqrt(cut2 / SPOT)[:, None]
        low, high = np.minimum(low, spots - reach), np.maximum(high, spots + reach)
    inside = (high > 0).all(axis=1) & (low < (camera.width, camera.height)).all(axis=1)
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
        tilts=conics.tilts[inside],
        nearness=conics.nearness[inside],
        spots=spots[inside],
        low=low[inside],
        high=high[inside],
        opacities=opacities[inside],
        colors=harmonics.colors(seen.sh[inside].astype(np.float64), directions[inside]),
        depths=means[inside, 2],
        planes=planes[inside],
        keys=keys[inside],
        shares=np.ones(inside.sum()) if shares is None else shares[slots][inside],
    )


def _flat(covariances: Array) -> Conics:
    """Ellipses in the picture (n, 2, 2) [px^2] as conics."""
    n = len(covariances)
    return Conics(covariances, np.zeros((n, 2)), np.zeros(n), np.zeros((n, 2)), np.zeros(n))


def _deep(splats: Splats, camera: Camera) -> Array:
    """(n, 3) how far a standard deviation along each axis leads along the camera's z. [m]"""
    axes = camera.world_to_camera[2, :3] @ to_matrices(splats.orientations)
    return axes * splats.scales.astype(np.float64)


def _rows(
    splats: Splats, means: Array, camera: Camera, lens: Lens | None, *, clamped: bool
) -> Array:
    """(n, 3, 3) the rows right, down [px] and ahead of views/conic.hpp.

    clamped: with tangents that stop growing beyond the picture, as EWA is trained.
    """
    axes = to_matrices(splats.orientations)
    scales = splats.scales.astype(np.float64)
    if splats.model is Model.DISC:
        scales = scales * (1, 1, 0)
    axes = camera.world_to_camera[:3, :3] @ (axes * scales[:, None, :])
    flat = jacobians(means, camera, GUARD_BAND if clamped else np.inf) @ axes
    if lens is not None:
        flat = _jacobians_of(lens, means) @ axes
    ahead = np.zeros_like(axes[:, 2:]) if camera.orthographic else axes[:, 2:] / means[:, 2:, None]
    return np.concatenate([flat, ahead], axis=1)


def _jacobians_of(lens: Lens, means: Array) -> Array:
    """(n, 2, 3) derivatives of a lens's x, y [px] by the mean (n, 3) [m], by differences."""
    steps = 1e-5 * np.linalg.norm(means, axis=1)
    columns = []
    for axis in np.eye(3):
        beside = steps[:, None] * axis
        rise = lens.project(means + beside) - lens.project(means - beside)
        columns.append(rise / (2 * steps[:, None]))
    jacobians: Array = np.nan_to_num(np.stack(columns, axis=-1))
    return jacobians


def jacobians(means: Array, camera: Camera, guard_band: float = GUARD_BAND) -> Array:
    """(n, 2, 3) derivatives of the picture's x, y [px] by the mean (n, 3) in the camera [m].

    Tangents are clamped a guard band [tan(fov / 2)] beyond the picture.
    """
    jacobians = np.zeros((len(means), 2, 3))
    if camera.orthographic:
        jacobians[:, 0, 0], jacobians[:, 1, 1] = camera.fx, camera.fy
        return jacobians
    z = means[:, 2]
    for axis, (focal, center, size) in enumerate(
        [(camera.fx, camera.cx, camera.width), (camera.fy, camera.cy, camera.height)]
    ):
        guard = guard_band * 0.5 * size / focal
        tangent = np.clip(
            means[:, axis] / z, -center / focal - guard, (size - center) / focal + guard
        )
        jacobians[:, axis, axis] = focal / z
        jacobians[:, axis, 2] = -focal * tangent / z
    return jacobians
