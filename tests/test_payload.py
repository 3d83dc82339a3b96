"""Splats as a payload: read as its document says, and drawn as those that went in."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from rosplat_core import rendering
from rosplat_core._core import pack_splats
from rosplat_core.cameras import Camera, look_at
from rosplat_core.generated import generate
from rosplat_core.payload import PACKED, QUANTISED, Arrays, decode, encode, size, suits
from rosplat_core.rendering import insert_all, posed
from rosplat_core.splats import Splats
from rosplat_lab.metrics import psnr
from rosplat_testing.messages import is_usable

LEAST = 55.0  # [dB]
CHECKOUT = Path(__file__).resolve().parents[1]


def arrays_of(splats: Splats) -> Arrays:
    return Arrays(splats.positions, splats.orientations, splats.scales, splats.opacities, splats.sh)


def decoded(payload: NDArray[np.uint8], n: int, sh_degree: int) -> Arrays:
    """As rosplat_msgs/doc/quantised.md says, and nothing else."""
    rest = 3 * ((sh_degree + 1) ** 2 - 1)
    bounds = payload[:40].view("<f4").reshape(5, 2).astype(np.float64)
    bits = np.unpackbits(payload[40 : 40 + 24 * n].reshape(n, 24), axis=1, bitorder="little")

    def codes(first: int, count: int) -> NDArray[np.int64]:
        taken: NDArray[np.int64] = bits[:, first : first + count] @ (1 << np.arange(count))
        return taken

    def between(code: NDArray[np.int64], which: int, steps: int) -> NDArray[np.float64]:
        lower, upper = bounds[which]
        value: NDArray[np.float64] = lower + code * (upper - lower) / steps
        return value

    positions = np.stack([between(codes(24 * k, 24), k, 2**24 - 1) for k in range(3)], axis=1)
    s = np.stack([codes(72 + 12 * k, 12) for k in range(3)], axis=1)
    scales = np.exp(between(s - 1, 3, 4093))
    scales[s == 0] = 0
    scales[s == 4095] = np.nan
    largest = np.float64(np.float32(0.70710684))
    others = np.stack([-largest + codes(110 + 12 * k, 12) * 2 * largest / 4095 for k in range(3)])
    k = codes(108, 2)
    orientations = np.empty((n, 4))
    for i, component in enumerate(others):
        orientations[np.arange(n), (k + 1 + i) % 4] = component
    orientations[np.arange(n), k] = np.sqrt(np.maximum(0, 1 - (others**2).sum(axis=0)))
    v = np.stack([between(codes(156 + 12 * k, 12), 4, 4095) for k in range(3)], axis=1)
    sh = np.zeros((n, 1 + rest // 3, 3))
    sh[:, 0] = np.sign(v) * (np.exp(np.abs(v)) - 1)
    if rest:
        strengths = payload[40 + 24 * n : 40 + 25 * n].astype(np.float64)
        steps = np.where(strengths, 2 ** ((strengths - 128) / 8) / 127, 0)
        harmonics = payload[40 + 25 * n :].view(np.int8).reshape(n, -1, 3)
        sh[:, 1:] = harmonics * steps.astype(np.float32)[:, None, None]
    arrays = (positions, orientations, scales, codes(146, 10) / 1023, sh)
    return Arrays(*(array.astype(np.float32) for array in arrays))


def unpacked(payload: NDArray[np.uint8], n: int, sh_degree: int) -> Arrays:
    """As rosplat_msgs/doc/packed.md says, and nothing else."""
    words = payload.view("<u4").reshape(n, 8 + (sh_degree + 1) ** 2).astype(np.int64)

    def signed(code: NDArray[np.int64], bits: int) -> NDArray[np.int64]:
        return (code & ((1 << bits) - 1) ^ 1 << (bits - 1)) - (1 << (bits - 1))

    def half(word: int, shift: int) -> NDArray[np.float64]:
        return (words[:, word] >> shift).astype("<u2").view("<f2").astype(np.float64)

    codes = np.stack([words[:, 3] >> 16, words[:, 4] & 0xFFFF, words[:, 4] >> 16], axis=1)
    scales = np.where(codes, 2 ** (-40 + 64 * (codes - 1) / 65534), 0)
    bits = words[:, 5] | (words[:, 6] & 0xFFFF) << 32
    k = bits & 3
    others = np.stack([signed(bits >> (2 + 15 * i), 15) / 16383 for i in range(3)]) * np.sqrt(0.5)
    orientations = np.empty((n, 4))
    places = np.arange(4)[None].repeat(n, 0)
    orientations[places != k[:, None]] = others.T.ravel()
    orientations[np.arange(n), k] = np.sqrt(np.maximum(0, 1 - (others**2).sum(axis=0)))
    sh = np.empty((n, (sh_degree + 1) ** 2, 3))
    sh[:, 0] = np.stack([half(7, 0), half(7, 16), half(8, 0)], axis=1)
    for channel, (shift, width, steps) in enumerate([(0, 11, 1023), (11, 11, 1023), (22, 10, 511)]):
        fractions = signed(words[:, 9:] >> shift, width) / steps
        with np.errstate(invalid="ignore"):  # of what means nothing
            sh[:, 1:, channel] = fractions * half(6, 16)[:, None]
    positions = payload.view("<f4").reshape(words.shape)[:, :3].copy()
    positions[~np.isfinite(np.concatenate([sh[:, 0], half(6, 16)[:, None]], 1)).all(1)] = np.nan
    positions[~np.isfinite(positions).all(axis=1)] = np.nan
    arrays = (positions, orientations, scales, (words[:, 3] & 0xFFFF) / 65535, sh)
    with np.errstate(invalid="ignore"):  # of what means nothing
        return Arrays(*(array.astype(np.float32) for array in arrays))


def assert_same(got: Arrays, expected: Arrays, rtol: float = 3e-7, atol: float = 1e-30) -> None:
    for name, values in vars(expected).items():
        np.testing.assert_allclose(getattr(got, name), values, rtol=rtol, atol=atol)


@pytest.mark.parametrize("sh_degree", range(4))
def test_a_payload_is_read_as_its_document_says(sh_degree: int) -> None:
    """Whatever its bytes are; and the bytes that are sent."""
    random = np.random.default_rng(sh_degree)
    packed = random.integers(0, 256, size(1000, sh_degree), np.uint8)
    packed[:40].view("<f4")[:] = np.sort(random.normal(size=(5, 2)) * 10, axis=1).ravel()
    if sh_degree:
        packed[40 + 24 * 1000 :][:10] = 0  # strengths of none
    assert_same(decode(packed, 1000, sh_degree), decoded(packed, 1000, sh_degree))
    splats = generate(5000).with_sh_degree(sh_degree)
    splats = replace(splats, sh=splats.sh + random.normal(size=splats.sh.shape))
    packed = encode(arrays_of(splats), random.random(5000) < 0.9)
    got = decode(packed, 5000, sh_degree)
    assert_same(got, decoded(packed, 5000, sh_degree))
    assert np.isnan(got.scales).any()


@pytest.mark.parametrize("sh_degree", range(4))
def test_packed_rows_are_read_as_their_document_says(sh_degree: int) -> None:
    """Whatever their bits are; and those that are sent."""
    random = np.random.default_rng(sh_degree)
    splats = generate(5000).with_sh_degree(sh_degree)
    splats = replace(splats, sh=splats.sh + random.normal(size=splats.sh.shape))
    sent = pack_splats(arrays_of(splats), np.ones(5000, bool)).view(np.uint8).ravel()
    for rows in (random.integers(0, 256, len(sent), np.uint8), sent):
        got, expected = decode(rows, 5000, sh_degree, PACKED), unpacked(rows, 5000, sh_degree)
        usable = np.isfinite(expected.positions).all(axis=1)
        np.testing.assert_array_equal(got.positions, expected.positions)
        assert_same(
            Arrays(*(values[usable] for values in vars(got).values())),
            Arrays(*(values[usable] for values in vars(expected).values())),
            rtol=1e-5, atol=4e-4,  # the component left out may be the root of a difference of ones
        )  # fmt: skip
    assert usable.all()
    np.testing.assert_allclose(got.sh, splats.sh, atol=np.abs(splats.sh).max() / 500)


@pytest.mark.parametrize(("format", "read_as"), [(QUANTISED, decoded), (PACKED, unpacked)])
def test_the_document_s_example_is_one(format: str, read_as: Callable[..., Arrays]) -> None:
    text = (CHECKOUT / f"rosplat_msgs/doc/{format}.md").read_text()
    lines = re.findall(r"^    ((?:[0-9a-f]{2} *)+)$", text, re.MULTILINE)
    packed = np.frombuffer(bytes.fromhex("".join(lines)), np.uint8)
    said = text[text.index("It is at") :].replace("\u2212", "-").replace("e⁻⁴", str(np.exp(-4)))
    numbers = [float(number) for number in re.findall(r"-?\d+(?:\.\d+)?(?:e-\d+)?", said)]
    for got in (decode(packed, 1, 0, format), read_as(packed, 1, 0)):
        values = np.concatenate(
            [got.positions[0], got.scales[0], got.orientations[0], got.opacities, got.sh[0, 0]]
        )
        np.testing.assert_allclose(values, numbers, rtol=1e-6)


def pictures(splats: Splats) -> list[np.ndarray]:
    renderer = rendering.CpuRenderer(threads=2)
    insert_all(renderer, splats)
    drawn = []
    for eye in ((4.0, 1.0, 1.5), (-1.0, 2.5, 0.8)):
        camera = Camera(
            id=0, width=320, height=240, fx=250.0, fy=250.0, cx=160.0, cy=120.0,
            world_to_camera=look_at(eye, (0, 0, 0)),
        )  # fmt: skip
        picture = renderer.draw(posed(camera))["colour"]
        drawn.append(np.clip(picture[..., :3], 0, 1))
    return drawn


@pytest.mark.parametrize(
    ("far", "large", "suited"),
    [(0, 0, True), (1e3, 0, True), (1e7, 0, False), (1e37, 0, False),
     (0, 1e2, True), (0, 1e6, False), (0, 1e37, False)],
)  # fmt: skip
def test_the_picture_is_that_of_the_arrays_where_no_stray_splat_is(
    far: float, large: float, suited: bool
) -> None:
    splats = generate(30_000)
    splats.positions[0] += np.float32(far)
    splats.scales[0] += np.float32(large)
    splats.opacities[0] = 0  # what it costs the others is meant
    arrays = arrays_of(splats)
    usable = is_usable(arrays)
    packed = encode(arrays, usable)
    got = pictures(replace(splats, **vars(decode(packed, len(splats), splats.sh_degree))))
    for picture, expected in zip(got, pictures(splats), strict=True):
        assert expected.std() > 0.05
        assert (psnr(picture, expected) > LEAST) == suited
    assert suits(arrays, usable) == suited
