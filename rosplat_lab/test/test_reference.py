"""The reference renderer: against closed forms, against itself, and against gsplat's pictures."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from rosplat_core import harmonics
from rosplat_core.cameras import Camera, look_at
from rosplat_core.models import Model
from rosplat_core.quaternions import to_matrices
from rosplat_core.splats import Splats, concatenate
from rosplat_lab.reference import render, renderer
from rosplat_lab.reference.projection import project
from rosplat_lab.reference.rays import along_rays, rays_of

Make = Callable[..., Splats]

RED, GREEN, BLUE = np.eye(3)
MIDDLE = (24, 32)  # row, column of the pixel whose centre lies on the optical axis


def camera(**changes: Any) -> Camera:
    """65 x 49 pixels, looking along the world's z."""
    return replace(Camera(0, 65, 49, 100, 100, 32.5, 24.5, np.eye(4)), **changes)


def ball(
    depth: float,
    color: NDArray[np.float64] = RED,
    opacity: float = 0.8,
    scale: float = 0.02,
    at: tuple[float, float] = (0, 0),
) -> Splats:
    """One round splat of one colour."""
    return Splats(
        positions=np.array([[*at, depth]], np.float32),
        orientations=np.array([[0, 0, 0, 1]], np.float32),
        scales=np.full((1, 3), scale, np.float32),
        opacities=np.array([opacity], np.float32),
        sh=((color - 0.5) / harmonics.C0)[None, None].astype(np.float32),
    )


def test_a_single_gaussian_in_closed_form() -> None:
    picture = render(ball(2.0), camera())
    variance = (100 * 0.02 / 2) ** 2 + 0.3
    offsets = np.arange(65) - 32
    expected = 0.8 * np.exp(-(offsets**2) / (2 * variance))
    expected[expected < 1 / 255] = 0
    np.testing.assert_allclose(picture.rgba[24, :, 3], expected, atol=1e-6)
    np.testing.assert_allclose(picture.rgba[24, :, :3], expected[:, None] * RED, atol=1e-6)
    np.testing.assert_allclose(picture.rgba[:, 32], picture.rgba[24, 8:57], atol=1e-6)


def test_two_layers_blend_front_to_back_whatever_their_slots() -> None:
    near, far = ball(2.0, RED, 0.6), ball(3.0, GREEN, 0.5)
    for splats in (concatenate([near, far]), concatenate([far, near])):
        pixel = render(splats, camera()).rgba[MIDDLE]
        np.testing.assert_allclose(pixel, [0.6, 0.4 * 0.5, 0, 0.6 + 0.4 * 0.5], atol=1e-6)


def test_of_equal_depths_the_lower_slot_is_in_front() -> None:
    pixel = render(concatenate([ball(2.0, RED, 0.6), ball(2.0, GREEN, 0.6)]), camera()).rgba[MIDDLE]
    np.testing.assert_allclose(pixel[:2], [0.6, 0.24], atol=1e-6)


def test_depth_is_weighted_by_opacity_and_nan_where_nothing_is() -> None:
    depth = render(concatenate([ball(2.0, opacity=0.6), ball(3.0, opacity=0.5)]), camera()).depth
    assert depth[MIDDLE] == pytest.approx((0.6 * 2 + 0.2 * 3) / 0.8)
    assert np.isnan(depth[0, 0])


def test_an_order_can_be_given_back_to_front() -> None:
    splats = concatenate([ball(2.0, RED, 0.6), ball(3.0, GREEN, 0.6), ball(4.0, BLUE, 0.6)])
    exact = render(splats, camera()).rgba
    np.testing.assert_array_equal(render(splats, camera(), order=np.array([2, 1, 0])).rgba, exact)
    stale = render(splats, camera(), order=np.array([0, 2])).rgba[MIDDLE]
    np.testing.assert_allclose(stale[:3], [0.24, 0, 0.6], atol=1e-6)


def test_alpha_is_capped_and_faint_splats_are_skipped() -> None:
    assert render(ball(2.0, opacity=1.0), camera()).rgba[MIDDLE][3] == pytest.approx(0.999)
    capped = render(ball(2.0, opacity=1.0), camera(), max_alpha=0.99).rgba[MIDDLE][3]
    assert capped == pytest.approx(0.99)
    assert not render(ball(2.0, opacity=0.0039), camera()).rgba.any()
    assert render(ball(2.0, opacity=0.0040), camera()).rgba.any()


