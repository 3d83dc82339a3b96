"""GaussianArray.payload: its formats "quantised" and "packed", which rosplat_msgs/doc specifies."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rosplat_core import _core
from rosplat_core.splats import Splats

QUANTISED = "quantised"
PACKED = "packed"
"""Rows of packed slots, as PackedSplats has them."""


class PayloadError(ValueError):
    """A payload that can't be read; the text says why."""


@dataclass(frozen=True)
class Arrays:
    """As GaussianArray describes them: float32 (n, 3), (n, 4), (n, 3), (n,), (n, k, 3)."""

    positions: NDArray[np.float32]
    orientations: NDArray[np.float32]
    scales: NDArray[np.float32]
    opacities: NDArray[np.float32]
    sh: NDArray[np.float32]


def size(count: int, sh_degree: int) -> int:
    """Bytes of a quantised payload."""
    return _core.payload_size(count, sh_degree)


def suits(arrays: Arrays | Splats, usable: NDArray[np.bool_]) -> bool:
    """Whether quantised splats still look the same: no stray one makes the steps of all too large.

    Steps of position may be 1/16 of the median splat's size, or 1/65,536 of where most splats lie.
    """
    return _core.payload_suits(arrays, usable)


def encode(arrays: Arrays | Splats, usable: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """The quantised payload, uint8, of splats. usable: bool (n,), false for splats to leave out."""
    return _core.encode_payload(arrays, usable)


def decode(
    payload: NDArray[np.uint8], count: int, sh_degree: int, format: str = QUANTISED
) -> Arrays:
    """The splats of a payload. Raises PayloadError for a wrong length, format or content."""
    try:
        return Arrays(**_core.decode_payload(payload, count, sh_degree, format))
    except ValueError as error:
        raise PayloadError(str(error)) from None
