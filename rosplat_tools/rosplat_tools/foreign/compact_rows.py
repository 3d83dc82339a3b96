"""`compact_dc_fp16_cov_rgba_v1`, the rows of gsplat_msgs' tiles and blobs, 32 bytes a splat.

Position as float32, covariance as six halves (xx xy xz yy yz zz), colour and opacity in 8 bits
each, and an unused number. Harmonics above degree 0 don't travel.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from rosplat_core.formats.decoded import Columns, IntoSplats, Warn
from rosplat_core.harmonics import C0
from rosplat_core.splats import InputError, Splats
from rosplat_tools.foreign.covariances import from_covariances, to_covariances

NAME = "compact_dc_fp16_cov_rgba_v1"
ROW = np.dtype(
    [("position", "<f4", 3), ("covariance", "<f2", 6), ("rgba", "u1", 4), ("unused", "<u4")]
)
_UPPER = np.triu_indices(3)


def decode(data: bytes, name: str, warn: Warn) -> Splats:
    """The splats of rows. Raises InputError where a row is cut off."""
    if len(data) % ROW.itemsize:
        raise InputError(f"{name}: {len(data)} bytes are no rows of {ROW.itemsize}")
    rows = np.frombuffer(data, ROW)
    covariances = np.empty((len(rows), 3, 3), np.float32)
    covariances[:, _UPPER[0], _UPPER[1]] = covariances[:, _UPPER[1], _UPPER[0]] = rows["covariance"]
    shares = rows["rgba"].astype(np.float32) / 255
    columns = Columns(
        rows["position"].astype(np.float64),
        *from_covariances(covariances),
        shares[:, 3].copy(),
        (shares[:, None, :3] - np.float32(0.5)) / np.float32(C0),
    )
    return IntoSplats().make(Path(name), warn, columns)


def encode(splats: Splats) -> bytes:
    """Rows of splats. Covariances beyond a half's range are clamped to it."""
    rows = np.zeros(len(splats), ROW)
    rows["position"] = splats.positions + splats.origin
    largest = np.finfo(np.float16).max
    rows["covariance"] = np.clip(to_covariances(splats)[:, _UPPER[0], _UPPER[1]], -largest, largest)
    shares = np.column_stack([C0 * splats.sh[:, 0] + 0.5, splats.opacities])
    rows["rgba"] = np.rint(255 * np.clip(shares, 0, 1))
    return rows.tobytes()
