"""Poses found again by pictures, and the equations of a step against float64 and differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from rosplat_core import align
from rosplat_core.alignment import (
    BIWEIGHT,
    CAUCHY,
    ROUNDING,
    TILES,
    Alignment,
    MapPixels,
    _Level,
    motion,
)
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
    """Squares of errors by it are nearly of chi-squared's distribution of 6 degrees of freedom."""
    squares = []
    for seed in range(24):
        camera = VIEWS[seed % len(VIEWS)]
        found = align(MAP, taken(camera, noise, seed), moved(camera, 0.3, 0.5, seed))
        np.testing.assert_allclose(found.covariance, found.covariance.T, rtol=1e-9)
        error = off(found, camera)
        squares.append(error @ np.linalg.solve(found.covariance, error))
    assert 3 < np.mean(squares) < 8  # 6
    assert 2.5 < np.median(squares) < 7.5  # 5.3
    assert 5 < np.quantile(squares, 0.9) < 15  # 10.6


@pytest.mark.parametrize("wrong", ["picture", "map"])
def test_the_covariance_covers_errors_that_neighbours_share(wrong: str) -> None:
    """Of a photograph, that has a texture of its own, and of a map, whose splats have moved."""
    lengths = []
    for seed in range(16):
        rng, camera = np.random.default_rng(seed), VIEWS[seed % len(VIEWS)]
        picture, scene = taken(camera, 0.005, seed), MAP
        if wrong == "picture":
            smooth = gaussian_filter(rng.normal(size=picture.shape), (6, 6, 0))
            photograph = picture + 255 * 0.03 * smooth / smooth.std()
            picture = (np.clip(photograph, 0, 255) + 0.5).astype(np.uint8)
        else:
            moves = rng.normal(scale=SPLATS.scales).astype(np.float32)
            scene = CpuRenderer(replace(SPLATS, positions=SPLATS.positions + moves))
        found = align(scene, picture, moved(camera, 0.3, 0.5, seed))
        error = off(found, camera)
        lengths.append(np.sqrt(error @ np.linalg.solve(found.covariance, error) / 6))
    assert 0.5 < np.median(lengths) < 2
    assert np.min(lengths) > 0.25 and np.max(lengths) < 4


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
SHAPE = CAMERA.height, CAMERA.width
# Of pictures whose gradients are the same everywhere: channels at 0, and their slopes along x, y.
PICTURE = np.array([[0.3, 0.01, 0.002], [0.2, 0.001, 0.02], [0.5, 0.005, -0.01]])
DRAWN = np.array([[0.35, 0.009, 0.0], [0.15, 0.003, 0.019], [0.42, 0.006, -0.007]])


def ramp(slopes: NDArray[np.float64], places: NDArray[np.float64]) -> NDArray[np.float64]:
    """(..., 3) colours at places (..., 2)."""
    return slopes[:, 0] + places @ slopes[:, 1:].T


def centres() -> NDArray[np.float64]:
    down, across = np.mgrid[0 : SHAPE[0], 0 : SHAPE[1]].astype(np.float64)
    return np.stack([across, down], axis=-1)


def drawing() -> tuple[_Level, dict[str, NDArray[np.float32]]]:
    rng = np.random.default_rng(1)
    alphas = rng.uniform(0.6, 1, (*SHAPE, 1))
    drawn = {
        "colour": np.concatenate([ramp(DRAWN, centres()), alphas], axis=-1).astype(np.float32),
        "depth": rng.uniform(1, 3, (*SHAPE, 1)).astype(np.float32),
    }
    picture = ramp(PICTURE, centres()).astype(np.float32)
    return _Level(picture, np.ones(SHAPE, np.float32), CAMERA, 1, True), drawn


