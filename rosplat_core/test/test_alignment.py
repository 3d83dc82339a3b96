"""Poses found again by pictures, and the equations of a step against float64 and differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from rosplat_core import align
from rosplat_core.alignment import BIWEIGHT, CAUCHY, Alignment, MapPixels, _Level, motion
from rosplat_core.cameras import Camera, look_at, orbit, place
from rosplat_core.generated import generate
from rosplat_core.quaternions import from_matrices
from rosplat_core.rendering import CpuRenderer

SPLATS = generate(20_000, seed=3)
RADIUS = place(SPLATS).radius
MAP = CpuRenderer(SPLATS)
BOUNDS = np.array([[-1.5, -1.5, 0], [1.5, 1.5, 1]])
VIEWS = orbit(BOUNDS, 8, width=320, height=180)


def moved(camera: Camera, degrees: float, percent: float, seed: int) -> Camera:
    """Off by so much, in directions of any kind; percent: of the map's radius."""
    along, about = np.random.default_rng(seed).normal(size=(2, 3))
    along *= percent / 100 * RADIUS / np.linalg.norm(along)
    about *= np.radians(degrees) / np.linalg.norm(about)
    pose = camera.camera_to_world @ motion([*along, *about])
    return replace(camera, world_to_camera=np.linalg.inv(pose))


def taken(camera: Camera, noise: float = 0.01, seed: int = 0) -> NDArray[np.uint8]:
    """A camera's picture, with an exposure and noise of its own."""
    exposed = 0.8 * MAP.render(camera)[..., :3] + 0.05
    noisy = exposed + np.random.default_rng(seed).normal(scale=noise, size=exposed.shape)
    return (255 * np.clip(noisy, 0, 1) + 0.5).astype(np.uint8)


def off(found: Alignment, camera: Camera) -> NDArray[np.float64]:
    """(6,) position [m] and rotation [rad] about the map's axes that are too much."""
    pose = np.linalg.inv(found.world_to_camera)
    turn = from_matrices(pose[:3, :3] @ camera.camera_to_world[:3, :3].T)
    small = 2 * turn[:3] * np.sign(turn[3])
    return np.concatenate([pose[:3, 3] - camera.position, small])


@pytest.mark.parametrize("number", range(len(VIEWS)))
def test_a_pose_is_found_again(number: int) -> None:
    camera = VIEWS[number]
    found = align(MAP, taken(camera, seed=number), moved(camera, 3, 5, number))
    assert found.converged and found.problem == ""
    error = off(found, camera)
    assert np.degrees(np.linalg.norm(error[3:])) < 0.05
    assert np.linalg.norm(error[:3]) < 1e-3 * RADIUS
    np.testing.assert_allclose(found.gain, 0.8, atol=0.02)
    np.testing.assert_allclose(found.bias, 0.05, atol=0.01)
    assert found.residual < 0.02 and found.explained > 0.9


def test_large_pictures_are_reduced() -> None:
    (camera,) = orbit(BOUNDS, 1, width=1281, height=723)
    found = align(MAP, taken(camera), moved(camera, 3, 5, 1))
    assert found.converged and np.linalg.norm(off(found, camera)[:3]) < 1e-3 * RADIUS


@pytest.mark.parametrize("noise", [0.004, 0.03])
def test_the_covariance_is_that_of_the_errors(noise: float) -> None:
    """Squares of errors by it are of chi-squared's distribution of 6 degrees of freedom."""
    squares = []
    for seed in range(24):
        camera = VIEWS[seed % len(VIEWS)]
        found = align(MAP, taken(camera, noise, seed), moved(camera, 0.3, 0.5, seed))
        np.testing.assert_allclose(found.covariance, found.covariance.T, rtol=1e-9)
        error = off(found, camera)
        squares.append(error @ np.linalg.solve(found.covariance, error))
    assert 4 < np.mean(squares) < 8  # 6
    assert 3.5 < np.median(squares) < 7.5  # 5.3
    assert 7 < np.quantile(squares, 0.9) < 15  # 10.6


def test_what_a_mask_leaves_out_does_not_count() -> None:
    camera, mask = VIEWS[0], np.ones((180, 320), bool)
    mask[60:140, 120:200] = False
    start, covered = moved(camera, 1, 2, 5), taken(camera)
    found = []
    for colour in ((255, 0, 255), (0, 255, 0)):
        covered[~mask] = colour
        found.append(align(MAP, covered, start, mask))
    assert found[0].converged and np.linalg.norm(off(found[0], camera)[:3]) < 1e-3 * RADIUS
    np.testing.assert_array_equal(found[0].world_to_camera, found[1].world_to_camera)


def test_what_moves_in_front_counts_little() -> None:
    camera, covered = VIEWS[2], taken(VIEWS[2])
    covered[70:110, 130:190] = (255, 0, 255)
    found = align(MAP, covered, moved(camera, 1, 2, 5))
    assert found.converged and np.linalg.norm(off(found, camera)[:3]) < 1e-3 * RADIUS


@pytest.mark.parametrize(
    ("picture", "camera", "problem"),
    [
        (taken(VIEWS[0]), replace(VIEWS[0], world_to_camera=look_at((9, 9, 9), (20, 20, 20))),
         "the map shows 0 pixels"),
        (np.full((180, 320, 3), 90, np.uint8), VIEWS[0], ""),
        (np.random.default_rng(0).integers(0, 255, (180, 320, 3), np.uint8), VIEWS[0], ""),
        (taken(VIEWS[4])[::-1], VIEWS[0], ""),
        (taken(VIEWS[0]) ^ np.uint8([255, 0, 0]), VIEWS[0],
         "no exposure has gains of -0.80, 0.80 and 0.80"),
        (np.full((180, 320, 3), np.nan), VIEWS[0], "too little in common"),
    ],
)  # fmt: skip
def test_a_picture_of_something_else_is_none_to_align(
    picture: NDArray[np.generic], camera: Camera, problem: str
) -> None:
    found = align(MAP, picture, camera)
    assert not found.converged and found.problem and problem in found.problem
    assert np.isfinite(found.world_to_camera).all() and not np.isnan(found.covariance).any()


