"""GaussianArray.payload in the format "quantised": 24 bytes a splat, and its harmonics in 8 bits.

Little-endian:

    bounds     float32 (5, 2): least and greatest x, y, z [m], logarithm of a scale, and v of a
               colour c0 = sign(v) (exp(|v|) - 1)
    splats     24 bytes each: the fields of FIELDS, from the least significant bit on
    strengths  uint8 each, where sh_degree > 0: s for harmonics up to 2^((s - 128) / 8), 0 for none
    harmonics  int8, in the order of sh but without the first band: 127 is as much as strengths say

A position is lower + code * (upper - lower) / (2^24 - 1), and alike the others with their bits. Of
scales, code 0 is zero and the greatest code a splat that means nothing; those between go from
bound to bound. The quaternion's largest component is left out, and positive; the others go from
-sqrt(1/2) to sqrt(1/2). payload.hpp is the same for C++.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]
Codes = NDArray[np.uint32]

FORMAT = "quantised"

POSITION_BITS, SCALE_BITS, ROTATION_BITS, OPACITY_BITS, COLOUR_BITS = 24, 12, 12, 10, 12
# Bits of each field, in this order: position, scales, which component of the quaternion is left
# out, the other three, opacity, colour.
FIELDS = (
    *[POSITION_BITS] * 3, *[SCALE_BITS] * 3, 2, *[ROTATION_BITS] * 3, OPACITY_BITS,
    *[COLOUR_BITS] * 3,
)  # fmt: skip
WORDS = 6  # uint32, of a splat
BOUNDS_BYTES = 5 * 2 * 4

# The least scale that is told from 0 is this much below the greatest. [natural logarithm]
SCALE_RANGE = 16.0
# How much greater than most splats one may be, and still all are told from 0. [natural logarithm]
GREATEST_SCALE = 12.0
ROTATION_BOUNDS = np.array([-0.70710684, 0.70710684], np.float32)  # just beyond sqrt(1/2)
OPACITY_BOUNDS = np.array([0, 1], np.float32)


class PayloadError(ValueError):
    """A payload that can't be read; the text says why."""


@dataclass(frozen=True)
class Arrays:
    """As GaussianArray describes them: float32 (n, 3), (n, 4), (n, 3), (n,), (n, k, 3)."""

    positions: Floats
    orientations: Floats
    scales: Floats
    opacities: Floats
    sh: Floats


def size(count: int, sh_degree: int) -> int:
    """Bytes of a payload."""
    rest = (sh_degree + 1) ** 2 - 1
    return BOUNDS_BYTES + count * (4 * WORDS + (1 + 3 * rest if rest else 0))


