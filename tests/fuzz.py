"""Messages, cameras and files as no honest peer sends them: structure-aware, and by number.

`make fuzz CASES=n` runs more of them; a case's number gives the same again.
"""

from __future__ import annotations

import os
from array import array
from typing import Any

import numpy as np
from numpy.random import Generator

from rosplat_msgs.msg import GaussianArray, ViewCamera

CASES = int(os.environ.get("ROSPLAT_FUZZ_CASES") or 2000)
SEED = int(os.environ.get("ROSPLAT_FUZZ_SEED") or 0)

MOST = GaussianArray.MAX_SLOTS
WHOLE = (0, 1, 2, 3, 255, 1023, 1024, 1025, 1 << 16, MOST - 1, MOST, 1 << 31, (1 << 32) - 1)
DOUBLES = (
    np.nan, np.inf, -np.inf, 0.0, -0.0, 5e-324, 1e-100, 1e-45, 1e-7, 1.0, -1.0, 1.0 + 1e-15,
    1e9, 1e30, 3.5e38, 1e100, -1e100, 1e308,
)  # fmt: skip
FLOATS = (np.nan, np.inf, -np.inf, 0.0, -0.0, 1e-45, -1e-45, 1e-20, -1.0, 1e20, -3.4e38, 3.4e38)
SOLID = (np.nan, np.inf, -np.inf, 7.0, 3.4e38)  # opacities; below 1/255 sorters see an empty slot
VALUES = {"positions": 3, "orientations": 4, "scales": 3, "opacities": 1}


def random(case: int) -> Generator:
    """What a case is made of."""
    return np.random.default_rng([SEED, case])


def one_of(rng: Generator, values: tuple[Any, ...] | list[Any]) -> Any:
    return values[int(rng.integers(len(values)))]


def batches(rng: Generator) -> list[GaussianArray]:
    """Some batches of one map, half of them with one or two things wrong."""
    antialiased = bool(rng.integers(2))
    made = []
    for revision in range(1, int(rng.integers(2, 6))):
        message = _batch(rng, revision)
        message.antialiased = antialiased
        for _ in range(one_of(rng, [0, 0, 1, 2])):
            _spoil(rng, message)
        made.append(message)
    return made


def _batch(rng: Generator, revision: int) -> GaussianArray:
    message = GaussianArray(map_id="map", revision=revision, sh_degree=int(rng.integers(4)))
    message.header.frame_id = "map"
    message.operation = one_of(rng, [0, 1, 1, 2]) if revision > 1 else one_of(rng, [0, 0, 1, 2])
    message.count = n = one_of(rng, [0, 1, 2, 7, 100])
    if rng.integers(2):
        slots = [one_of(rng, WHOLE[:10]) + int(rng.integers(3)) for _ in range(n)]
        message.slots = array("I", [min(slot, MOST - 1) for slot in slots])
    else:
        message.first_slot = min(one_of(rng, WHOLE[:10]), MOST - n)
    if message.operation == GaussianArray.DELETE:
        if not len(message.slots) and rng.integers(2):
            message.count = MOST - message.first_slot
        return message
    message.positions = array("f", rng.normal(size=3 * n) * 5)
    message.orientations = array("f", rng.normal(size=4 * n))
    message.scales = array("f", np.exp(rng.uniform(-7, 1, 3 * n)))
    message.opacities = array("f", rng.uniform(0.1, 1, n))
    message.sh = array("f", rng.normal(size=3 * (message.sh_degree + 1) ** 2 * n))
    return message


def _spoil(rng: Generator, message: GaussianArray) -> None:
    what = one_of(rng, ["value", "value", "value", "length", "field", "origin"])
    if what == "origin":
        for axis in "xyz":
            if rng.integers(2):
                setattr(message.origin, axis, float(one_of(rng, DOUBLES)))
    elif what == "field":
        field, values = one_of(rng, [
            ("revision", [0, 1, 2, 3, 1 << 20, (1 << 64) - 1]), ("operation", [0, 1, 2, 3, 255]),
            ("encoding", [1, 255]), ("sh_degree", [0, 1, 3, 4, 255]), ("count", WHOLE),
            ("first_slot", WHOLE), ("expected_slots", WHOLE), ("snapshot", [True]),
            ("map_id", ["", "other", "a\n\x1b[31m" * 20]),
        ])  # fmt: skip
        setattr(message, field, one_of(rng, values))
    else:
        field = one_of(rng, [*VALUES, "sh", "slots"])
        values = getattr(message, field)
        if what == "length":
            zeros = array(values.typecode, [0] * (len(values) + 2))
            cut = int(rng.integers(0, len(values) + 3))
            setattr(message, field, (values + zeros)[:cut])
        elif len(values):
            wrong = WHOLE if field == "slots" else SOLID if field == "opacities" else FLOATS
            values[int(rng.integers(len(values)))] = one_of(rng, wrong)


def view_camera(rng: Generator) -> ViewCamera:
    """A camera near the map, mostly with some numbers that make no picture."""
    message = ViewCamera(
        view_id="view", sequence=1, projection=one_of(rng, [0, 0, 1, 9]), width=64, height=48,
        fx=60.0, fy=60.0, cx=32.0, cy=24.0, near_clip=0.1, far_clip=100.0,
    )  # fmt: skip
    message.pose.position.z = -20.0
    for _ in range(int(rng.integers(4))):
        field = one_of(rng, ["fx", "fy", "cx", "cy", "near_clip", "far_clip", "pose", "size"])
        if field == "pose":
            part = one_of(rng, [message.pose.position, message.pose.orientation])
            setattr(part, one_of(rng, "xyz"), float(one_of(rng, DOUBLES)))
        elif field == "size":
            setattr(message, one_of(rng, ["width", "height"]), one_of(rng, [0, 1, 63, *WHOLE[-2:]]))
        else:
            setattr(message, field, float(one_of(rng, DOUBLES)))
    return message


def damaged(rng: Generator, whole: bytes) -> bytes:
    """A file that lost something, or says something else in some places."""
    data = bytearray(whole)
    for _ in range(int(rng.integers(1, 4))):
        at = (
            int(rng.integers(len(data)))
            if rng.integers(2)
            else int(rng.integers(min(len(data), 300)))
        )
        what = one_of(rng, ["bit", "number", "cut", "text", "twice"])
        if what == "bit":
            data[at] ^= 1 << int(rng.integers(8))
        elif what == "number":
            data[at : at + 4] = int(one_of(rng, WHOLE)).to_bytes(4, "little")
        elif what == "cut":
            del data[at : at + one_of(rng, [1, 4, 100, len(data)])]
        elif what == "text":
            data[at:at] = one_of(
                rng, [b"\n", b"9" * 30, b"-1", b"\x00", b"element vertex 9999999999\n"]
            )
        else:
            data[at:at] = data[at : at + 100]
        if not data:
            break
    return bytes(data)
