"""SPZ: packed as the specification says, unpacked within its quantisation, and bad files named."""

import gzip
import struct
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zstandard
from numpy.typing import NDArray

from rosplat_core.formats import InputError, axes, load, save
from rosplat_core.models import Model
from rosplat_core.splats import Splats

FRACTIONAL_BITS = 12


def packed(splats: Splats, version: int) -> bytes:
    """The uncompressed SPZ stream of splats, value by value as the specification reads."""
    fields = (version, len(splats), splats.sh_degree, FRACTIONAL_BITS, int(splats.model), 0)
    return struct.pack("<4sIIBBBB", b"NGSP", *fields) + b"".join(attributes(splats, version))


def attributes(splats: Splats, version: int) -> list[bytes]:
    if version == 1:
        positions = splats.positions.astype("<f2").tobytes()
    else:
        steps = (round(float(value) * 2**FRACTIONAL_BITS) for value in splats.positions.flat)
        positions = b"".join(step.to_bytes(4, "little", signed=True)[:3] for step in steps)
    rotation = first_three if version < 3 else smallest_three
    return [
        positions,
        quantised(splats.opacities * 255),
        quantised(splats.sh[:, 0] * 0.15 * 255 + 127.5),
        quantised((np.log(splats.scales) + 10) * 16),
        b"".join(rotation(quaternion) for quaternion in splats.orientations),
        quantised(splats.sh[:, 1:] * 128 + 128),
    ]


def packed_4(splats: Splats, extensions: bytes = b"") -> bytes:
    """A file of version 4."""
    streams = [data for data in attributes(splats, 4) if data]
    frames = [zstandard.compress(data) for data in streams]
    flags = int(splats.model) | (2 if extensions else 0)
    fields = (4, len(splats), splats.sh_degree, FRACTIONAL_BITS, flags, len(frames))
    out = struct.pack("<4sIIBBBBI12x", b"NGSP", *fields, 32 + len(extensions)) + extensions
    for data, frame in zip(streams, frames, strict=True):
        out += struct.pack("<QQ", len(frame), len(data))
    return out + b"".join(frames)


def quantised(values: NDArray[Any]) -> bytes:
    return np.clip(np.round(values), 0, 255).astype(np.uint8).tobytes()


def first_three(quaternion: NDArray[np.float32]) -> bytes:
    return quantised(quaternion[:3] * np.copysign(127.5, quaternion[3]) + 127.5)


def smallest_three(quaternion: NDArray[np.float32]) -> bytes:
    largest = int(np.argmax(np.abs(quaternion)))
    word = largest
    for i in range(4):
        if i != largest:
            negative = (quaternion[i] < 0) != (quaternion[largest] < 0)
            magnitude = int(511 * abs(quaternion[i]) / np.sqrt(0.5) + 0.5)
            word = word << 10 | int(negative) << 9 | magnitude
    return word.to_bytes(4, "little")


@pytest.mark.parametrize("version", [1, 2, 3, 4])
@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_unpacks_within_quantisation(
    random_splats: Callable[..., Splats], tmp_path: Path, version: int, degree: int
) -> None:
    splats = random_splats(300, degree, model=Model(degree == 1))
    splats.sh[:, 1:] = np.clip(splats.sh[:, 1:], -0.99, 0.99)
    whole = packed_4(splats) if version == 4 else gzip.compress(packed(splats, version))
    (tmp_path / "a.spz").write_bytes(whole)
    back = load(tmp_path / "a.spz")
    assert back.model is splats.model
    step = 1 / 2**10 if version == 1 else 1 / 2**FRACTIONAL_BITS  # half floats up to 4
    np.testing.assert_allclose(back.positions, splats.positions, atol=1.02 * step)
    np.testing.assert_allclose(back.opacities, splats.opacities, atol=0.51 / 255)
    np.testing.assert_allclose(np.log(back.scales), np.log(splats.scales), atol=0.51 / 16)
    in_range = np.abs(splats.sh[:, 0]) < 0.5 / 0.15
    np.testing.assert_allclose(
        back.sh[:, 0][in_range], splats.sh[:, 0][in_range], atol=0.51 / 255 / 0.15
    )
    np.testing.assert_allclose(back.sh[:, 1:], splats.sh[:, 1:], atol=0.51 / 128)
    # Worst where the reconstructed component is small: only version 2 reconstructs such a one.
    cosine = np.abs((back.orientations * splats.orientations).sum(axis=1))
    assert np.degrees(2 * np.arccos(np.minimum(cosine, 1))).max() < (12 if version < 3 else 0.4)