def test_a_finished_pixel_leaves_out_the_splat_that_would_finish_it() -> None:
    splats = concatenate([ball(2.0, RED, 0.9), ball(3.0, GREEN, 0.9), ball(4.0, BLUE, 0.5)])
    everything = render(splats, camera()).rgba[MIDDLE]
    np.testing.assert_allclose(everything[:3], [0.9, 0.09, 0.005], atol=1e-6)
    stopped = render(splats, camera(), min_transmittance=0.02).rgba[MIDDLE]
    np.testing.assert_allclose(stopped, [0.9, 0, 0, 0.9], atol=1e-6)


def test_antialiased_models_keep_their_energy() -> None:
    for scale in (0.001, 0.005, 0.02):
        variance = (100 * scale / 2) ** 2
        splats = replace(ball(2.0, scale=scale), model=Model.EWA_ANTIALIASED)
        expected = 0.8 * variance / (variance + 0.3)
        alpha = render(splats, camera()).rgba[MIDDLE][3]
        assert alpha == pytest.approx(expected if expected >= 1 / 255 else 0, rel=1e-5)


def test_bright_colors_are_not_clamped_before_blending() -> None:
    pixel = render(ball(2.0, np.array([3.0, -1.0, 0.5]), 0.5), camera()).rgba[MIDDLE]
    np.testing.assert_allclose(pixel[:3], [1.5, 0, 0.25], atol=1e-6)


def test_orthographic_size_does_not_depend_on_depth() -> None:
    view = camera(orthographic=True)
    near, far = render(ball(1.0), view), render(ball(9.0), view)
    np.testing.assert_allclose(near.rgba, far.rgba, atol=1e-6)
    variance = (100 * 0.02) ** 2 + 0.3
    assert near.rgba[24, 34, 3] == pytest.approx(0.8 * np.exp(-2 / variance))
    moved = render(ball(5.0, at=(0.1, 0.05)), view).rgba[..., 3]
    assert moved[24 + 5, 32 + 10] == moved.max()


def test_only_what_lies_between_near_and_far_is_drawn() -> None:
    splats = concatenate([ball(-2.0), ball(0.5, GREEN), ball(2.0, BLUE), ball(8.0, RED)])
    pixel = render(splats, camera(near=1.0, far=4.0)).rgba[MIDDLE]
    np.testing.assert_allclose(pixel, [0, 0, 0.8, 0.8], atol=1e-6)


def test_a_splat_counts_by_its_extent_not_its_center() -> None:
    outside = ball(2.0, at=(0.67, 0), scale=0.05)  # its centre is a pixel beyond the right edge
    assert render(outside, camera()).rgba[24, 64, 3] > 0.5


def test_no_splats() -> None:
    picture = render(ball(2.0)[:0], camera())
    assert not picture.rgba.any()
    assert np.isnan(picture.depth).all()


