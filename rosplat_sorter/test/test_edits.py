"""Messages are checked before use: dropped whole, or splat by splat."""

import math

import numpy as np
import pytest
from geometry_msgs.msg import Point, Pose, Quaternion

from rosplat_core.slot_pages import MAX_SLOTS, SLOTS_PER_PAGE, MixedGroupsError
from rosplat_msgs.msg import GaussianArray
from rosplat_sorter.edits import MAX_GROUPS, MOVE, EditError, decode
from rosplat_sorter.map import SplatMap

INF, NAN = math.inf, math.nan


def test_a_batch_becomes_positions_and_extents(make_batch):
    edit = decode(make_batch(2, first_slot=5, sh_degree=1, scales=[0.1, 0.3, 0.2] * 2))
    assert (edit.slots, edit.end, edit.rejected) == (slice(5, 7), 7, 0)
    np.testing.assert_array_equal(edit.positions, [[0, 0, 1], [0, 0, 2]])
    np.testing.assert_allclose(edit.extents, 0.3 * math.sqrt(2 * math.log(255)), rtol=1e-6)


def test_slots_may_be_listed(make_batch):
    edit = decode(make_batch(3, slots=[9, 2, 4]))
    assert (edit.slots.tolist(), edit.end) == ([9, 2, 4], 10)


@pytest.mark.parametrize(
    ("wrong", "reason"),
    [
        ({"revision": 0}, "revision is 0"),
        ({"operation": 4}, "operation is 4"),
        ({"format": "draco"}, "format is 'draco', known is 'quantised'"),
        ({"payload": [0]}, "payload has 1 bytes, but format is empty"),
        ({"format": "quantised"}, "positions has 9 values, 0 expected"),
        ({"sh_degree": 7}, "sh_degree is 7"),
        ({"count": 2}, "positions has 9 values, 6 expected"),
        ({"positions": [0.0] * 8}, "positions has 8 values, 9 expected"),
        ({"orientations": []}, "orientations has 0 values, 12 expected"),
        ({"scales": [0.1] * 10}, "scales has 10 values, 9 expected"),
        ({"opacities": [1.0]}, "opacities has 1 values, 3 expected"),
        ({"sh": [0.0] * 27}, "sh has 27 values, 9 expected"),
        ({"slots": [1, 2]}, "slots has 2 values, count says 3"),
        ({"slots": [1, MAX_SLOTS, 2]}, f"slots holds {MAX_SLOTS}"),
        ({"first_slot": MAX_SLOTS - 2}, f"first_slot \\+ count is {MAX_SLOTS + 1}"),
        ({"first_slot": 2**32 - 1}, "first_slot"),
    ],
)
def test_a_message_wrong_in_structure_is_refused_by_its_field(make_batch, wrong, reason):
    message = make_batch()
    for field, value in wrong.items():
        setattr(message, field, value)
    with pytest.raises(EditError, match=reason):
        decode(message)


def test_an_origin_must_be_finite(make_batch):
    message = make_batch()
    message.origin.y = NAN
    with pytest.raises(EditError, match="origin"):
        decode(message)


def test_a_delete_carries_no_splats(make_batch):
    with pytest.raises(EditError, match="positions has 3 values, 0 expected"):
        decode(make_batch(operation=2, positions=[0.0, 0.0, 0.0]))


@pytest.mark.parametrize(
    ("field", "row"),
    [
        ("positions", [0.0, NAN, 0.0]),
        ("positions", [0.0, 0.0, INF]),
        ("orientations", [0.0, 0.0, 0.0, 0.0]),
        ("orientations", [0.0, NAN, 0.0, 1.0]),
        ("orientations", [INF, 0.0, 0.0, 1.0]),
        ("scales", [0.1, -0.1, 0.1]),
        ("scales", [0.1, INF, 0.1]),
        ("scales", [NAN, 0.1, 0.1]),
        ("opacities", [NAN]),
        ("opacities", [INF]),
        ("sh", [0.0, INF, 0.0]),
    ],
)
def test_a_splat_that_is_not_usable_becomes_an_empty_slot(make_batch, field, row):
    message = make_batch()
    values = getattr(message, field)
    for i, value in enumerate(row):
        values[len(row) + i] = value
    edit = decode(message)
    assert edit.rejected == 1
    assert (edit.extents >= 0).tolist() == [True, False, True]


def test_opacities_beyond_one_are_one_and_faint_splats_are_invisible(make_batch):
    edit = decode(make_batch(opacities=[5.0, 0.001, 1.0]))
    assert edit.rejected == 0
    assert edit.extents[0] == edit.extents[2] > 0
    assert edit.extents[1] == -1


def apply(splats, message):
    return splats.apply(decode(message))


def in_use(splats):
    """The slots with a splat that can be seen, ascending."""
    return np.sort(splats.slots[splats.extents >= 0]).tolist()


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
    assert (len(splats), splats.pages.rows) == (3, SLOTS_PER_PAGE)


def test_a_new_map_starts_empty_even_with_an_upsert(make_batch):
    splats = SplatMap()
    apply(splats, make_batch(5, revision=9, operation=0))
    apply(splats, make_batch(1, map_id="next"))
    assert (len(splats), splats.map_id, splats.revision, splats.missed) == (1, "next", 1, 0)


