"""A folder of tiles is a scene; a model's folder is its newest iteration."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rosplat_core.formats import InputError, format_of, load, save, scene_file
from rosplat_core.splats import Splats, concatenate

Make = Callable[..., Splats]

MODEL = "point_cloud"


@pytest.mark.parametrize("ending", [".ply", ".splat"])
def test_tiles_are_one_scene(random_splats: Make, tmp_path: Path, ending: str) -> None:
    tiles = [random_splats(20 + seed, 0, seed) for seed in range(3)]
    for number, tile in enumerate(tiles):
        tile = replace(tile, origin=np.array([100.0 * number, 0, 0]))
        save(tmp_path / f"tile_{number}{ending}", tile)
    (tmp_path / "readme.txt").write_text("six tiles")
    (tmp_path / f"._tile_0{ending}").write_bytes(bytes(64))  # of macOS
    told: list[float] = []
    splats = load(tmp_path, told.append)
    joined = concatenate([load(tmp_path / f"tile_{i}{ending}") for i in range(3)])
    np.testing.assert_array_equal(splats.positions, joined.positions)
    np.testing.assert_array_equal(splats.sh, joined.sh)
    assert told == sorted(told)
    assert format_of(tmp_path).NAME == "a folder of tiles"


def test_a_scene_in_two_formats_has_to_be_named(random_splats: Make, tmp_path: Path) -> None:
    for ending in (".ply", ".splat"):
        save(tmp_path / f"a{ending}", random_splats(3))
    with pytest.raises(InputError, match=r"holds \.ply and \.splat: name a file"):
        load(tmp_path)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (
            f"{MODEL}/iteration_7000/point_cloud.ply",
            f"{MODEL}/iteration_30000/point_cloud.ply",
        ),
        (f"{MODEL}/iteration_7000/point_cloud.ply", f"{MODEL}/final/point_cloud.ply"),
        (f"{MODEL}/final/point_cloud.ply", f"{MODEL}/final_after_opt/point_cloud.ply"),
        (
            f"900_shutdown/ply/{MODEL}/iteration_900/point_cloud.ply",
            f"1000_shutdown/ply/{MODEL}/iteration_1000/point_cloud.ply",
        ),
        ("ply/point_cloud_6999.ply", "ply/point_cloud_29999.ply"),
        ("export_5000.ply", "export_30000.ply"),
        ("splat_7000.ply", "splat_30000.ply"),
    ],
)
def test_a_model_is_its_newest_iteration(
    random_splats: Make, tmp_path: Path, old: str, new: str
) -> None:
    for name, count in ((old, 3), (new, 4)):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        save(tmp_path / name, random_splats(count))
    told: list[str] = []
    assert len(load(tmp_path, warn=told.append)) == 4
    assert told == [f"{tmp_path}: {new} is read, the newest of 2"]
    assert scene_file(tmp_path) == tmp_path / new
    assert scene_file(tmp_path / old) == tmp_path / old


def test_an_empty_folder_is_no_scene(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="not a scene"):
        load(tmp_path)
