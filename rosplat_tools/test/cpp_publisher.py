"""The map publisher in C++, called as the one in Python: one set of tests holds both."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Pose, Quaternion
from rclpy.node import Node
from std_msgs.msg import Header

from rosplat_core.splats import Splats
from rosplat_msgs.msg import GaussianArray
from rosplat_msgs.srv import PullMap, RepeatMap
from rosplat_sorter.edits import pose_values
from rosplat_sorter.qos import PULLED_MAP
from rosplat_tools import _published_map as cpp
from rosplat_tools.map_publisher import CHUNK_BYTES
from rosplat_tools.messages import NONE, _as_array
from rosplat_tools.poses import to_matrix, to_pose
from rosplat_tools.slot_map import SlotMap

ARRAYS = {
    "slots": "I", "groups": "I", "payload": "B", "positions": "f", "orientations": "f",
    "scales": "f", "opacities": "f", "sh": "f", "channels": "f",
}  # fmt: skip


class CppMapPublisher:
    """rosplat::PublishedMap on a node of rclpy; see rosplat_tools.map_publisher."""

    def __init__(
        self,
        node: Node,
        *,
        frame_id: str = "map",
        topic: str = "gaussians",
        chunk_bytes: int = CHUNK_BYTES,
        compression: str = NONE,
    ) -> None:
        self._node = node
        self._progress: Callable[[int], None] | None = None
        self._publisher = node.create_publisher(GaussianArray, topic, PULLED_MAP)
        self._map = cpp.PublishedMap(
            frame_id, chunk_bytes, compression, self._send, self._now, self._warn
        )
        name = node.resolve_topic_name(topic)
        node.create_service(PullMap, f"{name}/pull", self._on_pull)
        node.create_service(RepeatMap, f"{name}/repeat", self._on_repeat)

    @property
    def map_id(self) -> str:
        return str(self._map.map_id)

    @property
    def revision(self) -> int:
        return int(self._map.revision())

    def __len__(self) -> int:
        return len(self._map)

    def snapshot(self) -> tuple[Any, Splats]:
        copy = SlotMap()
        for group, slots, held in self._map.groups():
            copy.write(np.array(slots, np.uint32), _from_cpp(held), group)
        copy.poses |= {group: to_matrix(_pose(pose)) for group, pose in self._map.poses().items()}
        return copy.snapshot()

    def replace(
        self,
        splats: Splats,
        *,
        expected_slots: int | None = None,
        stamp: Time | None = None,
        progress: Callable[[int], None] | None = None,
    ) -> None:
        self._progress = progress
        self._map.replace(_to_cpp(splats), expected_slots, _stamp(stamp))
        self._progress = None

    def repeat(self) -> None:
        self._map.repeat()

    def expect(self, slots: int) -> None:
        self._map.expect(slots)

    def upsert(
        self, slots: Any, splats: Splats, *, group: int = 0, stamp: Time | None = None
    ) -> None:
        if isinstance(slots, range) and len(slots) == len(splats):
            self._map.upsert_from(slots.start, _to_cpp(splats), group, _stamp(stamp))
        else:
            self._map.upsert(list(slots), _to_cpp(splats), group, _stamp(stamp))

    def delete(self, slots: Any, *, stamp: Time | None = None) -> None:
        if isinstance(slots, range):
            self._map.erase_from(slots.start, len(slots), _stamp(stamp))
        else:
            self._map.erase(list(slots), _stamp(stamp))

    def move(self, poses: dict[int, Any], *, stamp: Time | None = None) -> None:
        values = {}
        for group, pose in poses.items():
            position, orientation = pose_values(pose if isinstance(pose, Pose) else to_pose(pose))
            values[group] = (*position, *orientation)
        self._map.move(values, _stamp(stamp))

    def _send(self, fields: dict[str, Any]) -> None:
        self._publisher.publish(as_message(fields))
        if self._progress and fields["count"]:
            progress, self._progress = self._progress, None  # what it raises ends the sending
            progress(fields["count"])
            self._progress = progress

    def _now(self) -> tuple[int, int]:
        now = self._node.get_clock().now().to_msg()
        return (now.sec, now.nanosec) if now else (0, 0)

    def _warn(self, text: str) -> None:
        self._node.get_logger().warning(text)

    def _on_pull(self, request: PullMap.Request, response: PullMap.Response) -> PullMap.Response:
        batches, response.next_block = self._map.pull(
            request.map_id, request.after_revision, request.first_block
        )
        response.batches = [as_message(fields) for fields in batches]
        return response

    def _on_repeat(self, _: RepeatMap.Request, response: RepeatMap.Response) -> RepeatMap.Response:
        self.repeat()
        response.success, response.splats = True, len(self)
        return response


def _to_cpp(splats: Splats) -> Any:
    return cpp.Splats(
        splats.positions, splats.orientations, splats.scales, splats.opacities, splats.sh,
        splats.origin, splats.antialiased, list(splats.channels.items()),
    )  # fmt: skip


def _from_cpp(held: Any) -> Splats:
    arrays = held.arrays
    n = len(arrays["opacities"])
    each = {"positions": 3, "orientations": 4, "scales": 3}
    return Splats(
        **{name: arrays[name].reshape(n, width) for name, width in each.items()},
        opacities=arrays["opacities"],
        sh=arrays["sh"].reshape(n, -1, 3) if n else np.zeros((0, 1, 3)),
        origin=held.origin,
        antialiased=held.antialiased,
        channels=arrays["channels"],
    )


def as_message(fields: dict[str, Any]) -> GaussianArray:
    """A batch as the C++ map hands it out."""
    fields = dict(fields)
    sec, nanosec = fields.pop("stamp")
    header = Header(stamp=Time(sec=sec, nanosec=nanosec), frame_id=fields.pop("frame_id"))
    x, y, z = fields.pop("origin")
    arrays = {name: _as_array(kind, fields.pop(name)) for name, kind in ARRAYS.items()}
    poses = [_pose(values) for values in fields.pop("poses")]
    return GaussianArray(
        header=header, origin=Point(x=x, y=y, z=z), poses=poses, **fields, **arrays
    )


def _pose(values: tuple[float, ...]) -> Pose:
    x, y, z, qx, qy, qz, qw = values
    return Pose(position=Point(x=x, y=y, z=z), orientation=Quaternion(x=qx, y=qy, z=qz, w=qw))


def _stamp(stamp: Time | None) -> tuple[int, int] | None:
    return None if stamp is None else (stamp.sec, stamp.nanosec)
