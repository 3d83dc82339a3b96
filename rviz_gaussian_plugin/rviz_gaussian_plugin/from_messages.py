"""Messages as the renderer takes them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rosplat_core.maps import Arrival
from rosplat_msgs.msg import GaussianArray, ViewCamera
from rosplat_sorter import map_pull
from rosplat_sorter.edits import pose_values


def apply(
    target: Any, batch: GaussianArray, arrival: map_pull.Arrival = map_pull.Arrival.HEARD
) -> dict[str, Any]:
    """Hands a batch to a Renderer, CpuRenderer or GaussianMap; what became of it.

    Raises BatchError, naming the field, for one that contradicts itself.
    """
    origin = batch.origin
    report: dict[str, Any] = target.apply(
        batch.operation, batch.first_slot, batch.count, array(batch.slots, np.uint32),
        batch.sh_degree, batch.antialiased, (origin.x, origin.y, origin.z), array(batch.positions),
        array(batch.orientations), array(batch.scales), array(batch.opacities), array(batch.sh),
        batch.map_id, batch.revision, batch.expected_slots, batch.format,
        array(batch.payload, np.uint8), Arrival(arrival), batch.group,
        array(batch.groups, np.uint32),
        np.array([[*sum(pose_values(pose), ())] for pose in batch.poses]),
        batch.channel_names, array(batch.channels),
    )  # fmt: skip
    return report


def numbers(camera: ViewCamera) -> tuple[Any, ...]:
    """A camera's, as Camera takes them, and Renderer.set_camera after the view's own."""
    position, orientation = camera.pose.position, camera.pose.orientation
    return (
        (position.x, position.y, position.z),
        (orientation.x, orientation.y, orientation.z, orientation.w), camera.projection,
        camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height,
        camera.near_clip, camera.far_clip,
    )  # fmt: skip


def array(values: object, dtype: type = np.float32) -> NDArray[Any]:
    """A message's array without a copy."""
    return np.frombuffer(values, dtype=dtype)  # type: ignore[call-overload, no-any-return]
