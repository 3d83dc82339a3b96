"""The C++ maps of publishers and receivers, their batches, and pulls of what a receiver lacks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rosplat_core import _core
from rosplat_core.splats import Splats

Arrival = _core.Arrival
BatchError = _core.BatchError
GaussianMap = _core.GaussianMap
MapPull = _core.MapPull
PublishedBatch = _core.PublishedBatch
PublishedMap = _core.PublishedMap
choose_map_qos = _core.choose_map_qos

MapQos = tuple[bool, bool, int]
"""QoS of a map's topic, offered or asked for: reliable, transient local, depth."""

REPLACE, UPSERT, DELETE, MOVE = range(4)  # operations of a batch, as in GaussianArray


def batch_of(splats: Splats, part: slice = slice(None), **fields: Any) -> SimpleNamespace:
    """A batch with a part of the splats, for `apply`; fields: others of a GaussianArray."""
    values: dict[str, Any] = {
        "count": len(splats.opacities[part]),
        "sh_degree": splats.sh_degree,
        "model": splats.model,
        "origin": _point(splats.origin),
        "positions": splats.positions[part].ravel(),
        "orientations": splats.orientations[part].ravel(),
        "scales": splats.scales[part].ravel(),
        "opacities": splats.opacities[part],
        "sh": splats.sh[part].ravel(),
    }
    return SimpleNamespace(**values | fields)


def received(batch: PublishedBatch) -> SimpleNamespace:
    """A publisher's batch, for `apply`."""
    return SimpleNamespace(
        **{name: getattr(batch, name) for name in batch.FIELDS},
        origin=_point(batch.origin),
        groups=np.array(list(batch.poses), np.uint32),
        poses=[_pose(pose) for pose in batch.poses.values()],
    )


def move_of(poses: Mapping[int, Sequence[float]], **fields: Any) -> SimpleNamespace:
    """A batch that moves groups, for `apply`. poses: position x y z [m], quaternion x y z w."""
    return SimpleNamespace(
        operation=MOVE,
        groups=np.array(list(poses), np.uint32),
        poses=[_pose(pose) for pose in poses.values()],
        **fields,
    )


def _point(values: Sequence[float] | NDArray[np.float64]) -> SimpleNamespace:
    return SimpleNamespace(x=float(values[0]), y=float(values[1]), z=float(values[2]))


def _pose(values: Sequence[float]) -> SimpleNamespace:
    x, y, z, w = (float(value) for value in values[3:])
    return SimpleNamespace(position=_point(values), orientation=SimpleNamespace(x=x, y=y, z=z, w=w))
