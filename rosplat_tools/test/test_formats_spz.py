"""SPZ: packed as the specification says, unpacked within its quantisation, and bad files named."""

import gzip
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from rosplat_tools.formats import SceneError, load
from rosplat_tools.splats import Splats

FRACTIONAL_BITS = 12


def packed(splats: Splats, version: int) -> bytes:
    """The uncompressed SPZ stream of splats, value by value as the specification reads."""
    fields = (version, len(splats), splats.sh_degree, FRACTIONAL_BITS, int(splats.antialiased), 0)
    out = struct.pack("<4sIIBBBB", b"NGSP", *fields)
    for value in splats.positions.flat:
        out += round(float(value) * 2**FRACTIONAL_BITS).to_bytes(4, "little", signed=True)[:3]
    out += quantised(splats.opacities * 255)
    out += quantised(splats.sh[:, 0] * 0.15 * 255 + 127.5)
    out += quantised((np.log(splats.scales) + 10) * 16)
    for quaternion in splats.orientations:
        out += first_three(quaternion) if version == 2 else smallest_three(quaternion)
    return out + quantised(splats.sh[:, 1:] * 128 + 128)


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


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_unpacks_within_quantisation(
    random_splats: Callable[..., Splats], tmp_path: Path, version: int, degree: int
) -> None:
    splats = random_splats(300, degree, antialiased=degree == 1)
    splats.sh[:, 1:] = np.clip(splats.sh[:, 1:], -0.99, 0.99)
    (tmp_path / "a.spz").write_bytes(gzip.compress(packed(splats, version)))
    back = load(tmp_path / "a.spz")
    assert back.antialiased == splats.antialiased
    np.testing.assert_allclose(back.positions, splats.positions, atol=0.51 / 2**FRACTIONAL_BITS)
    np.testing.assert_allclose(back.opacities, splats.opacities, atol=0.51 / 255)
    np.testing.assert_allclose(np.log(back.scales), np.log(splats.scales), atol=0.51 / 16)
    in_range = np.abs(splats.sh[:, 0]) < 0.5 / 0.15
    np.testing.assert_allclose(
        back.sh[:, 0][in_range], splats.sh[:, 0][in_range], atol=0.51 / 255 / 0.15
    )
    np.testing.assert_allclose(back.sh[:, 1:], splats.sh[:, 1:], atol=0.51 / 128)
    # Worst where the reconstructed component is small: only version 2 reconstructs such a one.
    cosine = np.abs((back.orientations * splats.orientations).sum(axis=1))
    assert np.degrees(2 * np.arccos(np.minimum(cosine, 1))).max() < (12 if version == 2 else 0.4)


@pytest.mark.parametrize(
    ("edit", "reason"),
    [
        (lambda data: b"NGSX" + data[4:], "not SPZ"),
        (lambda data: data[:4] + b"\x01" + data[5:], "version 1"),
        (lambda data: data[:12] + b"\x04" + data[13:], "SH degree 4"),
        (lambda data: data[:13] + b"\x63" + data[14:], "99 fractional bits"),
        (lambda data: data[:8] + b"\xff\xff\xff\xff" + data[12:], "4,294,967,295 splats"),
        (lambda data: data[:-5], "truncated: expected 450 bytes of sh, found 445"),
        (lambda data: data[:10], "not SPZ"),
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
    with pytest.raises(SceneError, match=rf"broken\.spz: .*{reason}"):
        load(tmp_path / "broken.spz")


def test_truncated_and_damaged_gzip(random_splats: Callable[..., Splats], tmp_path: Path) -> None:
    whole = gzip.compress(packed(random_splats(10), 3))
    damaged = whole[:40] + bytes(b ^ 0x55 for b in whole[40:80]) + whole[80:]
    wrong_sum = whole[:-8] + bytes(4) + whole[-4:]
    for data in (whole[: len(whole) // 2], whole[:12], damaged, wrong_sum, whole[:-8]):
        (tmp_path / "broken.spz").write_bytes(data)
        with pytest.raises(SceneError, match=r"broken\.spz: "):
            load(tmp_path / "broken.spz")


def test_what_follows_the_attributes_is_left_alone(
    random_splats: Callable[..., Splats], tmp_path: Path
) -> None:
    (tmp_path / "a.spz").write_bytes(gzip.compress(packed(random_splats(10), 3) + bytes(3 << 20)))
    assert len(load(tmp_path / "a.spz")) == 10


def test_version_4_is_named(tmp_path: Path) -> None:
    (tmp_path / "new.spz").write_bytes(b"NGSP" + bytes([4, 0, 0, 0]) + bytes(24))
    with pytest.raises(SceneError, match="version 4"):
        load(tmp_path / "new.spz")


def test_a_trained_scene(scene: Callable[[str], Path]) -> None:
    splats = load(scene("wolf.spz"))
    assert (len(splats), splats.sh_degree, splats.antialiased) == (90_586, 3, False)
