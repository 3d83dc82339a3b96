"""Poses by their times."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from rosplat_tools.cameras.pose_history import SECOND, PoseError, PoseHistory, between


def pose(x: float, degrees: float = 0.0) -> np.ndarray:
    made = np.eye(4)
    made[:3, :3] = Rotation.from_euler("z", degrees, degrees=True).as_matrix()
    made[0, 3] = x
    return made


def test_between_two_poses_lies_a_slerp() -> None:
    random = np.random.default_rng(0)
    for _ in range(20):
        turns = Rotation.random(2, rng=random)
        first, second = pose(1.0), pose(4.0)
        first[:3, :3], second[:3, :3] = turns.as_matrix()
        share = random.uniform()
        found = between(first, second, share)
        expected = Slerp([0, 1], turns)(share).as_matrix()
        np.testing.assert_allclose(found[:3, :3], expected, atol=1e-9)
        np.testing.assert_allclose(found[:3, 3], (1 + 3 * share, 0, 0))


def test_times_outside_of_what_is_known_are_refused() -> None:
    history = PoseHistory()
    with pytest.raises(PoseError, match="no pose has come yet"):
        history.newest()
    history.add(3 * SECOND, pose(3, 30))
    history.add(2 * SECOND, pose(2, 20))  # late
    assert history.newest()[0] == 3 * SECOND
    np.testing.assert_allclose(history.at(SECOND * 5 // 2), pose(2.5, 25), atol=1e-12)
    np.testing.assert_array_equal(history.at(2 * SECOND), pose(2, 20))
    with pytest.raises(PoseError, match=r"^0\.500 s after all poses"):
        history.at(SECOND * 7 // 2)
    with pytest.raises(PoseError, match=r"^0\.250 s before all poses"):
        history.at(SECOND * 7 // 4)


def test_a_pose_without_a_time_holds_until_the_next() -> None:
    history = PoseHistory()
    history.add(5 * SECOND, pose(5))
    history.add(0, pose(7))
    history.clear()
    np.testing.assert_array_equal(history.at(99 * SECOND), pose(7))
    history.add(6 * SECOND, pose(6))
    assert history.newest()[0] == 6 * SECOND
    with pytest.raises(PoseError):
        history.at(99 * SECOND)


def test_poses_are_forgotten_by_age_and_when_time_begins_again() -> None:
    history = PoseHistory(keeps=1.5)
    for second in range(100, 103):
        history.add(second * SECOND, pose(second))
    with pytest.raises(PoseError):
        history.at(100 * SECOND)
    history.add(100 * SECOND, pose(1))  # a straggler
    history.add(103 * SECOND, pose(103))
    np.testing.assert_allclose(history.at(SECOND * 205 // 2), pose(102.5))
    history.add(100 * SECOND, pose(1))  # a bag in a loop
    history.add(101 * SECOND, pose(3))
    np.testing.assert_allclose(history.at(SECOND * 201 // 2), pose(2))
    assert history.newest()[0] == 101 * SECOND
    history.clear()
    with pytest.raises(PoseError, match="no pose has come yet"):
        history.newest()
    longer = PoseHistory(keeps=100.0, restarts=100.0)
    for second in (102, 100):
        longer.add(second * SECOND, pose(second))
    np.testing.assert_allclose(longer.at(101 * SECOND), pose(101))
