"""The reference: exact order, and culling that never hides what the renderer would draw."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rosplat_core import depth
from rosplat_core.quaternions import to_matrices
from rosplat_core.view import OVERSCAN, SortView, frame_at, unmoved


def on_axis(depths):
    positions = np.zeros((len(depths), 3), np.float32)
    positions[:, 2] = depths
    return positions


def test_back_to_front_with_the_higher_slot_first_in_ties(make_camera):
    positions = on_axis([3, 1, 2, 1])
    order = depth.order(SortView.of(make_camera()), positions, np.full(4, 0.1, np.float32))
    assert order.dtype == np.uint32
    assert order.tolist() == [0, 2, 3, 1]


def test_orthographic_depths_may_be_negative_and_both_zeros_are_one(make_camera):
    view = SortView.of(make_camera(orthographic=True, near_clip=-10.0, far_clip=10.0))
    order = depth.order(view, on_axis([-1, 2, -3, 0.0, -0.0]), np.full(5, 0.1, np.float32))
    assert order.tolist() == [1, 4, 3, 0, 2]


def test_empty_slots_and_what_lies_beyond_the_clips_are_left_out(make_camera):
    extents = np.array([0.1, -1, 0.1, 0.1, 0.1, 0.1], np.float32)
    positions = on_axis([5, 5, 0.05, 200, -5, np.nan])
    assert depth.order(SortView.of(make_camera()), positions, extents).tolist() == [0]


def test_millimetres_are_told_apart_far_from_the_frame_origin(make_camera):
    origin = np.array([1e5, -1e5, 1e5])
    view = SortView.of(make_camera(position=tuple(origin - [0, 0, 5])), unmoved(origin))
    heights = np.random.default_rng(0).permutation(1000) * 1e-3
    order = depth.order(view, on_axis(heights), np.full(1000, 0.1, np.float32))
    assert order.tolist() == np.argsort(-heights).tolist()


def test_groups_are_ordered_where_their_poses_put_them(make_camera):
    """As if each splat had been moved, far from the origin of the map's frame as well."""
    random = np.random.default_rng(1)
    far = np.array([4e6, -3e6, 1e5])
    positions = random.uniform(-2, 2, (900, 3)).astype(np.float32)
    groups = random.integers(0, 3, 900)
    frames = np.array([frame_at(far + random.normal(size=3), random.normal(size=4)) for _ in "123"])
    world = (frames[groups, :3, :3] @ positions[:, :, None])[:, :, 0] + frames[groups, :3, 3]
    camera = make_camera(position=tuple(far - [0, 0, 12]))
    moved = np.concatenate([world - far], dtype=np.float32)
    extents = np.full(900, 0.1, np.float32)
    order = depth.order(SortView.of(camera, frames), positions, extents, groups=groups)
    expected = depth.order(SortView.of(camera, unmoved(far)), moved, extents)
    heights = world[:, 2]
    np.testing.assert_allclose(heights[order], heights[expected], atol=1e-5)
    assert len(order) > 500


@given(st.lists(st.floats(width=32, allow_nan=False), min_size=2, max_size=50))
def test_keys_compare_as_depths_do(values):
    depths = np.array(values, np.float32)
    keys = depth.sort_keys(depths)
    assert ((depths[:, None] < depths) == (keys[:, None] < keys)).all()


def test_extents_end_where_alpha_is_below_one_step_of_eight_bits():
    opacities = np.array([1, 0.5, 0.1, 0.0039, 0, 7, -1], np.float32)
    scales = np.tile(np.float32([0.1, 2, 0.5]), (7, 1))
    extents = depth.splat_extents(scales, opacities)
    assert extents.dtype == np.float32
    drawn = opacities[:3]
    np.testing.assert_allclose(drawn * np.exp(-((extents[:3] / 2) ** 2) / 2), 1 / 255, rtol=1e-5)
    assert extents[3:].tolist() == [-1, -1, extents[0], -1]


