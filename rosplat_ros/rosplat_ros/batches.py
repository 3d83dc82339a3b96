"""GaussianArray messages as the C++ engine takes them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from geometry_msgs.msg import Pose

    from rosplat_msgs.msg import GaussianArray

_ARRAYS = (
    "slots", "payload", "positions", "orientations", "scales", "opacities", "sh", "channels",
)  # fmt: skip


def array(values: object, dtype: type = np.float32) -> NDArray[Any]:
    """A message's array, without a copy."""
    return np.frombuffer(values, dtype=dtype)  # type: ignore[call-overload, no-any-return]


def slots_of(batch: GaussianArray) -> NDArray[np.uint32]:
    """The slots that a batch writes or empties."""
    listed = array(batch.slots, np.uint32)
    if len(listed):
        return listed.copy()
    return np.arange(batch.first_slot, batch.first_slot + batch.count, dtype=np.uint32)


def array_bytes(batch: GaussianArray) -> int:
    """Size of a batch's arrays, nearly all of the batch. [bytes]"""
    arrays = (getattr(batch, name) for name in _ARRAYS)
    return sum(len(values) * values.itemsize for values in arrays)


def pose_values(pose: Pose) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Position x y z [m] and quaternion x y z w of a geometry_msgs Pose."""
    p, q = pose.position, pose.orientation
    return (p.x, p.y, p.z), (q.x, q.y, q.z, q.w)