def test_tiles_and_boxes_change_nothing(
    random_splats: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    splats, view = random_splats(400), camera(world_to_camera=look_at((3, 2, 1), (0, 0, 0)))
    tiled = render(splats, view)
    monkeypatch.setattr(renderer, "TILE", 4096)
    monkeypatch.setattr(renderer, "CHUNK", 4096)
    whole = render(splats, view)
    np.testing.assert_allclose(tiled.rgba, whole.rgba, atol=1e-12)
    np.testing.assert_allclose(tiled.depth, whole.depth, atol=1e-9)
    assert whole.rgba[..., 3].max() > 0.9


def test_a_crop_is_a_window_of_the_whole(random_splats: Make) -> None:
    splats, view = random_splats(400), camera(world_to_camera=look_at((3, 2, 1), (0, 0, 0)))
    crop = render(splats, view, crop=(11, 7, 50, 33)).rgba
    np.testing.assert_allclose(crop, render(splats, view).rgba[7:33, 11:50], atol=1e-12)
    with pytest.raises(ValueError, match="crop"):
        render(splats, view, crop=(0, 0, 66, 10))


def test_the_covariance_follows_the_projection(random_splats: Make) -> None:
    """The spread of projected samples of a small Gaussian is its 2D covariance."""
    splats = random_splats(8, 0)
    splats.scales[:] *= 0.02
    splats.opacities[:] = 0.9
    view = camera(
        world_to_camera=look_at((4, 3, 2), (0, 0, 0)), width=650, height=490, cx=325.0, cy=245.0
    )
    projected = project(splats, view)
    rng = np.random.default_rng(0)
    for i, slot in enumerate(projected.slots):
        offsets = rng.normal(size=(200_000, 3)) * splats.scales[slot]
        rotation = to_matrices(splats.orientations[slot : slot + 1])[0]
        world = splats.positions[slot] + offsets @ rotation.T
        x, y, z = view.world_to_camera[:3, :3] @ world.T + view.world_to_camera[:3, 3:]
        spread = np.cov(view.fx * x / z, view.fy * y / z)
        xx, xy, yy = projected.conics[i]
        np.testing.assert_allclose(
            np.linalg.inv([[xx, xy], [xy, yy]]) - 0.3 * np.eye(2), spread, rtol=0.03, atol=2e-4
        )
    assert len(projected.slots) == 8


def test_the_jacobian_stops_growing_beyond_the_guard_band() -> None:
    """Off to the side, a ball's picture would stretch without bound; the clamp holds it."""
    edge, beyond = ball(1.0, at=(0.423, 0), scale=0.05), ball(1.0, at=(0.6, 0), scale=0.05)
    for splats, tangent in ((edge, 0.4225), (beyond, 0.4225)):
        xx = project(splats, camera(width=65)).conics[:, 0]
        expected = (100 * 0.05) ** 2 * (1 + tangent**2) + 0.3
        np.testing.assert_allclose(1 / xx, expected, rtol=1e-4)


def test_a_map_far_from_zero_looks_the_same(random_splats: Make) -> None:
    splats, there = random_splats(100), np.array([4.5e6, -5e5, 120.0])
    near = render(splats, camera(world_to_camera=look_at((3, 2, 1), (0, 0, 0))))
    far = render(
        replace(splats, origin=there),
        camera(world_to_camera=look_at(there + np.array([3, 2, 1]), there)),
    )
    np.testing.assert_allclose(near.rgba, far.rgba, atol=1e-6)


# --- Along rays -----------------------------------------------------------------------------------


@pytest.mark.parametrize("model", [Model.RAY, Model.DISC], ids=str)
@pytest.mark.parametrize("focal", [100, 20], ids=["narrow", "wide"])
@pytest.mark.parametrize("away", [(4, 3, 2), (0.3, 0.2, 0.1)], ids=["outside", "inside"])
def test_rays_and_discs_are_what_brute_force_draws(
    random_splats: Make, model: Model, focal: float, away: tuple[float, float, float]
) -> None:
    splats = random_splats(60, 1, model=model)
    view = camera(world_to_camera=look_at(away, (0, 0, 0)), fx=focal, fy=1.1 * focal)
    rgba, depth = along_rays(splats, view.world_to_camera, rays_of(view), camera=view)
    picture = render(splats, view)
    np.testing.assert_allclose(picture.rgba, rgba, atol=1e-9)
    np.testing.assert_allclose(picture.depth, depth, atol=1e-6)


def test_rays_agree_with_ellipses_where_the_projection_is_all_but_linear(
    random_splats: Make,
) -> None:
    """Small in angle, large in pixels: what is left of the difference is the 0.3 px² low-pass."""
    splats = random_splats(40, 0)
    splats.scales[:] = np.clip(splats.scales, 0.2, 0.4)
    errors = []
    for distance in (4.0, 100.0):
        view = camera(
            fx=60 * distance, fy=60 * distance, near=0.1,
            world_to_camera=look_at((distance, 0.1, 0.2), (0, 0, 0)),
        )  # fmt: skip
        by_ray = render(replace(splats, model=Model.RAY), view).rgba
        errors.append(np.abs(render(splats, view).rgba - by_ray).mean())
    assert errors[1] < 0.1 * errors[0]
    assert errors[1] < 1e-3


def test_a_ray_meets_a_ball_in_closed_form_and_where_it_is_nearest() -> None:
    splats = replace(ball(2.0, GREEN, 0.8, scale=0.5), model=Model.RAY)
    picture = render(splats, camera(fx=20.0, fy=20.0))
    rays = rays_of(camera(fx=20.0, fy=20.0))
    cosines = 1 / np.linalg.norm(rays, axis=-1)
    across = 2.0 * np.sqrt(1 - cosines**2)  # from the centre to the ray [m]
    alpha = np.float32(0.8) * np.exp(-0.5 * (across / 0.5) ** 2)
    alpha[alpha < 1 / 255] = 0
    np.testing.assert_allclose(picture.rgba[..., 1], alpha, atol=1e-6)
    np.testing.assert_allclose(picture.depth[alpha > 0], (2 * cosines**2)[alpha > 0], atol=1e-6)


def test_a_disc_s_depth_is_its_plane_s() -> None:
    tilt = np.radians(60) / 2
    flat = replace(
        ball(2.0, scale=0.5), model=Model.DISC,
        orientations=np.array([[0, np.sin(tilt), 0, np.cos(tilt)]], np.float32),
    )  # fmt: skip
    view = camera(fx=20.0, fy=20.0)
    depth, rays = render(flat, view).depth, rays_of(view)
    normal = np.array([np.sin(2 * tilt), 0, np.cos(2 * tilt)])
    plane = 2 * normal[2] / (rays @ normal)
    seen = np.s_[24, 30:40]
    np.testing.assert_allclose(depth[seen], plane[seen], rtol=1e-5)
