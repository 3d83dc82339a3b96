"""What batches make of the sorter's map. How batches are checked: tests/test_conformance.py."""

import math

import numpy as np
import pytest
from geometry_msgs.msg import Point, Pose

from rosplat_core.maps import MOVE, Arrival, BatchError
from rosplat_core.slot_pages import MAX_SLOTS, SLOTS_PER_PAGE
from rosplat_msgs.msg import GaussianArray
from rosplat_sorter.map import SplatMap


def test_a_batch_becomes_positions_and_extents(make_batch):
    splats = SplatMap()
    apply(splats, make_batch(2, first_slot=5, sh_degree=1, scales=[0.1, 0.3, 0.2] * 2))
    np.testing.assert_array_equal(splats.positions[5:7], [[0, 0, 1], [0, 0, 2]])
    radius = 0.3 * math.sqrt(2 * math.log(255))
    np.testing.assert_allclose(splats.extents[5:7], radius, rtol=1e-6)
    assert (splats.extents[:5] < 0).all()


def test_opacities_beyond_one_are_one_and_faint_splats_are_invisible(make_batch):
    splats = SplatMap()
    assert splats.apply(make_batch(opacities=[5.0, 0.001, 1.0]))["dropped"] == 0
    assert splats.extents[0] == splats.extents[2] > 0
    assert splats.extents[1] == -1
    assert splats.splats == 3


def apply(splats, message):
    splats.apply(message)
    return splats.changed_rows


def in_use(splats):
    """The slots with a splat that can be seen, ascending."""
    return np.sort(splats.slots_and_groups()[0][splats.extents >= 0]).tolist()


def test_replace_upsert_and_delete(make_batch):
    splats = SplatMap()
    apply(splats, make_batch(4, operation=0))
    apply(splats, make_batch(2, revision=2, slots=[6, 1], positions=[6.0] * 3 + [1.0] * 3))
    assert apply(splats, make_batch(2, revision=3, operation=2, first_slot=2)) == slice(2, 4)
    assert in_use(splats) == [0, 1, 6]
    assert splats.positions[[0, 1, 6]].tolist() == [[0, 0, 1], [1, 1, 1], [6, 6, 6]]
    apply(splats, make_batch(1, revision=4, operation=0, first_slot=1))
    assert in_use(splats) == [1]
    apply(splats, make_batch(1, revision=5, first_slot=4))
    assert in_use(splats) == [1, 4]


def test_deleting_slots_that_never_were_does_not_grow_the_map(make_batch):
    splats = SplatMap()
    apply(splats, make_batch(3))
    apply(splats, make_batch(MAX_SLOTS - 2, revision=2, operation=2, first_slot=2))
    apply(splats, make_batch(2, revision=3, operation=2, slots=[MAX_SLOTS - 1, 0]))
    assert in_use(splats) == [1]
    assert (splats.capacity, splats.rows) == (3, SLOTS_PER_PAGE)


def test_a_new_map_starts_empty_even_with_an_upsert(make_batch):
    splats = SplatMap()
    apply(splats, make_batch(5, revision=9, operation=0))
    apply(splats, make_batch(1, map_id="next"))
    assert (splats.capacity, splats.map_id, splats.revision, splats.missed) == (1, "next", 1, 0)


def test_gaps_are_counted(make_batch):
    splats = SplatMap()
    apply(splats, make_batch(3))
    apply(splats, make_batch(1, revision=4))
    assert (splats.revision, splats.missed) == (4, 2)
    apply(splats, make_batch(1, revision=9, operation=0))  # nothing before it is missed
    assert (splats.revision, splats.missed) == (9, 0)


def test_a_map_is_played_once_more(make_batch):
    splats = SplatMap()
    apply(splats, make_batch(5, operation=0))
    apply(splats, make_batch(5, revision=2, first_slot=5))
    apply(splats, make_batch(5, revision=3, first_slot=10))
    assert apply(splats, make_batch(5, revision=2, first_slot=5)) == slice(5, 10)
    assert (splats.capacity, splats.revision, splats.missed) == (15, 2, 1)
    assert apply(splats, make_batch(5, operation=0)) == slice(0, SLOTS_PER_PAGE)
    assert (splats.capacity, splats.revision, splats.missed) == (5, 1, 0)


def test_a_late_joiner_misses_what_came_before(make_batch):
    splats = SplatMap()
    apply(splats, make_batch(3, revision=4))
    assert splats.missed == 3


def test_another_origin_is_rebased_in_float64(make_batch):
    splats = SplatMap()
    first = make_batch(1)
    first.origin.x = 1e5
    apply(splats, first)
    second = make_batch(1, revision=2, first_slot=1, positions=[-0.25, 0.0, 1.0])
    second.origin.x = 1e5 + 0.001
    apply(splats, second)
    assert splats.origin() == [1e5, 0, 0]
    np.testing.assert_allclose(splats.positions[1], [-0.249, 0, 1], rtol=1e-6)


def test_a_replace_brings_its_origin(make_batch):
    """Else float32 would see one point in three."""
    splats = SplatMap()
    apply(splats, make_batch(3))
    far = make_batch(3, revision=2, operation=0)
    far.origin.x = 4.5e6
    apply(splats, far)
    assert splats.origin() == [4.5e6, 0, 0]
    assert splats.positions[:3, 2].tolist() == [1, 2, 3]


