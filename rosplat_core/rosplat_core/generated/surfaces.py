"""The means of generated scenes: flat splats on surfaces, their shine, and noise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from rosplat_core import harmonics
from rosplat_core.quaternions import from_matrices

Array = NDArray[np.float64]
Numbers = NDArray[np.intp]

GOLDEN = (5**0.5 - 1) / 2


@dataclass(frozen=True)
class Patch:
    """Splats of one surface: where they lie, how they are turned, and how they shine."""

    points: Array  # (n, 3)
    tangents: Array  # (n, 3) unit, along the longer axis
    normals: Array  # (n, 3) unit
    scales: Array  # (n, 3) along tangent, across, normal
    opacities: Array  # (n,)
    sh: Array  # (n, 16, 3)


Part = tuple[float, Callable[[Numbers, int], Patch]]
"""A thing's share of a scene's splats, and a function that makes some, by numbers and the total."""


def surface(
    points: Array,
    tangents: Array,
    normals: Array,
    spacing: Array | float,
    sh: Array,
    stretch: float,
) -> Patch:
    """Flat splats that just close a surface on which they lie spacing apart. [m]"""
    width = np.broadcast_to(0.62 * np.asarray(spacing), len(points))[:, None]
    scales = width * np.array([stretch**0.5, stretch**-0.5, 0.12])
    return Patch(points, tangents, normals, scales, np.full(len(points), 0.96), sh)


def unit(vectors: Array) -> Array:
    unit: Array = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    return unit


def quaternions(tangents: Array, normals: Array) -> Array:
    """(n, 4) x, y, z, w of rotations that take x to the tangent and z to the normal."""
    x = unit(tangents - normals * (tangents * normals).sum(axis=1, keepdims=True))
    return from_matrices(np.stack([x, np.cross(normals, x), normals], axis=2))


def constant(color: Array) -> Array:
    """(n, 16, 3) harmonics that look like color (n, 3) from everywhere."""
    sh = np.zeros((len(color), 16, 3))
    sh[:, 0] = (color - 0.5) / harmonics.C0
    return sh


def zonal(axes: Array, profile: Array) -> Array:
    """(n, 16, 3) harmonics of a function of the angle to axes (n, 3).

    profile (n or 1, 4, 3) are its Legendre coefficients for the cosine of that angle (the addition
    theorem turns each into a band).
    """
    bands = np.repeat(np.arange(4), [1, 3, 5, 7])
    weights = (4 * np.pi / (2 * bands + 1))[:, None] * profile[:, bands]
    return harmonics.basis(axes, 3)[:, :, None] * weights


def legendre_coefficients(function: Callable[[Array], Array]) -> Array:
    """(4,) Legendre coefficients of a function on -1 to 1, tapered so that they don't ring."""
    x, weights = legendre.leggauss(64)
    taper = np.array([1, 0.95, 0.8, 0.55])
    polynomials = legendre.legvander(x, 3)
    return taper * (2 * np.arange(4) + 1) / 2 * (polynomials.T @ (weights * function(x)))


def highlight(normals: Array, light: Array, color: Array, sharpness: float) -> Array:
    """(n, 16, 3) a light's reflection, of color (n, 3), in a surface that isn't quite smooth.

    light (3,) or (n, 3) are unit vectors towards it.
    """
    cosine = (normals * light).sum(axis=1)[:, None]
    mirrored = 2 * cosine * normals - light
    lobe = legendre_coefficients(lambda x: np.exp(sharpness * (x - 1)))
    facing = np.clip(3 * cosine + 0.3, 0, 1)
    return zonal(-mirrored, lobe[:, None] * (facing * color)[:, None, :])


class Noise:
    """Smooth noise in space: a sum of plane waves, from coarse to fine."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._waves = [  # directions, phases, weight
            (rng.normal(size=(6, 3)) * frequency, rng.uniform(0, 2 * np.pi, 6), 1 / frequency**0.7)
            for frequency in (2.5, 6.0, 14.0, 33.0)
        ]

    def at(self, points: Array) -> Array:
        """(n,) values, about -1 to 1, at points (n, 3)."""
        value = np.zeros(len(points))
        for directions, phases, weight in self._waves:
            value += weight * np.sin(points @ directions.T + phases).mean(axis=1)
        return 2.2 * value