def test_what_cannot_be_aligned_names_the_argument() -> None:
    camera = VIEWS[0]
    with pytest.raises(ValueError, match=r"^picture: expected an array \(180, 320, 3\)"):
        align(SPLATS, np.zeros((180, 321, 3)), camera)
    with pytest.raises(ValueError, match=r"^mask: expected an array \(180, 320\)"):
        align(SPLATS, np.zeros((180, 320, 3)), camera, np.ones((2, 2), bool))
    with pytest.raises(ValueError, match="orthographic"):
        align(SPLATS, np.zeros((180, 320, 3)), replace(camera, orthographic=True))


# --- The equations --------------------------------------------------------------------------------

CAMERA = Camera(0, 24, 18, 30.0, 28.0, 12.5, 8.0, np.eye(4))
EXPOSURE = np.array([[0.9, 0.02], [1.1, -0.01], [1.0, 0.05]])
MOVE = motion([0.02, -0.01, 0.03, 0.004, -0.006, 0.01])
DEVIATION = 0.02


def ramp(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    """(..., 3) A picture whose gradients are the same everywhere."""
    return np.stack([0.3 + 0.01 * x, 0.2 + 0.02 * y, 0.5 + 0.005 * x - 0.01 * y], axis=-1)


def residuals(
    step: NDArray[np.float64], drawn: dict[str, NDArray[np.float32]]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Plain float64: errors (n, 3) of pixels after a step, and their places (n, 2)."""
    depth = drawn["depth"][..., 0].astype(np.float64)
    down, across = np.mgrid[0 : CAMERA.height, 0 : CAMERA.width]
    rays = np.stack(
        [(across + 0.5 - CAMERA.cx) / CAMERA.fx, (down + 0.5 - CAMERA.cy) / CAMERA.fy,
         np.ones_like(depth), 1 / depth], axis=-1,
    )  # fmt: skip
    points = (rays * depth[..., None]).reshape(-1, 4) @ np.linalg.inv(MOVE @ motion(step[:6])).T
    x = CAMERA.fx * points[:, 0] / points[:, 2] + CAMERA.cx - 0.5
    y = CAMERA.fy * points[:, 1] / points[:, 2] + CAMERA.cy - 0.5
    gain, bias = (EXPOSURE + step[6:].reshape(3, 2)).T
    ours = drawn["colour"][..., :3].reshape(-1, 3).astype(np.float64)
    return gain * ours + bias - ramp(x, y), np.stack([x, y], axis=-1)


@pytest.mark.parametrize("cut", [False, True])
def test_equations_are_those_of_float64_and_differences(cut: bool) -> None:
    rng = np.random.default_rng(1)
    shape = CAMERA.height, CAMERA.width
    down, across = np.mgrid[0 : shape[0], 0 : shape[1]].astype(np.float64)
    real = ramp(across, down)
    colours = (real + rng.normal(scale=0.03, size=real.shape)).astype(np.float32)
    alphas = rng.uniform(0.6, 1, (*shape, 1)).astype(np.float32)
    drawn = {
        "colour": np.concatenate([colours, alphas], axis=-1),
        "depth": rng.uniform(1, 3, (*shape, 1)).astype(np.float32),
    }
    level = _Level(real.astype(np.float32), np.ones(shape, np.float32), CAMERA, 1, True)
    found = MapPixels(level, drawn).equations(MOVE, EXPOSURE, DEVIATION, ours=0.0, cut=cut)
    assert found

    errors, places = residuals(np.zeros(12), drawn)
    inside = ((places >= 0) & (places <= np.array(shape[::-1]) - 1)).all(axis=1)
    assert 0.7 < inside.mean() < 1
    counts = np.where(inside, alphas.ravel(), 0)
    if cut:
        near = np.maximum(1 - (errors / (BIWEIGHT * DEVIATION)) ** 2, 0)
        weights, costs = counts[:, None] * near**2, (1 - near**3) / 3
    else:
        squares = (errors / (CAUCHY * DEVIATION)) ** 2
        weights, costs = counts[:, None] / (1 + squares), np.log1p(squares)
    total = 3 * counts.sum()
    small = 1e-5
    slopes, flows = [], []
    for step in small * np.eye(12):
        (after, there), (before, here) = residuals(step, drawn), residuals(-step, drawn)
        slopes.append((after - before) / (2 * small))
        flows.append((there - here) / (2 * small))
    by_step, by_pose = np.array(slopes), np.array(flows[:6])
    hessian = np.einsum("inc,nc,jnc->ij", by_step, weights, by_step) / total
    np.testing.assert_allclose(found.hessian, hessian, rtol=2e-3, atol=1e-5 * hessian.max())
    gradient = np.einsum("inc,nc,nc->i", by_step, weights, errors) / total
    np.testing.assert_allclose(found.gradient, gradient, rtol=2e-3, atol=2e-3 * gradient.max())
    flow = np.einsum("ink,n,jnk->ij", by_pose, counts, by_pose) / counts.sum()
    np.testing.assert_allclose(found.flow, flow, rtol=1e-3, atol=1e-4 * flow.max())
    cost = (counts[:, None] * costs).sum() / total
    assert found.cost == pytest.approx(cost, rel=1e-4)