@pytest.mark.parametrize("first", [{"operation": 2}, {"operation": 0, "count": 0}])
def test_what_carries_no_splat_decides_no_origin(make_batch, first):
    splats = SplatMap()
    apply(splats, make_batch(**first))
    far = make_batch(1, revision=2)
    far.origin.x = 4.5e6
    apply(splats, far)
    assert splats.origin() == [4.5e6, 0, 0]


def moved(make_batch, revision, **poses):
    """A MOVE that shifts each group, named as g3, along x. [m]"""
    message = make_batch(0, revision=revision, operation=MOVE)
    message.groups = [int(name[1:]) for name in poses]
    message.poses = [Pose(position=Point(x=x)) for x in poses.values()]
    return message


def test_groups_have_poses_and_origins_of_their_own(make_batch):
    splats = SplatMap()
    apply(splats, make_batch(2))
    for revision, far in ((2, 4.5e6), (3, 4.5e6 + 1)):
        message = make_batch(2, revision=revision, group=3, first_slot=1024 * revision)
        message.origin.x = far
        apply(splats, message)
    assert not len(apply(splats, moved(make_batch, 4, g3=10.0, g9=7.0)))
    assert splats.frames[:, 0, 3].tolist() == [0, 4.5e6 + 10, 7]
    assert splats.pages.tolist() == [[0, 0, 0], [2048, 1, 1], [3072, 2, 1]]
    assert splats.positions[2048:2050].tolist() == [[1, 0, 1], [1, 0, 2]]
    apply(splats, make_batch(1, revision=5, group=9, first_slot=1024 * 9))
    assert splats.frames[:, 0, 3].tolist() == [0, 4.5e6 + 10, 7]
    apply(splats, make_batch(1, revision=6, operation=0, group=3))
    assert splats.frames[:, 0, 3].tolist() == [0]


def test_a_page_is_of_one_group_until_it_is_empty(make_batch):
    splats = SplatMap()
    apply(splats, make_batch(3, first_slot=2048, group=1, opacities=[0.001] * 3))
    mixed = make_batch(2, revision=2, slots=[5, 3071], group=2)
    with pytest.raises(
        BatchError, match="slots 2048 to 3071 hold splats of group 1: delete them first"
    ):
        apply(splats, mixed)
    assert (splats.revision, splats.rows, len(splats.frames)) == (1, 1024, 1)
    apply(splats, make_batch(3, revision=3, operation=2, first_slot=2048))
    assert splats.missed == 1
    mixed.revision = 4
    apply(splats, mixed)
    assert in_use(splats) == [5, 3071]
    assert not splats.origin(2)[0]
    assert splats.pages[:, 2].tolist() == [1, 1]
    apply(splats, make_batch(1, revision=5, operation=0, first_slot=2048))  # forgets what was there


def test_batches_that_follow_a_pull_may_be_behind_it(make_batch):
    """A block was given to another group meanwhile: what it holds comes once more."""
    splats = SplatMap()
    splats.apply(make_batch(2, first_slot=1024, group=2, revision=9), Arrival.PULLED)
    splats.apply(make_batch(4, slots=[0, 1024, 1025, 1026], group=1, revision=7), Arrival.PULLED)
    assert in_use(splats) == [0, 1024, 1025, 1026]
    assert splats.splats == 4
    splats.apply(make_batch(1024, operation=2, first_slot=1024, revision=8), Arrival.PULLED)
    splats.apply(make_batch(2, first_slot=1024, group=2, revision=9), Arrival.LAST)
    assert in_use(splats) == [0, 1024, 1025]
    assert (splats.splats, splats.revision, splats.missed) == (3, 9, 0)


def test_slots_cost_memory_by_pages_wherever_they_lie(make_batch):
    splats = SplatMap()
    for revision, slot in enumerate((MAX_SLOTS - 1, 7 << 16, 3), 1):
        apply(splats, make_batch(1, revision=revision, first_slot=slot))
    assert in_use(splats) == [3, 7 << 16, MAX_SLOTS - 1]
    assert splats.capacity == MAX_SLOTS
    assert len(splats.extents) == 3 * SLOTS_PER_PAGE
    apply(splats, make_batch(4, revision=4, slots=[7 << 16, 5, 4, (7 << 16) + 1]))
    assert in_use(splats) == [3, 4, 5, 7 << 16, (7 << 16) + 1, MAX_SLOTS - 1]
    apply(splats, make_batch((7 << 16) + 1, revision=5, operation=2))
    assert in_use(splats) == [(7 << 16) + 1, MAX_SLOTS - 1]
    apply(splats, make_batch(2000, revision=6, first_slot=(7 << 16) - 1000))
    expected = [*range((7 << 16) - 1000, (7 << 16) + 1000), MAX_SLOTS - 1]
    assert in_use(splats) == expected


def test_a_replace_gives_memory_back(make_batch):
    splats = SplatMap()
    apply(splats, make_batch(5000))
    apply(splats, make_batch(1, revision=2, operation=0))
    assert splats.rows == SLOTS_PER_PAGE


def test_limits_are_the_message_s():
    assert MAX_SLOTS == GaussianArray.MAX_SLOTS
    assert SLOTS_PER_PAGE == GaussianArray.SLOTS_PER_BLOCK
