"""Splats to GaussianArray batches and back. Arrays move as blocks of memory, never by element."""

from __future__ import annotations

from array import array
from collections.abc import Iterator, Mapping

import numpy as np
from geometry_msgs.msg import Pose
from numpy.typing import NDArray
from std_msgs.msg import Header

from rosplat_core import payload
from rosplat_core.payload import Arrays
from rosplat_core.splats import Splats
from rosplat_msgs.msg import GaussianArray
from rosplat_sorter.edits import arrays_of, check, is_usable

NONE = "none"
COMPRESSIONS = (NONE, payload.FORMAT)

Slots = range | NDArray[np.integer]
"""Which slots of a map: a contiguous range, or a list in any order, each once."""


def encode(
    splats: Splats,
    slots: Slots,
    *,
    header: Header,
    map_id: str,
    revision: int,
    operation: int,
    group: int = 0,
    expected_slots: int = 0,
    compression: str = NONE,
) -> GaussianArray:
    """A REPLACE or UPSERT that writes the i-th splat to the i-th slot, all in one group.

    The message holds the bands of spherical harmonics that splats holds. compression: NONE, or the
    format to send them in, unless that would not show them as they are. Raises ValueError where
    slots and splats differ in number.
    """
    if len(slots) != len(splats):
        raise ValueError(f"{len(splats)} splats for {len(slots)} slots")
    message = _batch(slots, header, map_id, revision, operation, expected_slots)
    message.group = group
    message.sh_degree = splats.sh_degree
    message.antialiased = splats.antialiased
    message.origin.x, message.origin.y, message.origin.z = splats.origin.tolist()
    message.channel_names = list(splats.channels)
    for values in splats.channels.values():
        message.channels.extend(as_array("f", values))
    if compression != NONE:
        arrays = Arrays(
            splats.positions, splats.orientations, splats.scales, splats.opacities, splats.sh
        )
        usable = is_usable(arrays)
        if payload.suits(arrays, usable):
            message.format = compression
            message.payload = as_array("B", payload.encode(arrays, usable))
            return message
    message.positions = as_array("f", splats.positions)
    message.orientations = as_array("f", splats.orientations)
    message.scales = as_array("f", splats.scales)
    message.opacities = as_array("f", splats.opacities)
    message.sh = as_array("f", splats.sh)
    return message


def encode_deletion(
    slots: Slots, *, header: Header, map_id: str, revision: int, expected_slots: int = 0
) -> GaussianArray:
    """A DELETE that empties the slots."""
    return _batch(slots, header, map_id, revision, GaussianArray.DELETE, expected_slots)


def encode_move(
    poses: Mapping[int, Pose],
    *,
    header: Header,
    map_id: str,
    revision: int,
    expected_slots: int = 0,
) -> GaussianArray:
    """A MOVE that places groups."""
    message = _batch(range(0), header, map_id, revision, GaussianArray.MOVE, expected_slots)
    message.groups = list(poses)
    message.poses = list(poses.values())
    return message


def decode(message: GaussianArray) -> tuple[Slots, Splats]:
    """The slots that a batch touches and, of a REPLACE or UPSERT, what it writes there.

    The arrays are views of the message's, but for those of a payload. Raises ValueError where it is
    wrong in structure.
    """
    check(message)
    first, count = message.first_slot, message.count
    slots = (
        np.frombuffer(message.slots, np.uint32) if message.slots else range(first, first + count)
    )
    arrays = arrays_of(message)
    channels = np.frombuffer(message.channels, np.float32).reshape(
        len(message.channel_names), count
    )
    origin = message.origin
    return slots, Splats(
        **vars(arrays),
        origin=np.array([origin.x, origin.y, origin.z]),
        antialiased=message.antialiased,
        channels=dict(zip(message.channel_names, channels, strict=True)),
    )


def chunks(splats: Splats, chunk_bytes: int) -> Iterator[slice]:
    """Cuts splats into slices whose arrays take chunk_bytes at most, but one splat at least.

    There is always a first slice, empty where there are no splats.
    """
    step = max(1, chunk_bytes * len(splats) // max(1, splats.nbytes))
    for start in range(0, max(1, len(splats)), step):
        yield slice(start, min(start + step, len(splats)))


def _batch(
    slots: Slots, header: Header, map_id: str, revision: int, operation: int, expected_slots: int
) -> GaussianArray:
    message = GaussianArray(
        header=header,
        map_id=map_id,
        revision=revision,
        operation=operation,
        expected_slots=expected_slots,
        count=len(slots),
    )
    if isinstance(slots, range):
        if slots.step != 1:
            raise ValueError(f"slots: a range must be contiguous, got {slots}")
        message.first_slot = slots.start
    else:
        message.slots = as_array("I", np.asarray(slots, np.uint32))
    return message


def as_array(typecode: str, values: NDArray[np.generic]) -> array[float]:
    """What a setter of rosidl takes as it is; an ndarray it copies by element."""
    result: array[float] = array(typecode)
    result.frombytes(np.ascontiguousarray(values).reshape(-1).view(np.uint8).data)
    return result