def footprints(camera, positions, scales, quaternions, opacities):
    """Centre and half size in pixels, float64 (n, 2) each, and depth of what the renderer draws.

    EWA splatting after Kerbl et al. 2023: the Jacobian at a clamped tangent, 0.3 px² low-pass.
    """
    to_camera = to_matrices(camera.orientation).T
    centres, halves, depths = [], [], []
    for p, s, q, opacity in zip(positions, scales, quaternions, opacities, strict=True):
        x, y, z = to_camera @ (p.astype(float) - camera.position)
        r = to_camera @ to_matrices(q)
        covariance = r @ np.diag(s.astype(float) ** 2) @ r.T
        if camera.orthographic:
            jacobian = np.array([[camera.fx, 0, 0], [0, camera.fy, 0]])
            centre = [camera.fx * x + camera.cx, camera.fy * y + camera.cy]
        else:
            margin_x = 0.3 * 0.5 * camera.width / camera.fx
            margin_y = 0.3 * 0.5 * camera.height / camera.fy
            tan_x = np.clip(
                x / z,
                -(camera.cx / camera.fx + margin_x),
                (camera.width - camera.cx) / camera.fx + margin_x,
            )
            tan_y = np.clip(
                y / z,
                -(camera.cy / camera.fy + margin_y),
                (camera.height - camera.cy) / camera.fy + margin_y,
            )
            jacobian = np.array(
                [
                    [camera.fx / z, 0, -camera.fx * tan_x / z],
                    [0, camera.fy / z, -camera.fy * tan_y / z],
                ]
            )
            centre = [camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy]
        variance = np.diag(jacobian @ covariance @ jacobian.T) + 0.3
        sigmas = min(3.33, math.sqrt(2 * math.log(255 * opacity)))
        centres.append(centre)
        halves.append(sigmas * np.sqrt(variance))
        depths.append(z)
    return np.array(centres), np.array(halves), np.array(depths)


@pytest.mark.parametrize("orthographic", [False, True])
@pytest.mark.parametrize("centre", [(320.0, 240.0), (100.0, 400.0)])
@pytest.mark.parametrize("scale", [1.0, 2.5])
def test_culling_hides_nothing_that_is_drawn_and_little_else(
    make_camera, orthographic, centre, scale
):
    random = np.random.default_rng(3)
    count = 8000
    camera = make_camera(
        position=(1.0, -2.0, 0.5),
        orientation=(0.1, 0.7, -0.2, 0.6),
        fx=30.0 if orthographic else 400.0,
        fy=35.0 if orthographic else 450.0,
        cx=centre[0],
        cy=centre[1],
        near_clip=-10.0 if orthographic else 0.2,
        far_clip=15.0,
        orthographic=orthographic,
        extent_scale=scale,
    )
    positions = random.uniform(-20, 20, (count, 3)).astype(np.float32)
    scales = np.exp(random.uniform(-6, 0.5, (count, 3))).astype(np.float32)
    quaternions = random.normal(size=(count, 4))
    opacities = random.uniform(0.005, 1, count).astype(np.float32)

    visible = depth.visible(SortView.of(camera), positions, depth.splat_extents(scales, opacities))
    scales *= scale
    centres, halves, depths = footprints(camera, positions, scales, quaternions, opacities)
    in_depth = (depths > camera.near_clip) & (depths < camera.far_clip)
    size = np.array([camera.width, camera.height])
    gaps = np.maximum(centres - size, -centres) - halves  # from the picture to the footprint
    drawn = in_depth & (gaps < 0).all(axis=1)
    assert drawn.sum() > 200
    assert not (drawn & ~visible).any()

    # The bound takes a splat for a ball as large as its longest axis, at the steepest slope.
    tangent = 0 if orthographic else np.maximum(np.array(centre), size - centre) / [400, 450] + 0.3
    pixels = np.array([camera.fx, camera.fy]) / (1 if orthographic else depths[:, None])
    ball = 3.33 * scales.max(axis=1)[:, None] * pixels * np.sqrt(1 + np.square(tangent))
    overscan = (OVERSCAN - 1) / 2 * size
    away = np.maximum(centres - size, -centres) > ball + overscan + 3
    assert not (visible & (~in_depth | away.any(axis=1))).any()
    assert visible.sum() < 0.7 * count
