"""GaussianArray messages as the C++ engine takes them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rosplat_core import payload
from rosplat_core.maps import Arrival

if TYPE_CHECKING:
    from geometry_msgs.msg import Pose

    from rosplat_msgs.msg import GaussianArray

_ARRAYS = (
    "slots", "payload", "positions", "orientations", "scales", "opacities", "sh", "channels",
)  # fmt: skip


def apply(target: Any, batch: GaussianArray, arrival: Arrival = Arrival.HEARD) -> dict[str, int]:
    """Hands a batch to a Renderer, a CpuRenderer or a map of rosplat_core.

    Returns "missed", the number of batches missed before it, and "dropped", that of its splats that
    were dropped. Raises BatchError, naming the field, for a batch that contradicts itself.
    """
    origin = batch.origin
    report: dict[str, int] = target.apply(
        batch.operation, batch.first_slot, batch.count, array(batch.slots, np.uint32),
        batch.sh_degree, batch.model, (origin.x, origin.y, origin.z), array(batch.positions),
        array(batch.orientations), array(batch.scales), array(batch.opacities), array(batch.sh),
        batch.map_id, batch.revision, batch.expected_slots, batch.format,
        array(batch.payload, np.uint8), arrival, batch.group, array(batch.groups, np.uint32),
        np.array([[*sum(pose_values(pose), ())] for pose in batch.poses]),
        batch.channel_names, array(batch.channels),
    )  # fmt: skip
    return report


def array(values: object, dtype: type = np.float32) -> NDArray[Any]:
    """A message's array, without a copy."""
    return np.frombuffer(values, dtype=dtype)  # type: ignore[call-overload, no-any-return]


def slots_of(batch: GaussianArray) -> NDArray[np.uint32]:
    """The slots that a batch writes or empties."""
    listed = array(batch.slots, np.uint32)
    if len(listed):
        return listed.copy()
    return np.arange(batch.first_slot, batch.first_slot + batch.count, dtype=np.uint32)


def positions_of(batch: GaussianArray) -> NDArray[np.float32]:
    """The positions of a batch's splats, relative to its origin, float32 (n, 3) [m].

    Raises ValueError for a batch that contradicts itself.
    """
    if not batch.format:
        return array(batch.positions).reshape(-1, 3)
    if batch.format == payload.PACKED:
        rows = array(batch.payload).reshape(batch.count, 8 + (batch.sh_degree + 1) ** 2)
        return rows[:, :3]
    packed = array(batch.payload, np.uint8)
    return payload.decode(packed, batch.count, batch.sh_degree, batch.format).positions


def array_bytes(batch: GaussianArray) -> int:
    """Size of a batch's arrays, nearly all of the batch. [bytes]"""
    arrays = (getattr(batch, name) for name in _ARRAYS)
    return sum(len(values) * values.itemsize for values in arrays)


def pose_values(pose: Pose) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Position x y z [m] and quaternion x y z w of a geometry_msgs Pose."""
    p, q = pose.position, pose.orientation
    return (p.x, p.y, p.z), (q.x, q.y, q.z, q.w)
