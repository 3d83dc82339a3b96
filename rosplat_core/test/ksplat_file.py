"""Writes .ksplat files for tests, as GaussianSplats3D's SplatBuffer.js lays them out."""

import struct

import numpy as np

from rosplat_core.splats import Splats

BLOCK = 5.0
BUCKET = 16


def ksplat(sections: list[Splats], level: int, least: float = -1.5, greatest: float = 1.5) -> bytes:
    """A file of the sections; positions should lie within a block, -2.5 to 2.5."""
    count = sum(len(splats) for splats in sections)
    header = struct.pack(
        "<BBxxIIIIHxx3fff", 0, 1, len(sections), len(sections), count, count, level, 0, 0, 0,
        least, greatest,
    )  # fmt: skip
    heads, bodies = b"", b""
    for splats in sections:
        full, partial = divmod(len(splats), BUCKET) if level else (0, 0)
        lengths = struct.pack("<I", partial) if partial else b""
        buckets = full + bool(partial)
        centres = np.zeros((buckets, 3), "<f4").tobytes()
        body = b"".join(
            _splat(splats[i : i + 1], level, least, greatest) for i in range(len(splats))
        )
        heads += struct.pack(
            "<IIIIfHxxIIIIH", len(splats), len(splats), BUCKET, buckets, BLOCK, 12 if level else 0,
            32767 if level else 0, len(lengths + centres + body), full, bool(partial),
            splats.sh_degree,
        ).ljust(1024, b"\0")  # fmt: skip
        bodies += lengths + centres + body
    return header.ljust(4096, b"\0") + heads + bodies


def _splat(splat: Splats, level: int, least: float, greatest: float) -> bytes:
    number = "<f4" if level == 0 else "<f2"
    if level == 0:
        out = splat.positions.astype("<f4").tobytes()
    else:
        out = np.rint(splat.positions / (BLOCK / 2) * 32767 + 32767).astype("<u2").tobytes()
    out += splat.scales.astype(number).tobytes()
    out += np.roll(splat.orientations, 1, axis=1).astype(number).tobytes()  # w first
    rgb = np.clip(np.rint(255 * (0.28209479 * splat.sh[0, 0] + 0.5)), 0, 255)
    out += np.append(rgb, np.rint(255 * splat.opacities)).astype("u1").tobytes()
    for band in range(1, splat.sh_degree + 1):
        values = splat.sh[0, band**2 : (band + 1) ** 2].T  # channel by channel
        if level == 2:
            scaled = (values - least) / (greatest - least) * 255
            out += np.clip(np.floor(scaled), 0, 255).astype("u1").tobytes()
        else:
            out += values.astype(number).tobytes()
    return out
