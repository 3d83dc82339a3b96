"""GaussianArray.payload: its formats "quantised" and "packed", which rosplat_msgs/doc specifies."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rosplat_core import _core

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


size = _core.payload_size
"""Bytes of a quantised payload of so many splats of an SH degree."""
suits = _core.payload_suits
"""Whether quantised splats still look the same: no stray one makes the steps of all too large.

Takes Arrays, or Splats, and which of them are usable, bool (n,): others are left out. Steps of
position may be 1/16 of the median splat's size, or 1/65,536 of where most splats lie.
"""
encode = _core.encode_payload
"""The quantised payload, uint8 (size,), of the same."""


def decode(
    payload: NDArray[np.uint8], count: int, sh_degree: int, format: str = QUANTISED
) -> Arrays:
    """The splats of a payload. Raises PayloadError for a wrong length, format or content."""
    try:
        return Arrays(**_core.decode_payload(payload, count, sh_degree, format))
    except ValueError as error:
        raise PayloadError(str(error)) from None
