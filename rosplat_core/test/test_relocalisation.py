"""Pictures found among places without a start, and refused where none shows them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from rosplat_core import CpuRenderer, Relocaliser, generate, relocalise
from rosplat_core.alignment import motion
from rosplat_core.cameras import Camera, orbit
from rosplat_core.relocalisation import FLAT
from rosplat_core.rendering import render

SPLATS = generate(10_000, seed=3)
MAP = CpuRenderer(SPLATS)
BOUNDS = np.array([[-1.5, -1.5, 0], [1.5, 1.5, 1]])
VIEWS = orbit(BOUNDS, 16, width=160, height=120)
SEARCH = Relocaliser(MAP, VIEWS[0], [view.world_to_camera for view in VIEWS])


def beside(number: int) -> Camera:
    """Between two places, nearer, turned and tilted."""
    rng = np.random.default_rng(number)
    camera = orbit(BOUNDS, 16, width=160, height=120, azimuth=0.15)[number]
    step = [*rng.uniform(-0.1, 0.1, 2), 0.3, *np.radians(rng.uniform(-8, 8, 3))]
    pose = camera.camera_to_world @ motion(step)
    return replace(camera, world_to_camera=np.linalg.inv(pose))


def taken(camera: Camera) -> NDArray[np.uint8]:
    exposed = 0.7 * MAP.render(camera)[..., :3] + 0.1
    noise = np.random.default_rng(0).normal(scale=0.01, size=exposed.shape)
    return (255 * np.clip(exposed + noise, 0, 1) + 0.5).astype(np.uint8)


@pytest.mark.parametrize("number", range(0, 16, 3))
def test_a_picture_is_found_among_places(number: int) -> None:
    camera = beside(number)
    found = SEARCH.relocalise(taken(camera))
    assert found.converged
    between = found.world_to_camera @ camera.camera_to_world
    assert np.linalg.norm(between[:3, 3]) < 0.02
    assert np.degrees(np.arccos((np.trace(between[:3, :3]) - 1) / 2)) < 0.3


@pytest.mark.parametrize(
    "picture",
    [
        taken(beside(1))[:, ::-1],
        taken(beside(2))[::-1],
        np.random.default_rng(0).integers(0, 255, (120, 160, 3), np.uint8),
        np.full((120, 160, 3), 90, np.uint8),
        (255 * np.clip(render(generate(10_000, scene="rooms"), VIEWS[5])[..., :3], 0, 1)).astype(
            np.uint8
        ),
    ],
    ids=["mirrored", "upside down", "noise", "grey", "another map's"],
)
def test_a_picture_of_something_else_is_found_nowhere(picture: NDArray[np.uint8]) -> None:
    found = SEARCH.relocalise(picture)
    assert found.problem == "none of 16 places shows what the picture does"
    assert np.isinf(found.covariance.diagonal()).all()


def test_a_mask_leaves_out_what_stands_in_front() -> None:
    camera, mask = beside(4), np.ones((120, 160), bool)
    picture, mask[70:, :70] = taken(camera), False
    picture[70:, :70] = (255, 0, 255)
    places = [VIEWS[4].world_to_camera, VIEWS[5].world_to_camera]
    assert relocalise(MAP, picture, camera, places, mask).converged


def test_scores_are_those_of_plain_cross_correlation() -> None:
    rng = np.random.default_rng(1)
    shape = SEARCH._thumbnail.height, SEARCH._thumbnail.width
    thumbnail, shares = rng.random((*shape, 3), np.float32), rng.random(shape, np.float32)
    shares[:10, :20] = 0
    scores = SEARCH._scores(thumbnail, shares)
    drawn = SEARCH._drawn(replace(SEARCH._wide, world_to_camera=VIEWS[3].world_to_camera))
    drawn, total = drawn[..., :3].astype(np.float64), shares.sum()
    for down, right in ((0, 0), (3, 7), (scores.shape[1] - 1, scores.shape[2] - 1)):
        window = drawn[down : down + shape[0], right : right + shape[1]]
        ours, theirs = (
            each - np.einsum("hwc,hw->c", each, shares) / total for each in (thumbnail, window)
        )
        spread = np.maximum(np.einsum("hwc,hw->c", theirs**2, shares), FLAT * total).sum()
        plain = np.einsum("hwc,hwc,hw->", ours, theirs, shares)
        plain /= np.sqrt(spread * np.einsum("hwc,hw->", ours**2, shares))
        assert scores[3, down, right] == pytest.approx(plain, abs=1e-4)


def test_what_cannot_be_searched_names_the_argument() -> None:
    with pytest.raises(ValueError, match=r"^places: expected one or more"):
        relocalise(MAP, np.zeros((120, 160, 3)), VIEWS[0], [])
    with pytest.raises(ValueError, match=r"^places: expected transforms \(4, 4\)"):
        relocalise(MAP, np.zeros((120, 160, 3)), VIEWS[0], [np.eye(3)])
    with pytest.raises(ValueError, match=r"^picture: expected an array \(120, 160, 3\)"):
        SEARCH.relocalise(np.zeros((1, 1, 3)))
