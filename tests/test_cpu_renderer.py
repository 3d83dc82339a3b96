"""The processor's rasteriser, without OpenGL, against its float64 twin and gsplat's pictures."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest

from drawing import CAMERAS, camera_at, cloud, decibels, draw
from rosplat_core import rendering
from rosplat_core.cameras import Camera, load_cameras, look_at
from rosplat_core.formats import load
from rosplat_core.generated import generate
from rosplat_core.generated.rooms import Rooms, middle
from rosplat_core.models import Model
from rosplat_core.rendering import (
    CpuRenderer,
    Instructions,
    insert_all,
    posed,
    render,
)
from rosplat_lab import reference
from rosplat_lab.reference.rays import rays_of
from rosplat_lab.reference.room_rays import meet

INSTRUCTIONS = [Instructions.PLAIN, Instructions.AVX2, Instructions.AVX512]


@pytest.fixture(params=INSTRUCTIONS, ids=lambda instructions: instructions.name)
def renderer(request: pytest.FixtureRequest) -> CpuRenderer:
    renderer = CpuRenderer(threads=2, instructions=request.param)
    if renderer.instructions != request.param.name.lower():
        pytest.skip(f"this machine has no {request.param.name}")
    return renderer


@cache
def twin(view: str, model: Model, walled: bool = False) -> reference.Picture:
    """The cloud's picture, the same for all instructions; walled: behind wall()."""
    camera = CAMERAS[view]
    return reference.render(cloud(model), camera, scene_depth=wall(camera) if walled else None)


@pytest.mark.parametrize("model", Model, ids=str)
@pytest.mark.parametrize("view", CAMERAS)
def test_matches_the_float64_twin(renderer: CpuRenderer, view: str, model: Model) -> None:
    insert_all(renderer, cloud(model))
    drawn = draw(renderer, CAMERAS[view], mean_depth=True)
    expected = twin(view, model)
    # Beside a camera inside a disc, packed rotations move its plane.
    assert decibels(drawn["colour"], expected.rgba) >= (75 if model is Model.DISC else 80)
    alpha = expected.rgba[..., 3]
    error = np.abs(drawn["depth"][..., 0] - expected.depth)[alpha > 0.05]
    assert error.mean() < 2e-4  # [m]
    # A splat next to the cutoff, on one side here and on the other there, is a 255th of a pixel. A
    # disc's spot is not at the depth of its plane.
    assert (error * alpha[alpha > 0.05]).max() < (4 if model is Model.DISC else 2) / 255
    assert expected.rgba.max() > 0.5  # there was something to see


@pytest.mark.parametrize("view", CAMERAS)
def test_the_median_depth_is_the_twin_s(renderer: CpuRenderer, view: str) -> None:
    insert_all(renderer, cloud())
    drawn = draw(renderer, CAMERAS[view], median_depth=True)
    expected = reference.render(renderer.snapshot()[1], CAMERAS[view])
    median = drawn["depth"][..., 0]
    assert np.isfinite(median).mean() > 0.2  # there was something to see
    # Next to half, one takes the splat before.
    same = np.isclose(median, expected.median, rtol=1e-5, equal_nan=True)
    assert same.mean() > 0.999
    clear = np.abs(expected.rgba[..., 3] - 0.5) > 1e-3
    np.testing.assert_array_equal(np.isnan(median)[clear], np.isnan(expected.median)[clear])
    with pytest.raises(ValueError, match="a picture has one depth"):
        draw(renderer, CAMERAS[view], median_depth=True, mean_depth=True)


def test_depths_are_those_of_surfaces_not_of_centres() -> None:
    """In rooms of few, large splats, whose surfaces are known."""
    rooms = Rooms(np.random.default_rng(0))
    eye = (*middle(0, 0), 1.5)
    camera = Camera(0, 160, 120, 95.0, 95.0, 80.0, 60.0, look_at(eye, np.add(eye, (1, 0.3, -0.3))))
    rays = rays_of(camera).reshape(-1, 3)
    lengths = np.linalg.norm(rays, axis=1)
    directions = rays / lengths[:, None] @ camera.world_to_camera[:3, :3]
    distances = meet(rooms, np.tile(camera.position, (len(rays), 1)), directions).distances
    known = (distances / lengths).reshape(120, 160)
    splats = generate(60_000, sh_degree=0, scene="rooms")

    def within(depths: np.ndarray) -> float:
        return float((np.abs(depths / known - 1) < 0.01).mean())

    drawn = draw(CpuRenderer(splats), camera, median_depth=True)["depth"][..., 0]
    assert (
        within(drawn) > 0.75 > 0.4 > within(reference.render(splats, camera, planes=False).median)
    )


