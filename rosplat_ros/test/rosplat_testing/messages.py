"""Splats to GaussianArray batches and back in plain NumPy: the twin of the C++ that checks them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from geometry_msgs.msg import Pose
from numpy.typing import NDArray
from std_msgs.msg import Header

from rosplat_core import _core, channels, payload
from rosplat_core.models import Model
from rosplat_core.payload import Arrays, PayloadError
from rosplat_core.slot_pages import MAX_SLOTS
from rosplat_core.splats import Splats
from rosplat_core.view import frame_at
from rosplat_msgs.msg import GaussianArray
from rosplat_ros.batches import pose_values
from rosplat_ros.messages import NONE, Slots, as_array

REPLACE, UPSERT, DELETE, MOVE = range(4)
MAX_GROUPS = GaussianArray.MAX_GROUPS
MAX_SH_DEGREE = 3


class EditError(ValueError):
    """A message that can't be applied as a whole; the text names the field."""


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
    message.model = splats.model
    message.origin.x, message.origin.y, message.origin.z = splats.origin.tolist()
    message.channel_names = list(splats.channels)
    for values in splats.channels.values():
        message.channels.extend(as_array("f", values))
    if compression != NONE:
        arrays = Arrays(
            splats.positions, splats.orientations, splats.scales, splats.opacities, splats.sh
        )
        usable = is_usable(arrays)
        if compression == payload.PACKED:
            rows = _core.pack_splats(arrays, usable)
            rows[~usable, 0] = np.float32(np.nan).view(np.uint32)
            message.format = compression
            message.payload = as_array("B", rows)
            return message
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
        model=Model(message.model),
        channels=dict(zip(message.channel_names, channels, strict=True)),
    )


def as_held(splats: Splats) -> Splats:
    """Splats in the precision in which maps hold them."""
    rows = _core.pack_splats(splats, np.ones(len(splats), bool)).view(np.uint8).ravel()
    return replace(splats, **vars(payload.decode(rows, len(splats), splats.sh_degree, "packed")))


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


def check(message: GaussianArray) -> None:
    """Raises EditError where a message is wrong in structure."""
    if message.revision == 0:
        raise EditError("revision is 0, they count from 1")
    if message.operation not in (REPLACE, UPSERT, DELETE, MOVE):
        raise EditError(f"operation is {message.operation}, known are 0 to 3")
    if message.format not in ("", payload.QUANTISED, payload.PACKED):
        raise EditError(f"format is '{message.format}', which is unknown")
    if message.group >= MAX_GROUPS:
        raise EditError(f"group is {message.group}, a map has at most {MAX_GROUPS} groups")
    if message.sh_degree > MAX_SH_DEGREE:
        raise EditError(f"sh_degree is {message.sh_degree}, at most {MAX_SH_DEGREE} is known")
    if message.model not in list(Model):
        raise EditError(f"model is {message.model}, known are 0 to {max(Model)}")
    origin = message.origin
    if not np.isfinite([origin.x, origin.y, origin.z]).all():
        raise EditError("origin is not finite")
    listed = np.asarray(message.slots, np.uint32)
    if listed.size not in (0, message.count):
        raise EditError(f"slots has {listed.size} values, count says {message.count}")
    if listed.size and int(listed.max()) >= MAX_SLOTS:
        raise EditError(f"slots holds {listed.max()}, a map has at most {MAX_SLOTS} slots")
    end = message.first_slot + message.count
    if not listed.size and end > MAX_SLOTS:
        raise EditError(f"first_slot + count is {end}, a map has at most {MAX_SLOTS} slots")
    if message.operation == MOVE and message.count:
        raise EditError(f"count is {message.count}, a MOVE touches no slots")
    writes = message.operation in (REPLACE, UPSERT)
    if message.format and not writes:
        raise EditError(f"format is '{message.format}', only a REPLACE or UPSERT has one")
    if len(message.payload) and not message.format:
        raise EditError(f"payload has {len(message.payload)} bytes, but format is empty")
    splats = message.count if writes and not message.format else 0
    for name, each in _columns(message).items():
        values = len(getattr(message, name))
        if values != splats * each:
            raise EditError(f"{name} has {values} values, {splats * each} expected")
    _check_channels(message, writes)
    _check_poses(message)


def _check_channels(message: GaussianArray, writes: bool) -> None:
    names = message.channel_names
    if names and not writes:
        raise EditError(f"channel_names has {len(names)}, only a REPLACE or UPSERT has any")
    try:
        channels.joined((), names)
    except channels.ChannelError as error:
        raise EditError(str(error)) from None
    expected = message.count * len(names)
    if len(message.channels) != expected:
        raise EditError(f"channels has {len(message.channels)} values, {expected} expected")


def _check_poses(message: GaussianArray) -> None:
    groups = np.asarray(message.groups, np.uint32)
    if groups.size and message.operation != MOVE:
        raise EditError(f"groups has {groups.size} values, only a MOVE has any")
    if len(message.poses) != groups.size:
        raise EditError(f"poses has {len(message.poses)} values, groups has {groups.size}")
    if groups.size and int(groups.max()) >= MAX_GROUPS:
        raise EditError(f"groups holds {groups.max()}, a map has at most {MAX_GROUPS} groups")
    if len(np.unique(groups)) < groups.size:
        raise EditError("groups names one twice")
    for group, pose in zip(groups.tolist(), message.poses, strict=True):
        position, orientation = pose_values(pose)
        if not np.isfinite([*position, *orientation]).all():
            raise EditError(f"poses: that of group {group} is not finite")
        if not any(orientation):
            raise EditError(f"poses: that of group {group} has an orientation of length zero")


def arrays_of(message: GaussianArray) -> Arrays:
    """What a checked batch writes: views of its arrays, or its payload decoded.

    Raises EditError for a payload that is none.
    """
    if message.format:
        try:
            return payload.decode(
                np.frombuffer(message.payload, np.uint8),
                message.count,
                message.sh_degree,
                message.format,
            )
        except PayloadError as error:
            raise EditError(str(error)) from None
    positions, orientations, scales, opacities, sh = (
        np.asarray(getattr(message, name), np.float32).reshape(-1, each)
        for name, each in _columns(message).items()
    )
    return Arrays(
        positions, orientations, scales, opacities[:, 0], sh.reshape(len(sh), sh.shape[1] // 3, 3)
    )


def poses_of(message: GaussianArray) -> dict[int, NDArray[np.float64]]:
    """Where a checked MOVE places groups: their frames in the map's, float64 (4, 4)."""
    return {
        group: frame_at(*pose_values(pose))
        for group, pose in zip(message.groups, message.poses, strict=True)
    }


def _columns(message: GaussianArray) -> dict[str, int]:
    """How many values each array has of a splat."""
    sh = 3 * (message.sh_degree + 1) ** 2
    return {"positions": 3, "orientations": 4, "scales": 3, "opacities": 1, "sh": sh}


def is_usable(arrays: Arrays) -> NDArray[np.bool_]:
    """Which splats mean something, bool (n,); whoever holds a map leaves the others out."""
    usable: NDArray[np.bool_] = (
        (arrays.orientations != 0).any(axis=1)
        & (arrays.scales >= 0).all(axis=1)
        & np.isfinite(arrays.opacities)
    )
    sh = arrays.sh.reshape(len(arrays.sh), 3 * arrays.sh.shape[1])
    for values in (arrays.positions, arrays.orientations, arrays.scales, sh):
        usable &= np.isfinite(values).all(axis=1)
    return usable