class Plain:
    """Float64, loops and differences: the pixels of a moved camera, and rows of its equations."""

    def __init__(self, drawn: dict[str, NDArray[np.float32]], move: NDArray[np.float64]) -> None:
        self._depth, self._move = drawn["depth"][..., 0].astype(np.float64), move
        places = self.places(np.zeros(6))
        last, slack = np.array(SHAPE[::-1]) - 1, 1e-9
        self.inside = ((places >= -slack) & (places <= last + slack)).all(axis=1)
        self.counts = np.where(self.inside, drawn["colour"][..., 3].ravel().astype(np.float64), 0)
        self.colours = ramp(DRAWN, centres()).reshape(-1, 3)
        gain, bias = EXPOSURE.T
        self.errors = gain * self.colours + bias - ramp(PICTURE, places)
        small = 1e-5
        self.flows = np.array([
            (self.places(step) - self.places(-step)) / (2 * small) for step in small * np.eye(6)
        ])  # fmt: skip

    def places(self, step: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n, 2) of the points in the picture of the camera after a step. [px]"""
        rays = np.ones((*SHAPE, 4))
        rays[..., 0] = (centres()[..., 0] + 0.5 - CAMERA.cx) / CAMERA.fx
        rays[..., 1] = (centres()[..., 1] + 0.5 - CAMERA.cy) / CAMERA.fy
        rays[..., 3] = 1 / self._depth
        points = (rays * self._depth[..., None]).reshape(-1, 4)
        points = points @ np.linalg.inv(self._move @ motion(step)).T
        x = CAMERA.fx * points[:, 0] / points[:, 2] + CAMERA.cx - 0.5
        y = CAMERA.fy * points[:, 1] / points[:, 2] + CAMERA.cy - 0.5
        return np.stack([x, y], axis=-1)

    def rows(self, slopes: NDArray[np.float64]) -> NDArray[np.float64]:
        """(12, n, 3) change of the errors by a step, for slopes (3, 2) of the channels."""
        rows = np.zeros((12, *self.errors.shape))
        rows[:6] = -np.einsum("ink,ck->inc", self.flows, slopes)
        for channel in range(3):
            rows[6 + 2 * channel, :, channel] = self.colours[:, channel]
            rows[7 + 2 * channel, :, channel] = 1
        return rows


OURS, THEIRS = EXPOSURE[:, :1] * DRAWN[:, 1:], PICTURE[:, 1:]


def test_equations_are_those_of_float64_and_differences() -> None:
    level, drawn = drawing()
    found = MapPixels(level, drawn).equations(MOVE, EXPOSURE, DEVIATION)
    plain = Plain(drawn, MOVE)
    assert found and 0.7 < plain.inside.mean() < 1
    squares = (plain.errors / (CAUCHY * DEVIATION)) ** 2
    weights, total = plain.counts[:, None] / (1 + squares), 3 * plain.counts.sum()
    rows = plain.rows((OURS + THEIRS) / 2)
    hessian = np.einsum("inc,nc,jnc->ij", rows, weights, rows) / total
    np.testing.assert_allclose(found.hessian, hessian, rtol=2e-3, atol=1e-5 * hessian.max())
    gradient = np.einsum("inc,nc,nc->i", rows, weights, plain.errors) / total
    np.testing.assert_allclose(found.gradient, gradient, rtol=2e-3, atol=2e-3 * gradient.max())
    flow = np.einsum("ink,n,jnk->ij", plain.flows, plain.counts, plain.flows) / plain.counts.sum()
    np.testing.assert_allclose(found.flow, flow, rtol=1e-3, atol=1e-4 * flow.max())
    cost = (plain.counts[:, None] * np.log1p(squares)).sum() / total
    assert found.cost == pytest.approx(cost, rel=1e-4)


def test_newton_s_equations_and_their_covariance_are_those_of_float64_and_differences() -> None:
    level, drawn = drawing()
    found = MapPixels(level, drawn).newton_equations(EXPOSURE)
    plain = Plain(drawn, np.eye(4))
    assert found
    deviation = 1.4826 * np.median(np.abs(plain.errors))
    assert found.deviation == pytest.approx(deviation, rel=1e-4)
    near = 1 - (plain.errors / (BIWEIGHT * deviation)) ** 2
    assert (near < 0.9).mean() > 0.1 and near.min() > 0
    counts = plain.counts[:, None]
    weights, curved = counts * near**2, counts * near * (5 * near - 4)
    ours, theirs, total = plain.rows(OURS), plain.rows(THEIRS), 3 * plain.counts.sum()
    hessian = np.einsum("inc,nc,jnc->ij", ours, curved, theirs) / total
    np.testing.assert_allclose(found.hessian, hessian, rtol=2e-3, atol=1e-4 * np.abs(hessian).max())
    gradients = np.einsum("inc,nc,nc->in", ours, weights, plain.errors)
    np.testing.assert_allclose(
        found.gradient, gradients.sum(axis=1) / total, rtol=2e-3,
        atol=2e-3 * np.abs(gradients.sum(axis=1) / total).max(),
    )  # fmt: skip

    side = int(np.sqrt(len(plain.counts) / TILES))
    steps, back = [], np.linalg.inv(hessian * total)
    for top in range(0, SHAPE[0], side):
        for left in range(0, SHAPE[1], side):
            tile = gradients.reshape(12, *SHAPE)[:, top : top + side, left : left + side]
            steps.append(back @ tile.sum(axis=(1, 2)))
    unit = (back @ np.einsum("inc,nc,jnc->ij", ours, weights, ours) @ back.T)[:6, :6]
    squares = [step[:6] @ np.linalg.inv(unit) @ step[:6] for step in steps]
    factor = sum(squares) / 6 * len(steps) / (len(steps) - 12)
    noise = ((weights * plain.errors) ** 2 / np.maximum(counts, 1e-9)).sum() + total * ROUNDING
    covariance = unit * max(factor, noise / weights.sum())
    np.testing.assert_allclose(
        found.covariance, covariance, rtol=0.02, atol=1e-4 * np.abs(covariance).max()
    )
