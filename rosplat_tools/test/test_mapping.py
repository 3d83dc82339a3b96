"""The edits of an emulated SLAM back end: small, of all kinds, and exact in the end."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from rosplat_core.splats import Splats
from rosplat_testing.slot_map import SlotMap
from rosplat_tools.emulation.mapping import Edit, Move, around, edits

Maker = Callable[..., Splats]
ALL_KINDS: dict[str, Any] = {
    "batch_size": 100, "refine_fraction": 0.2, "prune_fraction": 0.1, "seed": 0,
}  # fmt: skip


@pytest.mark.parametrize("count", [0, 1, 99, 100, 1234])
@pytest.mark.parametrize("fractions", [(0, 0), (0.2, 0.1), (1, 0), (0, 1)])
def test_the_end_is_exactly_the_scene(
    random_splats: Maker, count: int, fractions: tuple[float, float]
) -> None:
    scene = random_splats(count)
    slot_map = SlotMap(scene[:0])
    for edit in edits(
        scene, batch_size=100, refine_fraction=fractions[0], prune_fraction=fractions[1], seed=1
    ):
        assert isinstance(edit, Edit)
        assert 0 < len(edit.slots) <= 100
        if edit.splats is None:
            slot_map.clear(edit.slots)
        else:
            slot_map.write(edit.slots, edit.splats)
    slots, splats = slot_map.snapshot()
    np.testing.assert_array_equal(slots, np.arange(count))
    splats = splats.with_sh_degree(scene.sh_degree)  # an empty map knows of none
    for name in ("positions", "orientations", "scales", "opacities", "sh"):
        np.testing.assert_array_equal(getattr(splats, name), getattr(scene, name))


def test_on_the_way_gaussians_move_a_little_go_and_come_back(random_splats: Maker) -> None:
    scene = random_splats(2000)
    slot_map = SlotMap(scene[:0])
    moved, returned, deleted = 0, 0, set[int]()
    for edit in edits(scene, **ALL_KINDS):
        assert isinstance(edit, Edit)
        before = set(slot_map.snapshot()[0].tolist())
        slots = {int(slot) for slot in edit.slots}
        if edit.splats is None:
            assert slots <= before
            slot_map.clear(edit.slots)
            deleted |= slots
            continue
        moved += len(slots & before)
        returned += len(slots & deleted)
        slot_map.write(edit.slots, edit.splats)
        off = np.linalg.norm(
            edit.splats.positions - scene[np.asarray(edit.slots)].positions, axis=1
        )
        assert off.max() < 0.3  # the scene is some metres wide
    assert 300 < moved < 500  # a fifth of 2000
    assert 120 < returned < 280  # a tenth
    assert returned == len(deleted)


def test_the_map_grows_in_the_order_of_the_scene(random_splats: Maker) -> None:
    new = [
        edit.slots
        for edit in edits(random_splats(950), **ALL_KINDS)
        if isinstance(edit, Edit) and isinstance(edit.slots, range)
    ]
    assert [slot for slots in new for slot in slots] == list(range(950))


def test_submaps_drift_until_a_loop_closure_puts_them_right(random_splats: Maker) -> None:
    scene = random_splats(2500, 2)
    slot_map = SlotMap()
    *growth, last = edits(scene, **ALL_KINDS, submaps=4)
    away: list[float] = []
    for edit in growth:
        if isinstance(edit, Move):
            slot_map.poses |= edit.poses
            away += [float(np.abs(pose - np.eye(4)).max()) for pose in edit.poses.values()]
        elif edit.splats is None:
            slot_map.clear(edit.slots)
        else:
            slot_map.write(edit.slots, edit.splats, edit.group)
    assert [part.group for part in slot_map.groups()] == [0, 1, 2, 3]
    assert len(away) == 3
    assert min(away) > 0.001
    off = np.abs(slot_map.snapshot()[1].positions - scene.positions).max(axis=1)
    assert (off[:625] == 0).all()
    assert off[-600:].min() > 0.001
    assert isinstance(last, Move)
    slot_map.poses |= last.poses
    for name in ("positions", "scales", "opacities", "sh"):
        values = getattr(slot_map.snapshot()[1], name)
        np.testing.assert_allclose(values, getattr(scene, name), atol=1e-5)


def test_a_circling_camera_sees_the_scene_by_angle() -> None:
    rng = np.random.default_rng(0)
    positions = rng.uniform([-5, -3, -0.2], [5, 3, 0.2], (500, 3))
    positions[:, 0] += 10
    n = len(positions)
    scene = Splats(positions, np.tile([0, 0, 0, 1], (n, 1)), positions, positions[:, 0],
                   np.zeros((n, 1, 3)))  # fmt: skip
    seen = around(scene)
    assert sorted(map(tuple, seen.positions)) == sorted(map(tuple, scene.positions))
    x, y, _ = (seen.positions - np.median(scene.positions, axis=0)).T
    turns = np.diff(np.unwrap(np.arctan2(y, x)))
    # One way round, without a leap: in the plane of x and y, in which the scene lies.
    assert abs(turns.sum()) == pytest.approx(2 * np.pi, abs=0.2)
    assert np.abs(turns).max() < 0.2


@pytest.mark.parametrize(
    "wrong",
    [
        {"batch_size": 0},
        {"submaps": 0},
        {"refine_fraction": -0.1},
        {"refine_fraction": 0.6, "prune_fraction": 0.6},
    ],
)
def test_a_plan_that_makes_no_sense_is_refused(
    random_splats: Maker, wrong: dict[str, float]
) -> None:
    with pytest.raises(ValueError, match=next(iter(wrong))):
        edits(random_splats(3), **(ALL_KINDS | wrong))
