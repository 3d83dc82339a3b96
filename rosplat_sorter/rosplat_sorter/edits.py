"""Edits of a map: GaussianArray messages, checked, reduced to what sorting needs."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rosplat_core import channels, payload
from rosplat_core.depth import splat_extents
from rosplat_core.log_text import shown
from rosplat_core.payload import Arrays, PayloadError
from rosplat_core.slot_pages import MAX_SLOTS, Slots
from rosplat_core.view import frame_at
from rosplat_sorter.map_pull import Arrival

if TYPE_CHECKING:
    from geometry_msgs.msg import Pose

    from rosplat_msgs.msg import GaussianArray

REPLACE, UPSERT, DELETE, MOVE = range(4)
MAX_GROUPS = 1 << 15  # as GaussianArray.MAX_GROUPS
MAX_SH_DEGREE = 3

EMPTY = np.float32(-2)
"""The extent of an empty slot; that of a splat too faint to be drawn is depth.INVISIBLE."""


class EditError(ValueError):
    """A message that can't be applied as a whole; the text names the field."""


@dataclass(frozen=True)
class Edit:
    """One batch of edits.

    origin: float64 (3,) [m]. slots: the n slots touched, all below `end`. positions: float32 (n, 3)
    [m], relative to the origin. extents: float32 (n,) [m], see depth.splat_extents; EMPTY where the
    slot becomes empty. Only a REPLACE or UPSERT has these, and a group. rejected: how many splats
    were not usable and become empty slots. poses: of a MOVE, by group: its frame in the map's,
    float64 (4, 4). channels: the names of those that its splats have.
    """

    map_id: str
    revision: int
    frame_id: str
    operation: int
    origin: NDArray[np.float64]
    slots: Slots
    end: int
    positions: NDArray[np.float32]
    extents: NDArray[np.float32]
    rejected: int
    arrival: Arrival = Arrival.HEARD
    group: int = 0
    poses: dict[int, NDArray[np.float64]] = field(default_factory=dict)
    channels: tuple[str, ...] = ()

    @property
    def writes(self) -> bool:
        """Whether it brings splats, were it none."""
        return self.operation in (REPLACE, UPSERT)

    @property
    def nbytes(self) -> int:
        """Memory that it takes until it is applied. [bytes]"""
        listed = 0 if isinstance(self.slots, slice) else self.slots.nbytes
        poses = sum(pose.nbytes for pose in self.poses.values())
        return self.positions.nbytes + self.extents.nbytes + listed + poses


def check(message: GaussianArray) -> None:
    """Raises EditError where a message is wrong in structure."""
    if message.revision == 0:
        raise EditError("revision is 0, they count from 1")
    if message.operation not in (REPLACE, UPSERT, DELETE, MOVE):
        raise EditError(f"operation is {message.operation}, known are 0 to 3")
    if message.format not in ("", payload.FORMAT):
        raise EditError(f"format is '{shown(message.format, 40)}', known is '{payload.FORMAT}'")
    if message.group >= MAX_GROUPS:
        raise EditError(f"group is {message.group}, a map has at most {MAX_GROUPS} groups")
    if message.sh_degree > MAX_SH_DEGREE:
        raise EditError(f"sh_degree is {message.sh_degree}, at most {MAX_SH_DEGREE} is known")
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
                np.frombuffer(message.payload, np.uint8), message.count, message.sh_degree
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


def array_bytes(message: GaussianArray) -> int:
    """Memory that a batch's arrays take: nearly all of it. [bytes]"""
    arrays = (
        message.slots,
        message.payload,
        message.channels,
        *(getattr(message, name) for name in _columns(message)),
    )
    return sum(len(values) * values.itemsize for values in arrays)


def decode(message: GaussianArray, arrival: Arrival = Arrival.HEARD) -> Edit:
    """The edit of a message. Raises EditError where the message is wrong in structure."""
    check(message)
    listed = np.asarray(message.slots, np.uint32)
    end = int(listed.max()) + 1 if listed.size else message.first_slot + message.count
    slots: Slots = listed if listed.size else slice(message.first_slot, end)
    arrays = arrays_of(message)
    usable = is_usable(arrays)
    with np.errstate(invalid="ignore", over="ignore"):  # of splats that are not usable
        extents = np.where(usable, splat_extents(arrays.scales, arrays.opacities), EMPTY)
    origin = message.origin
    return Edit(
        map_id=message.map_id,
        revision=message.revision,
        frame_id=message.header.frame_id,
        operation=message.operation,
        origin=np.array([origin.x, origin.y, origin.z]),
        slots=slots,
        end=end,
        positions=arrays.positions,
        extents=extents,
        rejected=len(usable) - int(np.count_nonzero(usable)),
        arrival=arrival,
        group=message.group,
        poses=poses_of(message),
        channels=tuple(message.channel_names),
    )


def poses_of(message: GaussianArray) -> dict[int, NDArray[np.float64]]:
    """Where a checked MOVE places groups: their frames in the map's, float64 (4, 4)."""
    return {
        group: frame_at(*pose_values(pose))
        for group, pose in zip(message.groups, message.poses, strict=True)
    }


def pose_values(pose: Pose) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Position x y z [m] and quaternion x y z w of a geometry_msgs Pose."""
    p, q = pose.position, pose.orientation
    return (p.x, p.y, p.z), (q.x, q.y, q.z, q.w)


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
        usable &= _finite_rows(values)
    return usable


def _finite_rows(values: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Whether all values of a row are finite, bool (n,), of float32 (n, any)."""
    with np.errstate(over="ignore", invalid="ignore"):
        finite: NDArray[np.bool_] = np.isfinite(values.sum(axis=1))  # never, where one is not
    doubtful = np.flatnonzero(~finite)
    finite[doubtful] = np.isfinite(values[doubtful]).all(axis=1)
    return finite
