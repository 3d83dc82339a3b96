""".ksplat: every level, sections and buckets come back as splats; damage is named."""

import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from ksplat_file import ksplat

from rosplat_core.formats import InputError, load
from rosplat_core.splats import Splats, concatenate

Make = Callable[..., Splats]


def scene(make: Make, count: int, degree: int, seed: int = 0) -> Splats:
    splats = make(count, degree, seed=seed)
    splats.positions[:] = np.clip(splats.positions, -2.4, 2.4)
    splats.sh[:, 0] = np.clip(splats.sh[:, 0], -1.7, 1.7)
    splats.sh[:, 1:] = np.clip(splats.sh[:, 1:], -1.5, 1.5)
    return splats


@pytest.mark.parametrize("level", [0, 1, 2])
@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_every_level_and_degree(
    random_splats: Make, tmp_path: Path, level: int, degree: int
) -> None:
    parts = [scene(random_splats, 37, degree), scene(random_splats, 48, degree, 1)]
    (tmp_path / "a.ksplat").write_bytes(ksplat(parts, level))
    splats, back = concatenate(parts), load(tmp_path / "a.ksplat")
    assert back.sh_degree == degree
    np.testing.assert_allclose(back.positions, splats.positions, atol=0.51 * 2.5 / 32767)
    np.testing.assert_allclose(back.scales, splats.scales, rtol=1e-3)
    np.testing.assert_allclose(back.opacities, splats.opacities, atol=0.51 / 255)
    np.testing.assert_allclose(back.sh[:, 0], splats.sh[:, 0], atol=0.51 / 255 / 0.282)
    step = (1e-6, 1e-3, 3 / 255)[level]
    np.testing.assert_allclose(back.sh[:, 1:], splats.sh[:, 1:], atol=1.01 * step)
    np.testing.assert_allclose(back.orientations, splats.orientations, atol=2e-3)


def test_buckets_have_centres(random_splats: Make, tmp_path: Path) -> None:
    splats = scene(random_splats, 40, 0)  # two full buckets, and one of 8
    data = bytearray(ksplat([splats], 1))
    centres = np.array([[10, 0, 0], [0, 20, 0], [0, 0, 30]], "<f4")
    start = 4096 + 1024 + 4
    data[start : start + 36] = centres.tobytes()
    (tmp_path / "a.ksplat").write_bytes(data)
    moved = load(tmp_path / "a.ksplat").positions - splats.positions
    expected = np.repeat(centres, [16, 16, 8], axis=0)
    np.testing.assert_allclose(moved, expected, atol=1e-3)


def test_sections_of_several_degrees(random_splats: Make, tmp_path: Path) -> None:
    parts = [scene(random_splats, 5, 0), scene(random_splats, 5, 2)]
    (tmp_path / "a.ksplat").write_bytes(ksplat(parts, 0))
    back = load(tmp_path / "a.ksplat")
    assert back.sh_degree == 2
    assert not back.sh[:5, 1:].any()
    np.testing.assert_allclose(back.sh[5:, 1:], parts[1].sh[:, 1:], atol=1e-6)


@pytest.mark.parametrize(
    ("place", "form", "value", "reason"),
    [
        (0, "<B", 1, "KSPLAT version 1.1"),
        (4, "<I", 2**31, "truncated: no room for 2,147,483,648 sections"),
        (16, "<I", 9, "9 splats, but 40 in its sections"),
        (20, "<H", 3, "compression level 3"),
        (4096, "<I", 41, "section 0: 41 splats, room for 40"),
        (4100, "<I", 2**32 - 1, "truncated: section 0 ends at"),
        (4104, "<I", 17, "the buckets of a section don't hold its 40 splats"),
        (4108, "<I", 2**32 - 1, "truncated: section 0"),
        (4116, "<H", 0, "the buckets of a section don't hold its 40 splats"),
        (4128, "<I", 2**32 - 1, "the buckets of a section don't hold"),
        (4132, "<I", 2**32 - 1, "truncated: section 0"),
        (4136, "<H", 4, "section 0: SH degree 4"),
        (5120, "<I", 7, "the buckets of a section don't hold"),
    ],
)
def test_damaged_headers(
    random_splats: Make, tmp_path: Path, place: int, form: str, value: int, reason: str
) -> None:
    data = bytearray(ksplat([scene(random_splats, 40, 1)], 1))
    struct.pack_into(form, data, place, value)
    (tmp_path / "a.ksplat").write_bytes(data)
    with pytest.raises(InputError, match=rf"a\.ksplat: {reason}"):
        load(tmp_path / "a.ksplat")


def test_short_files(random_splats: Make, tmp_path: Path) -> None:
    data = ksplat([scene(random_splats, 40, 1)], 2)
    for size in (0, 1, 4095, 4096, 5119, 5120, len(data) - 1):
        (tmp_path / "a.ksplat").write_bytes(data[:size])
        with pytest.raises(InputError, match=r"a\.ksplat: truncated"):
            load(tmp_path / "a.ksplat")
