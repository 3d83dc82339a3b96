"""Cameras become views without losing what float32 could have kept."""

import math

import numpy as np
import pytest

from rosplat_core.posed_camera import CameraError
from rosplat_core.quaternions import to_matrices
from rosplat_core.view import SortView, frame_at, unmoved


def test_a_point_before_a_turned_camera_lies_on_its_axis(make_camera):
    # The optical frame's z along the map's x, its x along -y: how a robot's camera looks ahead.
    camera = make_camera(position=(1.0, 2.0, 3.0), orientation=(-0.5, 0.5, -0.5, 0.5))
    view = SortView.of(camera)
    np.testing.assert_allclose(
        view.rotations[0] @ [6, 2, 3] + view.translations[0], [0, 0, 5], atol=1e-6
    )
    np.testing.assert_allclose(
        view.rotations[0] @ [6, 1, 3] + view.translations[0], [1, 0, 5], atol=1e-6
    )


def test_a_quaternion_of_any_length_is_a_rotation():
    matrix = to_matrices([2.0, -3.0, 0.5, 7.0])
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(3), atol=1e-15)
    np.testing.assert_allclose(matrix, to_matrices([0.2, -0.3, 0.05, 0.7]), atol=1e-15)


def test_the_map_origin_is_subtracted_before_float32(make_camera):
    camera = make_camera(position=(4.5e6 + 0.001, 0.0, -1e5))
    view = SortView.of(camera, unmoved((4.5e6, 0.0, -1e5)))
    np.testing.assert_allclose(view.translations[0], [-0.001, 0, 0], rtol=1e-6)


def test_groups_are_placed_before_float32(make_camera):
    """A pose, then the origin of the group's positions, in its own frame."""
    half = math.sqrt(0.5)
    frame = frame_at((4.5e6, 0.001, 0.0), (0.0, 0.0, half, half)) @ frame_at((0.0, -4.5e6, 2.0))
    view = SortView.of(make_camera(position=(9e6, 0.0, 0.0)), [np.eye(4), frame])
    np.testing.assert_allclose(view.translations, [[-9e6, 0, 0], [0, 0.001, 2]], atol=1e-6)
    np.testing.assert_allclose(view.rotations[1] @ [1, 0, 0], [0, 1, 0], atol=1e-7)


def test_a_view_of_many_groups_is_that_of_each(make_camera):
    random = np.random.default_rng(0)
    frames = [frame_at(random.normal(size=3) * 1e4, random.normal(size=4)) for _ in range(9)]
    camera = make_camera(position=(1.0, -2.0, 3.0), orientation=(0.1, 0.2, -0.4, 0.9))
    together = SortView.of(camera, frames)
    for i, frame in enumerate(frames):
        alone = SortView.of(camera, [frame])
        np.testing.assert_array_equal(together.rotations[i], alone.rotations[0])
        np.testing.assert_array_equal(together.translations[i], alone.translations[0])


def test_intrinsics_are_those_of_the_twin_in_cpp(make_camera):
    """test_depth_order.cpp asserts the same numbers."""
    camera = make_camera(
        fx=517.3, fy=516.5, cx=318.6, cy=255.3, near_clip=0.05, far_clip=50.0, extent_scale=1.7
    )
    view = SortView.of(camera)
    assert [view.fx, view.fy] == [float.fromhex("0x1.02a666p+9"), float.fromhex("0x1.024p+9")]
    assert [view.offset_x, view.offset_y] == [
        float.fromhex("-0x1.666666p+0"),
        float.fromhex("0x1.e9999ap+3"),
    ]
    assert [view.half_width, view.half_height] == [402.5, 302.5]
    assert [view.slope_x, view.slope_y] == [
        float.fromhex("0x1.1a7f08p+10"),
        float.fromhex("0x1.03e01cp+10"),
    ]
    assert view.near_clip == float.fromhex("0x1.99999ap-5")


def test_an_orthographic_footprint_does_not_grow_with_the_angle(make_camera):
    view = SortView.of(make_camera(orthographic=True, fx=20.0, fy=30.0, near_clip=-5.0))
    assert [view.slope_x, view.slope_y] == [20, 30]


@pytest.mark.parametrize(
    "wrong",
    [
        {"position": (math.nan, 0.0, 0.0)},
        {"orientation": (0.0, 0.0, 0.0, 0.0)},
        {"orientation": (0.0, math.inf, 0.0, 1.0)},
        {"fx": 0.0},
        {"fy": -1.0},
        {"cx": math.nan},
        {"width": 0},
        {"height": 0},
        {"near_clip": 0.0},
        {"near_clip": 5.0, "far_clip": 5.0},
        {"far_clip": math.inf},
        {"extent_scale": 0.0},
    ],
)
def test_a_degenerate_camera_is_refused_by_its_field(make_camera, wrong):
    with pytest.raises(CameraError, match=next(iter(wrong))):
        make_camera(**wrong)


def test_a_camera_beyond_float32_is_refused(make_camera):
    with pytest.raises(CameraError, match="position"):
        make_camera(position=(1e300, 0.0, 0.0))
    with pytest.raises(CameraError, match="slope_x"):
        SortView.of(make_camera(fx=3e38, extent_scale=3e38))


@pytest.mark.parametrize("far", [1e39, -1e300, 1.7e308])
def test_a_group_beyond_float32_is_infinitely_far_away_alone(make_camera, far):
    camera = make_camera(position=(-3e38, 1.0, 2.0), orientation=(0.1, 0.2, -0.4, 0.9))
    near = frame_at((-3e38, 4.0, 5.0))
    alone = SortView.of(camera, [near])
    together = SortView.of(camera, [frame_at((far, 0.0, far)), near, unmoved((3e38, 0.0, 0.0))[0]])
    assert np.isposinf(together.translations[[0, 2]]).all()
    np.testing.assert_array_equal(together.translations[1], alone.translations[0])
