"""Procedural scenes: reproducible, and sound at any size."""

from pathlib import Path

import numpy as np
import pytest

from rosplat_core.formats import InputError, load
from rosplat_core.generated import SCENES, generate
from rosplat_tools.generate import main

every_scene = pytest.mark.parametrize("scene", SCENES)


@every_scene
@pytest.mark.parametrize("count", [1, 2, 17, 1000, 30_000])
def test_any_count_is_sound(scene: str, count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rosplat_core.generated.BLOCK", 1 << 13)
    splats = generate(count, scene=scene)
    assert len(splats) == count
    for array in (
        splats.positions,
        splats.orientations,
        splats.scales,
        splats.opacities,
        splats.sh,
    ):
        assert np.isfinite(array).all()
    np.testing.assert_allclose(np.linalg.norm(splats.orientations, axis=1), 1, atol=1e-5)
    assert (splats.scales > 0).all()
    assert ((splats.opacities > 0) & (splats.opacities <= 1)).all()
    assert np.abs(splats.positions).max() < {"garden": 3, "rooms": 7}[scene]


@every_scene
def test_the_seed_decides(scene: str) -> None:
    one, same, other = (generate(2000, seed, scene=scene) for seed in (5, 5, 6))
    np.testing.assert_array_equal(one.positions, same.positions)
    np.testing.assert_array_equal(one.sh, same.sh)
    assert (one.positions != other.positions).any()


def test_lower_degrees_are_the_same_scene_with_fewer_bands() -> None:
    full = generate(500)
    for degree in range(3):
        np.testing.assert_array_equal(
            generate(500, sh_degree=degree).sh, full.with_sh_degree(degree).sh
        )


@every_scene
def test_any_part_shows_all_of_the_scene(scene: str) -> None:
    splats = generate(40_000, scene=scene)
    for part in (splats[:4000], splats[-4000:]):
        np.testing.assert_allclose(
            part.positions.mean(axis=0), splats.positions.mean(axis=0), atol=0.15
        )
        np.testing.assert_allclose(
            part.positions.std(axis=0), splats.positions.std(axis=0), atol=0.1
        )


@pytest.mark.parametrize(
    "wrong",
    [{"count": 0}, {"count": 10**30}, {"seed": -1}, {"sh_degree": 4}, {"sh_degree": -1}],
)
def test_what_cannot_be_made(wrong: dict[str, int]) -> None:
    with pytest.raises(InputError, match="expected"):
        generate(**({"count": 10} | wrong))


def test_its_progress_is_told_and_may_end_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rosplat_core.generated.BLOCK", 1000)
    told: list[float] = []
    generate(2001, progress=told.append)
    assert told == sorted(told)
    assert len(told) == 3
    assert told[-1] == 1

    def stop(part: float) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        generate(10, progress=stop)


def test_the_command_writes_a_scene(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(tmp_path / "a.ply"), "--count", "300", "--seed", "2", "--sh-degree", "1"]) == 0
    splats = load(tmp_path / "a.ply")
    np.testing.assert_allclose(splats.positions, generate(300, 2).positions)
    assert (len(splats), splats.sh_degree) == (300, 1)
    assert main([str(tmp_path / "a.ply"), "--count", "10"]) == 1
    assert "a.ply: exists already" in capsys.readouterr().err
    assert main([str(tmp_path / "a.ply"), "--count", "10", "--overwrite"]) == 0
    assert len(load(tmp_path / "a.ply")) == 10
    assert main([str(tmp_path / "r.ply"), "--count", "300", "--scene", "rooms"]) == 0
    np.testing.assert_array_equal(
        load(tmp_path / "r.ply").positions, generate(300, scene="rooms").positions
    )
    assert main([str(tmp_path / "b.ply"), "--count", "0"]) == 1
    assert main([str(tmp_path / "a.obj"), "--count", "9" * 12]) == 1  # said before it is made
    assert "a.obj: can't write" in capsys.readouterr().err
