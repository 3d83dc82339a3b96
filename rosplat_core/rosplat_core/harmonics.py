"""Real spherical harmonics to degree 3, in the order and sign of Kerbl et al. 2023."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

C0 = 0.28209479177387814
C1 = 0.4886025119029199
C2 = (1.0925484305920792, 0.31539156525252005, 0.5462742152960396)
C3 = (0.5900435899266435, 2.890611442640554, 0.4570457994644658, 0.3731763325901154)


def basis(directions: Array, degree: int) -> Array:
    """(n, (degree + 1)^2) values of the harmonics at unit directions (n, 3)."""
    x, y, z = directions.T
    values = [np.full_like(x, C0)]
    if degree >= 1:
        values += [-C1 * y, C1 * z, -C1 * x]
    if degree >= 2:
        values += [
            C2[0] * x * y,
            -C2[0] * y * z,
            C2[1] * (2 * z**2 - x**2 - y**2),
            -C2[0] * x * z,
            C2[2] * (x**2 - y**2),
        ]
    if degree >= 3:
        values += [
            -C3[0] * y * (3 * x**2 - y**2),
            C3[1] * x * y * z,
            -C3[2] * y * (4 * z**2 - x**2 - y**2),
            C3[3] * z * (2 * z**2 - 3 * x**2 - 3 * y**2),
            -C3[2] * x * (4 * z**2 - x**2 - y**2),
            C3[1] / 2 * z * (x**2 - y**2),
            -C3[0] * x * (x**2 - 3 * y**2),
        ]
    return np.stack(values, axis=1)


def turned(sh: NDArray[np.float32], rotation: Array) -> NDArray[np.float32]:
    """Coefficients (n, k, 3) of the same colours, turned by a rotation (3, 3).

    Works band by band, as a rotation mixes no two bands. Ivanic and Ruedenberg 1996 give the
    matrices in closed form; here they are solved for, by least squares from 32 directions.
    """
    degree = round(sh.shape[1] ** 0.5) - 1
    directions = np.random.default_rng(0).normal(size=(32, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    before, after = basis(directions @ rotation, degree), basis(directions, degree)
    result = sh.copy()
    for band in range(1, degree + 1):
        own = slice(band**2, (band + 1) ** 2)
        matrix = np.linalg.lstsq(after[:, own], before[:, own], rcond=None)[0]
        bands = np.tensordot(sh[:, own], matrix.astype(np.float32), axes=(1, 1))
        result[:, own] = bands.transpose(0, 2, 1)
    return result


def colors(sh: Array, directions: Array) -> Array:
    """(n, 3) colours of coefficients (n, k, 3) seen along unit directions (n, 3).

    Clamped at 0 only: the training never clamps bright colours before they are blended.
    """
    degree = round(sh.shape[1] ** 0.5) - 1
    rgb: Array = np.maximum(0, 0.5 + np.einsum("nk,nkc->nc", basis(directions, degree), sh))
    return rgb
