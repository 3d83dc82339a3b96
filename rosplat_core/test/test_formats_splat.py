""".splat: 32 bytes a splat, read and written as antimatter15's convert.py and main.js do."""

import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rosplat_core.formats import InputError, axes, load, save
from rosplat_core.splats import Splats


def test_a_record_by_hand(tmp_path: Path) -> None:
    record = struct.pack("<6f8B", 1, -2, 3, 0.5, 0.25, 2, 255, 0, 51, 204, 128, 128, 0, 128)
    (tmp_path / "a.splat").write_bytes(record)
    splats = load(tmp_path / "a.splat")
    np.testing.assert_array_equal(splats.positions, [[1, -2, 3]])
    np.testing.assert_array_equal(splats.scales, [[0.5, 0.25, 2]])
    rgb = 0.28209479 * splats.sh[0, 0] + 0.5
    np.testing.assert_allclose(rgb, [1, 0, 0.2], atol=1e-6)
    np.testing.assert_allclose(splats.opacities, [0.8])
    np.testing.assert_array_equal(splats.orientations, [[0, -1, 0, 0]])  # x y z w of w x y z
    assert axes(tmp_path / "a.splat").up is None


def test_a_negative_scale_is_left_out(tmp_path: Path) -> None:
    good = struct.pack("<6f8B", 1, -2, 3, 0.5, 0.25, 2, 255, 0, 51, 204, 128, 128, 0, 128)
    bad = struct.pack("<6f8B", 1, -2, 3, -0.5, 0.25, 2, 255, 0, 51, 204, 128, 128, 0, 128)
    (tmp_path / "a.splat").write_bytes(bad + good)
    told: list[str] = []
    assert len(load(tmp_path / "a.splat", warn=told.append)) == 1
    assert "a negative scale" in told[0]


def test_round_trip(random_splats: Callable[..., Splats], tmp_path: Path) -> None:
    splats = replace(random_splats(20_000, 1), origin=np.array([20.0, 0, 0]))
    splats.sh[:, 0] = np.clip(splats.sh[:, 0], -1.7, 1.7)
    save(tmp_path / "a.splat", splats)
    assert (tmp_path / "a.splat").stat().st_size == 32 * 20_000
    back = load(tmp_path / "a.splat")
    np.testing.assert_allclose(back.positions, splats.positions + splats.origin, rtol=1e-6)
    np.testing.assert_array_equal(back.scales, splats.scales)
    np.testing.assert_allclose(back.opacities, splats.opacities, atol=0.51 / 255)
    np.testing.assert_allclose(back.sh[:, 0], splats.sh[:, 0], atol=0.51 / 255 / 0.282)
    cosine = np.abs((back.orientations * splats.orientations).sum(axis=1))
    assert np.degrees(2 * np.arccos(np.minimum(cosine, 1))).max() < 1


@pytest.mark.parametrize("size", [1, 33, 63])
def test_parts_of_a_splat_are_refused(tmp_path: Path, size: int) -> None:
    (tmp_path / "a.splat").write_bytes(bytes(size))
    with pytest.raises(InputError, match=rf"a\.splat: {size} bytes are no whole number of splats"):
        load(tmp_path / "a.splat")


def test_a_map_of_a_robot(scene: Callable[[str], Path]) -> None:
    tiles = [load(path) for path in sorted(scene("istanbul").glob("*.splat"))]
    assert sum(len(tile) for tile in tiles) == 408_887
    assert all(tile.sh_degree == 0 for tile in tiles)