def suits(arrays: Arrays, usable: NDArray[np.bool_]) -> bool:
    """Whether a payload shows splats as they are: no stray one makes the steps of all too large.

    Steps of position may be a 16th of the median splat's size, or a 65,536th of where most are.
    """
    positions, scales = arrays.positions, arrays.scales
    if not usable.all():
        positions, scales = positions[usable], scales[usable]
    if not len(positions):
        return True
    bounds = np.array([_bounds(column) for column in positions.T], np.float64)
    step = np.ptp(bounds, axis=1).max() / 2**POSITION_BITS
    some = slice(None, None, 1 + len(positions) // 4096)
    low, high = np.quantile(positions[some].astype(np.float64), (0.05, 0.95), axis=0)
    size = float(np.median(scales[some].max(axis=1)))
    return bool(
        step <= max(size / 16, (high - low).max() / 2**16)
        and scales.max() <= (size or np.inf) * np.exp(GREATEST_SCALE)
    )


def encode(arrays: Arrays, usable: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """The payload, uint8, of splats. usable: which mean something, bool (n,)."""
    n = len(usable)
    if not usable.all():
        arrays = _without_sense(arrays, usable)
    with np.errstate(divide="ignore"):
        scales = np.log(arrays.scales)
    colours = _companded(arrays.sh[:, 0])
    told_apart = scales.max(initial=-np.inf) - np.float32(SCALE_RANGE)
    bounds = np.zeros((5, 2), np.float32)
    bounds[:3] = [_bounds(column) for column in arrays.positions.T]  # NumPy is slow along axis 0
    bounds[3] = _bounds(scales[(scales >= told_apart) & (scales > -np.inf)])
    bounds[4] = _bounds(colours)

    codes = [_codes(arrays.positions[:, k], bounds[k], 2**POSITION_BITS - 1) for k in range(3)]
    for k in range(3):
        inner = _codes(np.maximum(scales[:, k], bounds[3, 0]), bounds[3], 2**SCALE_BITS - 3)
        code = np.where(scales[:, k] < bounds[3, 0], 0, inner + np.uint32(1))
        codes.append(np.where(usable, code, np.uint32(2**SCALE_BITS - 1)))
    codes += _rotation_codes(arrays.orientations)
    opacities = np.clip(arrays.opacities, 0, 1)
    codes.append(_codes(opacities, OPACITY_BOUNDS, 2**OPACITY_BITS - 1))
    codes += [_codes(colours[:, k], bounds[4], 2**COLOUR_BITS - 1) for k in range(3)]

    payload = np.empty(size(n, round(arrays.sh.shape[1] ** 0.5) - 1), np.uint8)
    payload[:BOUNDS_BYTES] = bounds.astype("<f4").view(np.uint8).ravel()
    end = BOUNDS_BYTES + 4 * WORDS * n
    payload[BOUNDS_BYTES:end] = _packed(codes, n).view(np.uint8).ravel()
    if arrays.sh.shape[1] > 1:
        rest = arrays.sh[:, 1:].reshape(n, 3 * (arrays.sh.shape[1] - 1)).copy()
        greatest = np.maximum(rest.max(axis=1), -rest.min(axis=1))
        with np.errstate(divide="ignore"):
            strengths = np.clip(np.ceil(8 * np.log2(greatest)) + 128, 0, 255).astype(np.uint8)
            steps = np.where(strengths > 0, 1 / _units()[strengths], 0)
        rest *= steps[:, None]
        payload[end : end + n] = strengths
        np.rint(rest, out=rest)
        np.clip(rest, -127, 127, out=rest)
        payload[end + n :] = rest.astype(np.int8).view(np.uint8).ravel()
    return payload


def _without_sense(arrays: Arrays, usable: NDArray[np.bool_]) -> Arrays:
    """The same, with harmless values where there is none that means something."""
    kept = usable[:, None]
    return Arrays(
        positions=np.where(kept, arrays.positions, np.float32(0)),
        orientations=np.where(kept, arrays.orientations, np.array([0, 0, 0, 1], np.float32)),
        scales=np.where(kept, arrays.scales, np.float32(0)),
        opacities=np.where(usable, arrays.opacities, np.float32(0)),
        sh=np.where(kept[:, None], arrays.sh, np.float32(0)),
    )


def decode(payload: NDArray[np.uint8], count: int, sh_degree: int) -> Arrays:
    """The splats of a payload. Raises PayloadError where it is of another length, or no such."""
    if len(payload) != size(count, sh_degree):
        raise PayloadError(
            f"payload has {len(payload)} bytes, {size(count, sh_degree)} expected of {FORMAT}"
        )
    bounds = payload[:BOUNDS_BYTES].view("<f4").reshape(5, 2)
    if not np.isfinite(bounds).all() or (bounds[:, 0] > bounds[:, 1]).any():
        raise PayloadError("payload: bounds are not finite, or the wrong way round")
    end = BOUNDS_BYTES + 4 * WORDS * count
    codes = _unpacked(payload[BOUNDS_BYTES:end].view("<u4").reshape(count, WORDS))
    sh = np.zeros((count, (sh_degree + 1) ** 2, 3), np.float32)
    colours, table = _colour_table(bounds[4]), _scale_table(bounds[3])
    positions = np.empty((count, 3), np.float32)
    scales = np.empty((count, 3), np.float32)
    for k in range(3):
        positions[:, k] = _values(codes[k], bounds[k], 2**POSITION_BITS - 1)
        scales[:, k] = table[codes[3 + k]]
        sh[:, 0, k] = colours[codes[11 + k]]
    if sh_degree:
        unit = _units()[payload[end : end + count]]
        rest = payload[end + count :].view(np.int8).reshape(count, sh.shape[1] - 1, 3)
        np.multiply(rest, unit[:, None, None], out=sh[:, 1:])
    return Arrays(
        positions=positions,
        orientations=_rotations(codes[6:10]),
        scales=scales,
        opacities=_values(codes[10], OPACITY_BOUNDS, 2**OPACITY_BITS - 1).astype(np.float32),
        sh=sh,
    )


def _colour_table(bounds: Floats) -> Floats:
    """The colour of each code, float32."""
    values = _values(np.arange(2**COLOUR_BITS), bounds, 2**COLOUR_BITS - 1)
    with np.errstate(over="ignore"):
        table: Floats = np.copysign(np.expm1(np.abs(values)), values).astype(np.float32)
    return table


def _scale_table(bounds: Floats) -> Floats:
    """The scale of each code, float32."""
    logarithms = _values(np.arange(2**SCALE_BITS - 2), bounds, 2**SCALE_BITS - 3)
    with np.errstate(over="ignore"):
        table: Floats = np.concatenate([[0], np.exp(logarithms), [np.nan]]).astype(np.float32)
    return table


def _units() -> Floats:
    """What a step of harmonics is worth by strength, float32 (256,)."""
    units = np.exp2((np.arange(256) - 128) / 8) / 127
    units[0] = 0
    return units.astype(np.float32)


def _bounds(values: Floats) -> Floats:
    return np.array([values.min(), values.max()] if values.size else [0, 0], np.float32)


def _codes(values: Floats, bounds: Floats, steps: int) -> Codes:
    lower, span = float(bounds[0]), float(bounds[1]) - float(bounds[0])
    if steps >= 1 << 16:  # more than float32 tells apart
        values = values.astype(np.float64)
    scaled = (values - lower) * (steps / span if span else 0.0)
    scaled += 0.5
    return scaled.astype(np.uint32)


def _companded(colours: Floats) -> Floats:
    """Even steps of small colours, and of the logarithm of large ones, which are few."""
    companded: Floats = np.copysign(np.log1p(np.abs(colours)), colours)
    return companded


def _values(codes: NDArray[np.integer], bounds: Floats, steps: int) -> NDArray[np.float64]:
    lower, span = float(bounds[0]), float(bounds[1]) - float(bounds[0])
    values: NDArray[np.float64] = lower + codes.astype(np.float64) * (span / steps)
    return values


def _rotation_codes(quaternions: Floats) -> list[Codes]:
    left_out = np.abs(quaternions).argmax(axis=1)
    rows = 4 * np.arange(len(quaternions))
    flat = np.ascontiguousarray(quaternions).ravel()
    greatest = flat[rows + left_out]
    with np.errstate(over="ignore", under="ignore"):
        ratios = [flat[rows + (left_out + k) % 4] / greatest for k in (1, 2, 3)]
        length = np.sqrt(1 + ratios[0] ** 2 + ratios[1] ** 2 + ratios[2] ** 2)
    return [
        left_out.astype(np.uint32),
        *(_codes(ratio / length, ROTATION_BOUNDS, 2**ROTATION_BITS - 1) for ratio in ratios),
    ]


def _rotations(codes: list[Codes]) -> Floats:
    left_out, *others = codes
    quaternions = np.empty((len(left_out), 4), np.float32)
    rows = np.arange(len(left_out))
    rest = np.stack(
        [_values(code, ROTATION_BOUNDS, 2**ROTATION_BITS - 1) for code in others], axis=1
    )
    quaternions[rows, left_out] = np.sqrt(np.maximum(0, 1 - np.square(rest).sum(axis=1)))
    for k in range(3):
        quaternions[rows, (left_out + k + 1) % 4] = rest[:, k]
    return quaternions


def _packed(codes: list[Codes], count: int) -> NDArray[np.uint32]:
    words = np.zeros((count, WORDS), "<u4")
    bit = 0
    for code, bits in zip(codes, FIELDS, strict=True):
        word, shift = divmod(bit, 32)
        words[:, word] |= code << np.uint32(shift)
        if shift + bits > 32:
            words[:, word + 1] |= code >> np.uint32(32 - shift)
        bit += bits
    return words


def _unpacked(words: NDArray[np.uint32]) -> list[Codes]:
    codes = []
    bit = 0
    for bits in FIELDS:
        word, shift = divmod(bit, 32)
        code = words[:, word] >> np.uint32(shift)
        if shift + bits > 32:
            code |= words[:, word + 1] << np.uint32(32 - shift)
        codes.append(code & np.uint32(2**bits - 1))
        bit += bits
    return codes
