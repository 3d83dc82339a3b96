"""The map that edits add up to, against a dictionary of splats."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from rosplat_core.models import Model
from rosplat_core.splats import Splats
from rosplat_core.view import frame_at
from rosplat_testing.slot_map import SlotMap

Maker = Callable[..., Splats]


def test_random_edits_add_up_to_what_a_dictionary_holds(random_splats: Maker) -> None:
    rng = np.random.default_rng(0)
    first = random_splats(50, 0)
    slot_map = SlotMap(first)
    expected = {slot: first[slot : slot + 1] for slot in range(50)}
    for step in range(60):
        slots: range | np.ndarray = rng.choice(400, rng.integers(0, 30), replace=False)
        if step % 4 == 0:
            slots = range(int(rng.integers(0, 300)), 310)
        if step % 3 == 2:
            slot_map.clear(slots)
            for slot in slots:
                expected.pop(int(slot), None)
        else:
            splats = random_splats(len(slots), step % 4, seed=step)
            slot_map.write(slots, splats)
            expected |= {int(slot): splats[i : i + 1] for i, slot in enumerate(slots)}
    slots, splats = slot_map.snapshot()
    assert list(slots) == sorted(expected)
    assert len(slot_map) == len(expected)
    for i, slot in enumerate(slots):
        want = expected[int(slot)].with_sh_degree(3)
        for name in ("positions", "orientations", "scales", "opacities", "sh"):
            np.testing.assert_array_equal(getattr(splats, name)[i : i + 1], getattr(want, name))


def test_the_map_is_a_copy_of_what_it_was_given(random_splats: Maker) -> None:
    given = random_splats(3)
    slot_map = SlotMap(given)
    slot_map.write(range(3), random_splats(3, seed=1))
    np.testing.assert_array_equal(given.positions, random_splats(3).positions)


def test_channels_are_of_all_slots_and_none_where_they_were_not_given(random_splats: Maker) -> None:
    def labelled(count: int, **channels: float) -> Splats:
        given = {name: np.full(count, value) for name, value in channels.items()}
        return replace(random_splats(count), channels=given)

    slot_map = SlotMap(random_splats(4))
    slot_map.write(range(2), labelled(2, label=7))
    slot_map.write(range(5000, 5002), labelled(2, seen=0.5, label=8))
    slot_map.write(range(1), random_splats(1))
    slots, splats = slot_map.snapshot()
    assert list(slots) == [0, 1, 2, 3, 5000, 5001]
    none = np.nan
    np.testing.assert_array_equal(splats.channels["label"], [none, 7, none, none, 8, 8])
    np.testing.assert_array_equal(splats.channels["seen"], [none] * 4 + [0.5] * 2)
    with pytest.raises(ValueError, match="10 in all, a map has at most 8"):
        slot_map.write(range(9000, 9001), labelled(1, **{f"c{i}": 0 for i in range(8)}))
    assert len(slot_map) == 6


def test_positions_move_to_the_map_s_origin(random_splats: Maker) -> None:
    far = Splats(**(vars(random_splats(2)) | {"origin": np.array([1e6, 0, 0])}))
    near = Splats(**(vars(random_splats(2)) | {"origin": np.array([1e6 + 4, 2, 0])}))
    slot_map = SlotMap(far)
    slot_map.write(range(2, 4), near)
    _, splats = slot_map.snapshot()
    world = splats.positions + splats.origin
    np.testing.assert_allclose(world[2:], near.positions + near.origin, atol=1e-6, rtol=0)


def test_two_kinds_of_filter_don_t_mix(random_splats: Maker) -> None:
    with pytest.raises(ValueError, match="models"):
        SlotMap(random_splats(1)).write(range(1), random_splats(1, model=Model.RAY))


def test_slots_are_numbered_as_authors_like(random_splats: Maker) -> None:
    slot_map = SlotMap()
    first, second = random_splats(3, 3), random_splats(2, 3, seed=1)
    slot_map.write(np.array([2**25 - 1, 7 << 16, (7 << 16) + 1]), first)
    slot_map.write(range(2), second)
    slots, splats = slot_map.snapshot()
    assert list(slots) == [0, 1, 7 << 16, (7 << 16) + 1, 2**25 - 1]
    np.testing.assert_array_equal(splats.sh, [*second.sh, *first.sh[[1, 2, 0]]])
    slot_map.clear(range(2**25))
    assert len(slot_map) == 0


def test_the_first_splats_decide_origin_and_filter(random_splats: Maker) -> None:
    slot_map = SlotMap(random_splats(0))
    slot_map.clear(range(5))
    origin = np.array([4.5e6, 0, 0])
    far = Splats(**(vars(random_splats(2, model=Model.RAY)) | {"origin": origin}))
    slot_map.write(range(2), far)
    _, splats = slot_map.snapshot()
    assert splats.model is Model.RAY
    np.testing.assert_array_equal(splats.origin, origin)
    np.testing.assert_array_equal(splats.positions, far.positions)


def test_groups_have_origins_and_poses_and_are_baked_into_a_snapshot(random_splats: Maker) -> None:
    first, second, third = (random_splats(3, 2, seed=seed) for seed in range(3))
    far = Splats(**(vars(second) | {"origin": np.array([1e6, 0, 0])}))
    farther = Splats(**(vars(third) | {"origin": np.array([1e6 + 1, 0, 0])}))
    slot_map = SlotMap(first)
    slot_map.write(range(5000, 5003), far, group=7)
    slot_map.write(range(2000, 2003), farther, group=7)
    parts = slot_map.groups()
    assert [(part.group, list(part.slots)) for part in parts] == [
        (0, [0, 1, 2]),
        (7, [2000, 2001, 2002, 5000, 5001, 5002]),
    ]
    assert [part.splats.origin[0] for part in parts] == [0, 1e6]
    np.testing.assert_array_equal(parts[1].splats.positions[3:], far.positions)
    slot_map.poses[7] = frame_at((-1e6, 2.0, 0.0), (1.0, 0.0, 0.0, 0.0))
    slots, splats = slot_map.snapshot()
    assert list(slots) == [0, 1, 2, 2000, 2001, 2002, 5000, 5001, 5002]
    np.testing.assert_array_equal(splats.sh[:3], first.sh)
    np.testing.assert_allclose(
        splats.positions[6:] + splats.origin, second.positions * [1, -1, -1] + [0, 2, 0], atol=1e-5
    )


def test_a_page_is_of_one_group_until_it_is_empty(random_splats: Maker) -> None:
    slot_map = SlotMap(random_splats(3))
    with pytest.raises(ValueError, match="slots 0 to 1023 hold splats of group 0"):
        slot_map.write(range(1020, 1030), random_splats(10), group=1)
    assert len(slot_map) == 3
    slot_map.clear(range(3))
    slot_map.write(range(1020, 1030), random_splats(10), group=1)
    assert [part.group for part in slot_map.groups()] == [1]
