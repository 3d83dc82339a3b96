"""Spherical harmonics: an orthonormal basis, in Kerbl's signs."""

import numpy as np

from rosplat_core import harmonics
from rosplat_core.quaternions import to_matrices


def test_they_are_orthonormal() -> None:
    cosines, weights = np.polynomial.legendre.leggauss(8)
    angles = np.arange(16) * np.pi / 8
    z = np.repeat(cosines, 16)
    ring = np.sqrt(1 - z**2)
    directions = np.column_stack(
        [ring * np.tile(np.cos(angles), 8), ring * np.tile(np.sin(angles), 8), z]
    )
    values = harmonics.basis(directions, 3)
    gram = (values * np.repeat(weights, 16)[:, None] * np.pi / 8).T @ values
    np.testing.assert_allclose(gram, np.eye(16), atol=1e-12)
    for degree in range(3):
        k = (degree + 1) ** 2
        np.testing.assert_array_equal(harmonics.basis(directions, degree), values[:, :k])


def test_colors_turn_with_the_view() -> None:
    """Degree 1 in Kerbl's signs: -y, z, -x."""
    sh = np.zeros((3, 4, 3))
    sh[:, 1:] = np.eye(3)  # red by y, green by z, blue by x
    colors = harmonics.colors(sh, np.array([[0, -1, 0], [0, 0, 1], [-1, 0, 0]], np.float64))
    np.testing.assert_allclose(colors, 0.5 + harmonics.C1 * np.eye(3))


def test_turned_coefficients_have_the_colours_of_directions_turned_back() -> None:
    random = np.random.default_rng(0)
    directions = random.normal(size=(50, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    rotation = to_matrices(random.normal(size=4))
    for degree in range(4):
        sh = random.normal(size=(50, (degree + 1) ** 2, 3)).astype(np.float32)
        turned = harmonics.turned(sh, rotation)
        assert turned.dtype == np.float32
        np.testing.assert_allclose(
            harmonics.colors(turned, directions),
            harmonics.colors(sh, directions @ rotation),
            atol=2e-6,
        )