@pytest.mark.parametrize(
    ("edit", "reason"),
    [
        (lambda data: b"NGSX" + data[4:], "not SPZ"),
        (lambda data: data[:4] + b"\x04" + data[5:], "version 4"),
        (lambda data: data[:12] + b"\x05" + data[13:], "SH degree 5"),
        (lambda data: data[:13] + b"\x63" + data[14:], "99 fractional bits"),
        (lambda data: data[:8] + b"\xff\xff\xff\xff" + data[12:], "4,294,967,295 splats"),
        (lambda data: data[:-5], "truncated: expected 450 bytes of sh, found 445"),
        (lambda data: data[:10], "truncated: 10 of a header's 16 bytes"),
    ],
)
def test_broken_streams(
    random_splats: Callable[..., Splats],
    tmp_path: Path,
    edit: Callable[[bytes], bytes],
    reason: str,
) -> None:
    data = edit(packed(random_splats(10), 3))
    (tmp_path / "broken.spz").write_bytes(gzip.compress(data))
    with pytest.raises(InputError, match=rf"broken\.spz: .*{reason}"):
        load(tmp_path / "broken.spz")


def test_truncated_and_damaged_gzip(random_splats: Callable[..., Splats], tmp_path: Path) -> None:
    whole = gzip.compress(packed(random_splats(10), 3))
    damaged = whole[:40] + bytes(b ^ 0x55 for b in whole[40:80]) + whole[80:]
    wrong_sum = whole[:-8] + bytes(4) + whole[-4:]
    for data in (whole[: len(whole) // 2], whole[:12], damaged, wrong_sum, whole[:-8]):
        (tmp_path / "broken.spz").write_bytes(data)
        with pytest.raises(InputError, match=r"broken\.spz: "):
            load(tmp_path / "broken.spz")


def test_what_follows_the_attributes_is_left_alone(
    random_splats: Callable[..., Splats], tmp_path: Path
) -> None:
    (tmp_path / "a.spz").write_bytes(gzip.compress(packed(random_splats(10), 3) + bytes(3 << 20)))
    assert len(load(tmp_path / "a.spz")) == 10


def test_the_specifications_example_of_colors_and_scales(tmp_path: Path) -> None:
    # By hand from README.md and load-spz.cc: bytes on the left, meanings on the right.
    header = struct.pack("<4sIIBBBB", b"NGSP", 2, 1, 0, 12, 0, 0)
    position = bytes([0x00, 0x10, 0x00, 0x00, 0xF0, 0xFF, 0x01, 0x00, 0x00])  # 1, -1, 2^-12
    rest = bytes([51, 0, 255, 51, 160, 176, 144, 255, 128, 128])
    (tmp_path / "a.spz").write_bytes(gzip.compress(header + position + rest))
    splats = load(tmp_path / "a.spz")
    np.testing.assert_allclose(splats.positions, [[1, -1, 2**-12]])
    np.testing.assert_allclose(splats.opacities, [0.2])
    np.testing.assert_allclose(splats.sh[0, 0], [-0.5 / 0.15, 0.5 / 0.15, -0.3 / 0.15], rtol=1e-6)
    np.testing.assert_allclose(np.log(splats.scales), [[0, 1, -1]], atol=1e-6)
    np.testing.assert_allclose(splats.orientations, [[1, 0, 0, 0]], atol=0.01)


@pytest.mark.parametrize("degree", [0, 3])
@pytest.mark.parametrize("model", [Model.EWA, Model.EWA_ANTIALIASED])
def test_round_trip(
    random_splats: Callable[..., Splats], tmp_path: Path, degree: int, model: Model
) -> None:
    splats = random_splats(500, degree, model=model)
    splats.sh[:, 1:] = np.clip(splats.sh[:, 1:], -0.9, 0.9)
    written = save(tmp_path / "a.spz", splats)
    back = load(tmp_path / "a.spz")
    assert back.model is model
    np.testing.assert_allclose(back.positions, written.positions, atol=0.51 / 2**FRACTIONAL_BITS)
    np.testing.assert_allclose(np.log(back.scales), np.log(written.scales), atol=0.51 / 16)
    np.testing.assert_allclose(back.opacities, written.opacities, atol=0.51 / 255)
    np.testing.assert_allclose(back.sh[:, 1:4], written.sh[:, 1:4], atol=4.51 / 128)  # 5 bits
    np.testing.assert_allclose(back.sh[:, 4:], written.sh[:, 4:], atol=8.51 / 128)  # 4 bits
    cosine = np.abs((back.orientations * written.orientations).sum(axis=1))
    assert np.degrees(2 * np.arccos(np.minimum(cosine, 1))).max() < 0.4


def test_wide_scenes_get_fewer_fractional_bits(
    random_splats: Callable[..., Splats], tmp_path: Path
) -> None:
    splats = random_splats(10, 0)
    far = replace(splats, origin=np.array([50_000.0, 0, -3000]))
    written = save(tmp_path / "a.spz", far)
    back = load(tmp_path / "a.spz")
    difference = back.positions + back.origin - (written.positions + written.origin)
    assert np.abs(difference).max() < 1 / 2**7
    with pytest.raises(InputError, match=r"b\.spz: a splat 9,000,00\d m from the origin"):
        save(tmp_path / "b.spz", replace(splats, origin=np.array([9e6, 0, 0])))
    assert not (tmp_path / "b.spz").exists()


def test_a_fourth_band_is_left_out_and_told(
    random_splats: Callable[..., Splats], tmp_path: Path
) -> None:
    splats = random_splats(5)
    data = bytearray(packed(splats, 3))
    data[12] = 4
    sh = np.frombuffer(bytes(data[-5 * 45 :]), np.uint8).reshape(5, 45)
    data[-5 * 45 :] = np.concatenate([sh, np.full((5, 27), 7, np.uint8)], axis=1).tobytes()
    (tmp_path / "a.spz").write_bytes(gzip.compress(bytes(data)))
    warnings: list[str] = []
    back = load(tmp_path / "a.spz", warn=warnings.append)
    assert back.sh_degree == 3
    assert len(warnings) == 1
    assert "band 4" in warnings[0]
    (tmp_path / "b.spz").write_bytes(gzip.compress(packed(splats, 3)))
    np.testing.assert_array_equal(back.sh, load(tmp_path / "b.spz").sh)


def test_axes_follow_the_extension(random_splats: Callable[..., Splats], tmp_path: Path) -> None:
    splats = random_splats(3)
    (tmp_path / "a.spz").write_bytes(packed_4(splats))
    assert axes(tmp_path / "a.spz").up == (0, 1, 0)
    other = struct.pack("<IIQ", 0xADBE0002, 8, 0)
    for number, up in ((6, (0, -1, 0)), (12, (0, 0, 1)), (0, (0, 1, 0))):
        system = struct.pack("<III", 0xADBE0003, 4, number)
        (tmp_path / "a.spz").write_bytes(packed_4(splats, other + system))
        assert axes(tmp_path / "a.spz").up == up
        assert len(load(tmp_path / "a.spz")) == 3
    (tmp_path / "a.spz").write_bytes(packed_4(splats, struct.pack("<III", 0xADBE0003, 4, 17)))
    with pytest.raises(InputError, match="coordinate system 17"):
        axes(tmp_path / "a.spz")


@pytest.mark.parametrize(
    ("place", "form", "value", "reason"),
    [
        (4, "<I", 5, "version 5"),
        (8, "<I", 40_000_000, "40,000,000 splats; a map has at most"),
        (8, "<I", 30_000_000, "30,000,000 splats can't be packed in"),
        (8, "<I", 11, "90 bytes of positions, expected 99 for 11 splats"),
        (12, "<B", 2, "450 bytes of sh, expected 240"),
        (15, "<B", 5, "5 streams, expected 6"),
        (16, "<I", 31, "table of contents at 31: not in the file"),
        (16, "<I", 10**6, "table of contents at 1,000,000: not in the file"),
        (32, "<Q", 2**40, "truncated: 1,099,511,627,776 bytes of positions"),
        (32, "<Q", 3, "positions: broken Zstandard frame"),
        (128, "<Q", 0, "positions: broken Zstandard frame"),
    ],
)
def test_damaged_version_4(
    random_splats: Callable[..., Splats], tmp_path: Path,
    place: int, form: str, value: int, reason: str,
) -> None:  # fmt: skip
    data = bytearray(packed_4(random_splats(10)))
    struct.pack_into(form, data, place, value)
    (tmp_path / "a.spz").write_bytes(data)
    with pytest.raises(InputError, match=rf"a\.spz: .*{reason}"):
        load(tmp_path / "a.spz")


def test_a_bomb_is_refused_before_it_is_unpacked(tmp_path: Path) -> None:
    header = struct.pack("<4sIIBBBB", b"NGSP", 3, 30_000_000, 0, 12, 0, 0)
    (tmp_path / "a.spz").write_bytes(gzip.compress(header + bytes(1 << 24), 9))
    (tmp_path / "b.spz").write_bytes(gzip.compress(header[:8] + bytes(8 + (1 << 25)), 9))
    tracemalloc.start()
    for name, reason in (("a", "can't be packed in 16,"), ("b", "16,777,216 bytes behind")):
        with pytest.raises(InputError, match=reason):
            load(tmp_path / f"{name}.spz")
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 1 << 23


def test_a_trained_scene(scene: Callable[[str], Path]) -> None:
    splats = load(scene("wolf.spz"))
    assert (len(splats), splats.sh_degree, splats.model) == (90_586, 3, Model.EWA)