@pytest.mark.parametrize("map_id", ["map", "next"])
def test_what_memory_can_t_hold_leaves_the_map_as_it_was(make_batch, map_id, monkeypatch):
    def none_left(rows):
        raise MemoryError

    splats = SplatMap()
    apply(splats, make_batch(3))
    monkeypatch.setattr("rosplat_sorter.map._room", none_left)
    with pytest.raises(MemoryError):
        apply(splats, make_batch(1, map_id=map_id, revision=2, first_slot=1 << 20))
    assert (splats.map_id, splats.revision, splats.missed) == ("map", 1, 0)
    assert in_use(splats) == [0, 1, 2]
    assert splats.pages.rows == SLOTS_PER_PAGE
    assert splats.positions[2].tolist() == [0, 0, 3]


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
    assert (len(splats), splats.revision, splats.missed) == (15, 2, 1)
    assert apply(splats, make_batch(5, operation=0)) == slice(0, SLOTS_PER_PAGE)
    assert (len(splats), splats.revision, splats.missed) == (5, 1, 0)


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
    assert splats.origins[0].tolist() == [1e5, 0, 0]
    np.testing.assert_allclose(splats.positions[1], [-0.249, 0, 1], rtol=1e-6)


def test_a_replace_brings_its_origin(make_batch):
    """Else float32 would see one point in three."""
    splats = SplatMap()
    apply(splats, make_batch(3))
    far = make_batch(3, revision=2, operation=0)
    far.origin.x = 4.5e6
    apply(splats, far)
    assert splats.origins[0].tolist() == [4.5e6, 0, 0]
    assert splats.positions[:3, 2].tolist() == [1, 2, 3]


@pytest.mark.parametrize("first", [{"operation": 2}, {"operation": 0, "count": 0}])
def test_what_carries_no_splat_decides_no_origin(make_batch, first):
    splats = SplatMap()
    apply(splats, make_batch(**first))
    far = make_batch(1, revision=2)
    far.origin.x = 4.5e6
    apply(splats, far)
    assert splats.origins[0].tolist() == [4.5e6, 0, 0]


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
    assert apply(splats, moved(make_batch, 4, g3=10.0, g9=7.0)) == slice(0, 0)
    assert splats.frames[:, 0, 3].tolist() == [0, 4.5e6 + 10]
    assert splats.pages.groups.tolist() == [0, 3]
    assert splats.pages.table.tolist() == [[0, 0, 0], [2048, 1, 1], [3072, 2, 1]]
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
        MixedGroupsError, match="slots 2048 to 3071 hold splats of group 1, this batch is of group"
    ):
        apply(splats, mixed)
    assert (splats.revision, splats.pages.rows, splats.pages.groups.tolist()) == (1, 1024, [1])
    apply(splats, make_batch(3, revision=3, operation=2, first_slot=2048))
    assert splats.missed == 1
    mixed.revision = 4
    apply(splats, mixed)
    assert in_use(splats) == [5, 3071]
    assert splats.pages.groups.tolist() == [2]
    apply(splats, make_batch(1, revision=5, operation=0, first_slot=2048))  # forgets what was there


@pytest.mark.parametrize(
    ("wrong", "reason"),
    [
        ({"count": 1}, "count is 1"),
        ({"slots": [1]}, "slots has 1 values"),
        ({"groups": [1, 2]}, "poses has 1 values, groups has 2"),
        ({"groups": [MAX_GROUPS]}, f"groups holds {MAX_GROUPS}"),
        ({"groups": [4, 4], "poses": [Pose()] * 2}, "groups names one twice"),
        ({"operation": 2}, "groups has 1 values, only a MOVE has any"),
        ({"poses": [Pose(position=Point(y=NAN))]}, "poses: that of group 1 is not finite"),
        ({"poses": [Pose(orientation=Quaternion(x=INF))]}, "poses: that of group 1 is not finite"),
        ({"poses": [Pose(orientation=Quaternion(w=0.0))]}, "group 1 has an orientation of length"),
        ({"positions": [0.0] * 3}, "positions has 3 values, 0 expected"),
        ({"group": MAX_GROUPS}, f"group is {MAX_GROUPS}"),
    ],
)
def test_a_move_wrong_in_structure_is_refused_by_its_field(make_batch, wrong, reason):
    message = moved(make_batch, 1, g1=2.0)
    for field, value in wrong.items():
        setattr(message, field, value)
    with pytest.raises(EditError, match=reason):
        decode(message)


def test_slots_cost_memory_by_pages_wherever_they_lie(make_batch):
    splats = SplatMap()
    for revision, slot in enumerate((MAX_SLOTS - 1, 7 << 16, 3), 1):
        apply(splats, make_batch(1, revision=revision, first_slot=slot))
    assert in_use(splats) == [3, 7 << 16, MAX_SLOTS - 1]
    assert len(splats) == MAX_SLOTS
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
    assert len(splats._extents) == SLOTS_PER_PAGE


def test_limits_are_the_message_s():
    assert MAX_SLOTS == GaussianArray.MAX_SLOTS
    assert MAX_GROUPS == GaussianArray.MAX_GROUPS
    assert SLOTS_PER_PAGE == GaussianArray.SLOTS_PER_BLOCK