@pytest.mark.parametrize("view", CAMERAS)
def test_maps_beside_each_other_match_the_twin_of_their_union(
    renderer: CpuRenderer, view: str
) -> None:
    splats = cloud()
    robot = np.arange(len(splats)) % 3
    others = [CpuRenderer(threads=1), CpuRenderer(threads=1)]
    for number, each in enumerate([renderer, *others]):
        insert_all(each, splats[robot == number])
    drawn = draw(renderer, CAMERAS[view], beside=others)
    assert decibels(drawn["colour"], twin(view, Model.EWA).rgba) >= 80
    with pytest.raises(ValueError, match="an order is of one map alone"):
        draw(renderer, CAMERAS[view], beside=others, order=np.zeros(1, np.uint32))


def wall(camera: Camera) -> np.ndarray:
    """Depths of one that leans through the cloud, with a hole."""
    row, column = np.mgrid[: camera.height, : camera.width]
    depth = (0.1 + 3 * column / camera.width).astype(np.float32)
    depth[np.hypot(row - 60, column - 90) < 25] = np.inf
    return depth


@pytest.mark.parametrize("model", Model, ids=str)
@pytest.mark.parametrize("view", CAMERAS)
def test_opaque_objects_hide_what_is_behind_them(
    renderer: CpuRenderer, view: str, model: Model
) -> None:
    camera = CAMERAS[view]
    insert_all(renderer, cloud(model))
    picture = renderer.render(camera, scene_depth=wall(camera))
    expected = twin(view, model, walled=True).rgba
    assert decibels(picture, expected) >= 75
    hidden = twin(view, model).rgba - expected
    assert np.abs(hidden).max() > 0.02  # there was something to hide


def test_no_objects_are_nothing_else_than_objects_at_infinity(renderer: CpuRenderer) -> None:
    camera = CAMERAS["outside"]
    insert_all(renderer, cloud())
    nowhere = np.full((camera.height, camera.width), np.inf, np.float32)
    np.testing.assert_array_equal(
        renderer.render(camera, scene_depth=nowhere), renderer.render(camera)
    )


@pytest.mark.parametrize("depth", [np.nan, 0.0, -1.0])
def test_depths_that_no_object_can_have_are_refused(depth: float) -> None:
    camera = CAMERAS["outside"]
    depths = np.full((camera.height, camera.width), depth, np.float32)
    with pytest.raises(ValueError, match="scene_depth: expected depths in front of the camera"):
        CpuRenderer(cloud()).render(camera, scene_depth=depths)
    with pytest.raises(ValueError, match=r"scene_depth: expected float32 \(height, width\)"):
        CpuRenderer(cloud()).render(camera, scene_depth=depths[1:])


def test_a_model_can_be_forced(renderer: CpuRenderer) -> None:
    insert_all(renderer, cloud())
    renderer.settings.model = Model.EWA_ANTIALIASED
    expected = reference.render(cloud(Model.EWA_ANTIALIASED), CAMERAS["outside"]).rgba
    assert decibels(draw(renderer, CAMERAS["outside"])["colour"], expected) >= 80


def test_a_given_order_is_drawn(renderer: CpuRenderer) -> None:
    splats = cloud()
    insert_all(renderer, splats)
    slots = np.random.default_rng(3).permutation(len(splats))[:300].astype(np.uint32)
    expected = reference.render(splats, CAMERAS["outside"], order=slots).rgba
    assert decibels(draw(renderer, CAMERAS["outside"], order=slots)["colour"], expected) >= 80


@pytest.mark.parametrize("view", CAMERAS)
def test_picks_what_the_twin_picks(renderer: CpuRenderer, view: str) -> None:
    insert_all(renderer, cloud())
    expected, most = reference.pick(cloud(), CAMERAS[view])
    picked = renderer.pick(posed(CAMERAS[view])).astype(np.int32)
    clear = np.abs(most - 0.05) > 1e-3
    expected[most < 0.05] = -1
    assert np.mean(picked[clear] != expected[clear]) < 1e-3  # of next to equal contributions


@pytest.mark.parametrize(("name", "file"), [("wolf", "wolf.spz"), ("playbot", "playbot")])
def test_trained_scenes_match_gsplat(
    renderer: CpuRenderer, data_folder: Path, reference_folder: Path, name: str, file: str
) -> None:
    insert_all(renderer, load(data_folder / file))
    for camera in load_cameras(reference_folder / name / "cameras.json"):
        theirs = cv2.imread(str(reference_folder / name / camera.image), cv2.IMREAD_UNCHANGED)
        ours = draw(renderer, camera)["colour"][..., 2::-1]
        assert decibels(ours, theirs / 65535) >= 77


@cache
def twin_contributions(view: str) -> tuple[np.ndarray, ...]:
    return reference.contributions(cloud()[:60], CAMERAS[view])


