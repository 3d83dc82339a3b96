"""Edits of a map: GaussianArray messages, checked, reduced to what sorting needs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rosplat_sorter.depth import INVISIBLE, splat_extents
from rosplat_sorter.slot_pages import MAX_SLOTS, Slots

if TYPE_CHECKING:
    from rosplat_msgs.msg import GaussianArray

REPLACE, UPSERT, DELETE = range(3)
ENCODING_FLOAT32 = 0
MAX_SH_DEGREE = 3


class EditError(ValueError):
    """A message that can't be applied as a whole; the text names the field."""


@dataclass(frozen=True)
class Edit:
    """One batch of edits.

    origin: float64 (3,) [m]. slots: the n slots touched, all below `end`. positions: float32 (n, 3)
    [m], relative to the origin. extents: float32 (n,) [m], see depth.splat_extents; negative where
    the slot becomes empty. A DELETE has neither. rejected: how many splats were not usable and
    become empty slots. snapshot: repeats what the edits up to this revision have left.
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
    snapshot: bool = False


def decode(message: GaussianArray) -> Edit:
    """The edit of a message. Raises EditError where the message is wrong in structure."""
    if message.revision == 0:
        raise EditError("revision is 0, they count from 1")
    if message.operation not in (REPLACE, UPSERT, DELETE):
        raise EditError(f"operation is {message.operation}, known are 0 to 2")
    if message.encoding != ENCODING_FLOAT32:
        raise EditError(f"encoding is {message.encoding}, known is 0")
    if message.sh_degree > MAX_SH_DEGREE:
        raise EditError(f"sh_degree is {message.sh_degree}, at most {MAX_SH_DEGREE} is known")
    origin = np.array([message.origin.x, message.origin.y, message.origin.z])
    if not np.isfinite(origin).all():
        raise EditError("origin is not finite")

    slots, end = _slots(message)
    splats = 0 if message.operation == DELETE else message.count
    positions = _rows(message, "positions", splats, 3)
    orientations = _rows(message, "orientations", splats, 4)
    scales = _rows(message, "scales", splats, 3)
    opacities = _rows(message, "opacities", splats, 1)[:, 0]
    _rows(message, "sh", splats, 3 * (message.sh_degree + 1) ** 2)

    usable = (
        np.isfinite(positions).all(axis=1)
        & np.isfinite(orientations).all(axis=1)
        & (orientations != 0).any(axis=1)
        & (np.isfinite(scales) & (scales >= 0)).all(axis=1)
        & ~np.isnan(opacities)
    )
    with np.errstate(invalid="ignore", over="ignore"):  # of splats that are not usable
        extents = np.where(usable, splat_extents(scales, opacities), INVISIBLE)
    return Edit(
        map_id=message.map_id,
        revision=message.revision,
        frame_id=message.header.frame_id,
        operation=message.operation,
        origin=origin,
        slots=slots,
        end=end,
        positions=positions,
        extents=extents,
        rejected=splats - int(np.count_nonzero(usable)),
        snapshot=message.snapshot,
    )


def _slots(message: GaussianArray) -> tuple[Slots, int]:
    """The slots touched and the end of their range."""
    listed = np.asarray(message.slots, np.uint32)
    if listed.size == 0:
        end = message.first_slot + message.count
        if end > MAX_SLOTS:
            raise EditError(f"first_slot + count is {end}, a map has at most {MAX_SLOTS} slots")
        return slice(message.first_slot, end), end
    if listed.size != message.count:
        raise EditError(f"slots has {listed.size} values, count says {message.count}")
    end = int(listed.max()) + 1
    if end > MAX_SLOTS:
        raise EditError(f"slots holds {end - 1}, a map has at most {MAX_SLOTS} slots")
    return listed, end


def _rows(message: GaussianArray, field: str, rows: int, columns: int) -> NDArray[np.float32]:
    """A field as float32 (rows, columns), without a copy."""
    values = np.asarray(getattr(message, field), np.float32)
    if values.size != rows * columns:
        raise EditError(f"{field} has {values.size} values, {rows * columns} expected")
    return values.reshape(rows, columns)
