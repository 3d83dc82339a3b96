"""A streamed scene in a living map: right splats, never a hole, within the budget."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from streamed_scene import APART, LEVELS, write_scene
from test_detail import camera

from rosplat_core.formats.streamed_sog import open_streamed
from rosplat_core.posed_camera import PosedCamera
from rosplat_core.splats import InputError, Splats
from rosplat_testing.slot_map import SlotMap
from rosplat_tools.streaming.slot_allocator import slots_for
from rosplat_tools.streaming.streamed_map import StreamedMap

EVERYTHING = 1 << 25
SLOTS = tuple(map(slots_for, LEVELS))


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_scene(tmp_path_factory.mktemp("scene"))


class Living:
    """A map that looks at itself after each edit."""

    def __init__(self) -> None:
        self.map = SlotMap()
        self.edits = self.most = self.expected = 0
        self.shown: set[int] = set()

    def expect(self, slots: int) -> None:
        self.expected = slots

    def upsert(self, slots: Any, splats: Splats) -> None:
        self.map.write(slots, splats)
        self._look()

    def delete(self, slots: Any) -> None:
        self.map.clear(slots)
        self._look()

    def chunks(self) -> dict[int, int]:
        """How many splats of each chunk there are."""
        splats = self.map.snapshot()[1]
        numbers, counts = np.unique(np.round(splats.positions[:, 0] / APART), return_counts=True)
        return {int(number): int(count) for number, count in zip(numbers, counts, strict=True)}

    def _look(self) -> None:
        self.edits += 1
        self.most = max(self.most, len(self.map))
        now = set(self.chunks())
        assert now >= self.shown, "a hole"
        self.shown = now


def stream(
    path: Path, budget: int = EVERYTHING, target: float = 1e-3
) -> tuple[StreamedMap, Living]:
    living = Living()
    streamed = StreamedMap(
        open_streamed(path), living, budget=budget, target=target, warn=pytest.fail
    )
    return streamed, living


def before(chunk: int) -> PosedCamera:
    """A camera near a chunk, which looks along x away from the others beyond it."""
    return camera((APART * chunk - 4.0, 0.0, 0.5), orientation=(0.5, 0.5, 0.5, 0.5))


def settle(streamed: StreamedMap, *views: PosedCamera) -> int:
    steps = 0
    while streamed.step(views):
        steps += 1
        assert steps < 200
    return steps


def test_all_of_it_comes_and_only_once(path: Path) -> None:
    streamed, living = stream(path)
    settle(streamed)
    assert living.chunks() == dict.fromkeys(range(4), LEVELS[2])
    settle(streamed, before(0))
    assert living.chunks() == dict.fromkeys(range(4), LEVELS[0])
    assert streamed.splats == 4 * LEVELS[0]
    assert living.expected == 4 * LEVELS[0]
    edits = living.edits
    streamed.step([before(0), before(3)])
    assert living.edits == edits
    assert "12,000 of 12,000 splats, 4 of 4 chunks" in str(streamed)


def test_what_is_missing_comes_at_its_coarsest_first(path: Path) -> None:
    streamed, living = stream(path)
    seen: dict[int, int] = {}
    more = True
    while more:
        more = streamed.step([before(0)], patience=1e-3)
        for chunk, count in living.chunks().items():
            seen.setdefault(chunk, count)
    assert seen == dict.fromkeys(range(4), LEVELS[2])
    assert living.chunks()[0] == LEVELS[0]


def test_the_budget_follows_the_camera_and_no_chunk_is_ever_missing(path: Path) -> None:
    budget = SLOTS[0] + 3 * SLOTS[2]
    streamed, living = stream(path, budget)
    for chunk in (0, 3, 1, 2, 0):
        settle(streamed, before(chunk))
        found = living.chunks()
        assert len(found) == 4
        assert found[chunk] == LEVELS[0]
        assert sum(found.values()) <= budget
    assert living.most <= 2 * budget  # chunks' old levels and their new ones
    assert living.map.snapshot()[0][-1] < 2 * budget + 1024  # holes are used again


def test_two_views_share_the_budget(path: Path) -> None:
    streamed, living = stream(path, 2 * SLOTS[0] + 2 * SLOTS[2])
    settle(streamed, before(0), before(3))
    found = living.chunks()
    assert found[0] == found[3] == LEVELS[0]


def test_a_budget_for_less_than_all_chunks_shows_the_nearest(path: Path) -> None:
    streamed, living = stream(path, SLOTS[2])
    settle(streamed, before(2))
    assert living.chunks() == {2: LEVELS[2]}
    assert living.expected == LEVELS[2]
    streamed, living = stream(path, 1)
    settle(streamed, before(2))
    assert living.edits == 0


def test_a_damaged_file_is_told_once_and_done_without(tmp_path: Path) -> None:
    path = write_scene(tmp_path)
    streamed, living = stream(path)
    (tmp_path / "0_0" / "quats.webp").write_bytes(b"no picture")
    told = []
    more = True
    while more:
        try:
            more = streamed.step([before(1)])
        except InputError as error:
            told.append(str(error))
            assert len(told) < 20
    assert len(told) == 1
    assert "0_0/meta.json: quats.webp" in told[0]
    assert living.chunks() == dict.fromkeys(range(4), LEVELS[1])


def test_it_says_what_is_there_and_what_is_on_its_way(path: Path) -> None:
    streamed, living = stream(path)
    settle(streamed)
    assert "on their way" not in str(streamed)
    while streamed.step([before(0)], patience=1e-9) and streamed.splats == 4 * LEVELS[2]:
        assert "400 of 12,000 splats, 4 of 4 chunks" in str(streamed)
        assert "on their way: 12,000 splats of 4 chunks" in str(streamed)
        assert living.expected == 4 * LEVELS[0]
        break
    streamed.close()


def test_what_cannot_be_drawn_is_not_waited_for(tmp_path: Path) -> None:
    path = write_scene(tmp_path)
    for level in range(len(LEVELS)):
        meta = tmp_path / f"{level}_0" / "meta.json"
        fields = json.loads(meta.read_text())
        fields["scales"]["codebook"][0] = 1e9  # e to that is no number
        meta.write_text(json.dumps(fields))
    living = Living()
    streamed = StreamedMap(
        open_streamed(path), living, budget=EVERYTHING, target=1e-3, warn=lambda text: None
    )
    settle(streamed, before(0))
    streamed.step([before(0)])
    assert 0 < streamed.splats == living.expected == len(living.map) < 4 * LEVELS[0]


def test_whoever_is_closed_reads_nothing_more(path: Path) -> None:
    streamed, living = stream(path)
    streamed.close()
    with pytest.raises(RuntimeError):
        settle(streamed, before(0))
    assert living.edits == 0