@pytest.mark.parametrize("view", CAMERAS)
def test_contributions_are_those_of_the_twin(renderer: CpuRenderer, view: str) -> None:
    insert_all(renderer, cloud()[:60])
    found = rendering.Contributions()
    for _ in range(2):
        renderer.contribute(posed(CAMERAS[view]), found)
    weights, energies, errors = twin_contributions(view)
    assert errors.max() > 1  # there was something to see
    np.testing.assert_allclose(found.weight / 2, weights, rtol=2e-3, atol=0.02)
    np.testing.assert_allclose(found.energy / 2, energies, rtol=4e-3, atol=1e-3)
    np.testing.assert_allclose(found.error / 2, errors, rtol=5e-3, atol=1e-3)


def test_what_a_view_sees_is_taken_out_of_the_sums(renderer: CpuRenderer) -> None:
    insert_all(renderer, cloud())
    found = rendering.Contributions()
    renderer.contribute(posed(next(iter(CAMERAS.values()))), found)
    sums = found.weight, found.energy, found.error
    slots, *taken = found.take_seen()
    assert 0 < len(slots) < len(sums[0])
    np.testing.assert_array_equal(slots, np.flatnonzero(sums[0]))
    np.testing.assert_array_equal(taken, [each[slots] for each in sums])
    assert not any(each.any() for each in (found.weight, found.energy, found.error))


@pytest.mark.parametrize("view", CAMERAS)
def test_a_residual_is_dealt_as_by_the_twin(renderer: CpuRenderer, view: str) -> None:
    camera = CAMERAS[view]
    insert_all(renderer, cloud())
    values = np.random.default_rng(1).uniform(size=(camera.height, camera.width))
    found = rendering.Contributions()
    renderer.contribute(posed(camera), found, residual=values.astype(np.float32))
    expected = reference.dealt(cloud(), camera, values)
    # Contributions end where a hundredth is left.
    assert np.abs(found.residual - expected).max() < 0.01 * expected.max()
    with pytest.raises(RuntimeError, match="numbers of 4 pixels do not fit"):
        renderer.contribute(posed(camera), found, residual=np.zeros((2, 2), np.float32))


def test_contributions_of_slices_of_depth_add_up() -> None:
    """The processor draws so many splats in several slices; what hides is in the nearest."""
    splats = generate(600_000)
    camera = camera_at((5.0, 1.0, 2.0))
    renderer = CpuRenderer(threads=2)
    insert_all(renderer, splats)
    found = rendering.Contributions()
    renderer.contribute(posed(camera), found)
    alpha = draw(renderer, camera)["colour"][..., 3].sum()
    assert 0.99 * alpha < found.weight.sum() <= 1.0001 * alpha


def test_a_picture_that_is_kept_stays_as_it_is() -> None:
    """Others take the memory of pictures that were dropped."""
    renderer = CpuRenderer(cloud())
    cameras = list(CAMERAS.values())[:2]
    expected = [render(cloud(), camera) for camera in cameras]
    kept = [renderer.render(cameras[0])]
    for number in (1, 0, 1, 1, 0):
        dropped = renderer.render(cameras[number])
        np.testing.assert_array_equal(dropped, expected[number])
        kept.append(renderer.render(cameras[0]))
    for picture in kept:
        np.testing.assert_array_equal(picture, expected[0])


def test_threads_that_share_a_renderer_wait_for_one_another() -> None:
    renderer = CpuRenderer(cloud())
    expected = {name: renderer.render(camera) for name, camera in CAMERAS.items()}
    with ThreadPoolExecutor(4) as pool:
        for name, picture in zip(
            list(CAMERAS) * 5, pool.map(renderer.render, list(CAMERAS.values()) * 5), strict=True
        ):
            np.testing.assert_array_equal(picture, expected[name])


def test_a_map_far_from_its_origin_is_as_sharp(renderer: CpuRenderer) -> None:
    insert_all(renderer, cloud())
    near = draw(renderer, CAMERAS["outside"])["colour"]
    offset = np.array([4.5e6, -1.2e6, 3.3e5])
    shifted = CAMERAS["outside"].world_to_camera.copy()
    shifted[:3, 3] -= shifted[:3, :3] @ offset
    insert_all(renderer, replace(cloud(), origin=offset))
    far = draw(renderer, replace(CAMERAS["outside"], world_to_camera=shifted))["colour"]
    assert decibels(far, near) >= 80


@pytest.mark.parametrize("threads", [-1, 10**6])
def test_a_number_of_threads_that_can_t_be_is_refused(threads: int) -> None:
    with pytest.raises(ValueError, match=f"^threads is {threads}, expected 0 to 1024$"):
        CpuRenderer(threads=threads)
