"""Where a view is about to be, from where it has been."""

import pytest
from test_detail import camera

from rosplat_tools.streaming.followed_view import AHEAD, FollowedView


def test_a_view_that_moves_is_expected_to_go_on() -> None:
    view = FollowedView(camera((0.0, 0, 0)), 10.0)
    assert [there.position for there in view.cameras(10.0)] == [(0, 0, 0)]
    view.move_to(camera((1.0, 0, -2)), 10.5)
    here, ahead = view.cameras(10.6)
    assert here.position == (1, 0, -2)
    assert ahead.position == pytest.approx((1 + AHEAD * 2, 0, -2 - AHEAD * 4))


def test_one_that_rests_or_is_heard_seldom_is_where_it_is() -> None:
    view = FollowedView(camera((0.0, 0, 0)), 10.0)
    view.move_to(camera((1.0, 0, 0)), 10.1)
    assert len(view.cameras(10.25)) == 2
    assert len(view.cameras(10.35)) == 1  # by now, the next camera would have come
    view.move_to(camera((1.0, 0, 0)), 10.4)
    assert len(view.cameras(10.4)) == 1
    view.move_to(camera((900.0, 0, 0)), 12.0)
    assert len(view.cameras(12.0)) == 1


def test_one_that_leaves_the_world_is_where_it_is() -> None:
    view = FollowedView(camera((-3e38, 0, 0)), 10.0)
    view.move_to(camera((3e38, 0, 0)), 10.1)
    assert [there.position for there in view.cameras(10.1)] == [(3e38, 0, 0)]
