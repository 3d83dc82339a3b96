"""Levels of detail for views: against a plain twin, within the budget, and without thrashing."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from rosplat_core.posed_camera import PosedCamera
from rosplat_tools.streaming.detail import (
    BEHIND,
    LOYALTY,
    NOTHING,
    Levels,
    choose,
    errors,
    magnification,
)  # fmt: skip
from rosplat_tools.streaming.slot_allocator import slots_for


def camera(position: tuple[float, float, float] = (0, 0, 0), **given: object) -> PosedCamera:
    values = {
        "position": position, "orientation": (0, 0, 0, 1), "orthographic": False,
        "fx": 500.0, "fy": 500.0, "cx": 320.0, "cy": 240.0,
        "width": 640, "height": 480, "near_clip": 0.1, "far_clip": 1e4,
    }  # fmt: skip
    return PosedCamera(**(values | given))


def row(n: int, counts: tuple[int, ...] = (2000, 20_000, 200_000)) -> Levels:
    """Cubes of a metre along z."""
    low = np.column_stack([np.full((n, 2), -0.5), 10.0 * np.arange(1, n + 1)])
    return Levels(low, low + 1, [counts] * n)


def plain(
    chunks: Levels, scale: np.ndarray, held: list[int], budget: int, target: float
) -> list[int]:
    """What choose does, by looking at all chunks for each step."""
    found, levels, done = errors(chunks, scale), [NOTHING] * len(held), set()
    while True:
        best, which = -1.0, -1
        for chunk, counts in enumerate(chunks.counts):
            level = levels[chunk]
            if chunk in done or level + 1 == len(counts):
                continue
            error = found[chunk][level + 1]
            if level < held[chunk]:
                worth = LOYALTY * error
            else:
                worth = error if level == NOTHING or error > target else -1.0
            if worth > best:
                best, which = worth, chunk
        if which < 0:
            return levels
        levels[which] += 1
        if sum(taken(chunks, levels)) > budget:
            levels[which] -= 1
            done.add(which)


def taken(chunks: Levels, levels: list[int]) -> list[int]:
    pairs = zip(chunks.counts, levels, strict=True)
    return [slots_for(counts[level]) for counts, level in pairs if level != NOTHING]


@settings(deadline=None)
@given(data=st.data())
def test_levels_are_those_of_the_plain_twin_and_within_the_budget(data: st.DataObject) -> None:
    n = data.draw(st.integers(1, 8))
    counts = st.lists(st.integers(1, 50_000), max_size=4).map(lambda found: tuple(sorted(found)))
    rng = np.random.default_rng(data.draw(st.integers(0, 99)))
    low = rng.normal(size=(n, 3))
    chunks = Levels(
        low,
        low + rng.choice([0, 3], (n, 1)) * rng.uniform(size=(n, 3)),
        [data.draw(counts) for _ in range(n)],
    )
    held = [data.draw(st.integers(NOTHING, len(counts) - 1)) for counts in chunks.counts]
    budget, target = data.draw(st.integers(0, 300_000)), data.draw(st.floats(0.001, 100))
    scale = rng.uniform(1, 1000, n)
    levels = choose(chunks, scale, held, budget, target)
    assert levels == plain(chunks, scale, held, budget, target)
    assert sum(taken(chunks, levels)) <= budget


def test_what_is_near_is_finer_and_all_is_held_before_anything_is_fine() -> None:
    chunks = row(20)
    scale = magnification(chunks, [camera()])
    assert (np.diff(scale) < 0).all()
    levels = choose(chunks, scale, [NOTHING] * 20, 20 * slots_for(2000) + 200_000, 0.01)
    assert min(levels) == 0
    assert levels == sorted(levels, reverse=True)
    assert levels[0] > 0


def test_a_budget_of_nothing_and_of_everything() -> None:
    chunks = row(5)
    scale = magnification(chunks, [camera()])
    assert choose(chunks, scale, [NOTHING] * 5, 0, 1e-3) == [NOTHING] * 5
    assert choose(chunks, scale, [NOTHING] * 5, 1 << 25, 1e-3) == [2] * 5
    # For two chunks, it is those nearest.
    assert choose(chunks, scale, [NOTHING] * 5, 2 * slots_for(2000), 1e-3) == [0, 0, -1, -1, -1]


def test_what_is_out_of_sight_counts_less_but_counts() -> None:
    chunks = row(3)
    back = camera(orientation=(0, 1, 0, 0))  # looks along -z
    ahead, behind = (magnification(chunks, [view]) for view in (camera(), back))
    np.testing.assert_allclose(behind, BEHIND * ahead)
    # Each view has its say: what one of them shows is as fine as for that one alone.
    np.testing.assert_array_equal(magnification(chunks, [camera(), back]), ahead)
    aside = camera((200.0, 0, 0))
    np.testing.assert_allclose(magnification(chunks, [aside])[0], BEHIND * 500 / 199.75, rtol=0.01)


def test_orthographic_views_have_one_scale() -> None:
    view = camera(orthographic=True, fx=30.0, fy=40.0)
    np.testing.assert_allclose(magnification(row(3), [view]), 40)


def test_without_a_view_all_have_their_coarsest() -> None:
    chunks = row(3)
    scale = magnification(chunks, [])
    assert choose(chunks, scale, [NOTHING] * 3, 1 << 25, 1e-3) == [0, 0, 0]


def test_a_chunk_that_is_a_point_is_held_as_well() -> None:
    chunks = Levels(np.zeros((2, 3)), np.array([[0.0, 0, 0], [1, 1, 1]]), [(1, 2), (1, 2)])
    scale = magnification(chunks, [camera((0, 0, -5))])
    assert choose(chunks, scale, [NOTHING] * 2, 1 << 25, 1.0) == [0, 1]
    assert choose(chunks, scale, [NOTHING] * 2, slots_for(1), 1.0) == [NOTHING, 1]


def test_a_view_that_sways_has_nothing_fetched_and_dropped_in_turn() -> None:
    chunks = Levels(
        np.array([[-3.0, -1, 9], [1.0, -1, 9]]), np.array([[-1.0, 1, 11], [3.0, 1, 11]]),
        [(1024, 102_400)] * 2,
    )  # fmt: skip
    budget = 1024 + 102_400  # one of the two is fine
    held, changes = [NOTHING, NOTHING], 0
    for turn in range(20):
        scale = magnification(chunks, [camera((0.3 * (-1) ** turn, 0, 0))])
        levels = choose(chunks, scale, held, budget, 0.01)
        changes += levels != held
        held = levels
    assert sorted(held) == [0, 1]
    assert changes == 1
    # One that goes there for good does.
    scale = magnification(chunks, [camera((2.0, 0, 5))])
    assert choose(chunks, scale, held, budget, 0.01) == [0, 1]


def test_what_is_fine_stays_where_there_is_room() -> None:
    chunks = row(3)
    near, far = (magnification(chunks, [camera((0, 0, z))]) for z in (9.5, -5000.0))
    fine = choose(chunks, near, [NOTHING] * 3, 1 << 25, 1.0)
    assert max(fine) == 2
    assert choose(chunks, far, fine, 1 << 25, 1.0) == fine
    assert choose(chunks, far, [NOTHING] * 3, 1 << 25, 1.0) == [0, 0, 0]
    assert choose(chunks, far, fine, 3 * slots_for(2000), 1.0) == [0, 0, 0]
