"""When something measures a map: at its newest pose, a period after the last time."""

from __future__ import annotations

import time
from collections.abc import Callable

from rclpy.node import Node

from rosplat_tools.cameras.drawn_map import DrawnMap
from rosplat_tools.cameras.health import Health, NoPicture
from rosplat_tools.cameras.pose_history import SECOND, Pose, PoseError
from rosplat_tools.cameras.poses import Poses
from rosplat_tools.frames import LATEST

Measure = Callable[[int, Pose], bool]
"""Measures at a time [ns] and a pose (4, 4) [m] of the frame in the map's; returns whether somebody
wanted it. May raise NoPicture.
"""


class PosedSensor:
    """A camera or a lidar where TF, or a topic of poses, has it."""

    def __init__(
        self, node: Node, name: str, frame_id: str, poses: Poses, drawn_map: DrawnMap, rate: float,
        measure: Measure,
    ) -> None:  # fmt: skip
        """rate: how often it measures at most [Hz]."""
        self._node, self._frame_id, self._poses, self._map = node, frame_id, poses, drawn_map
        self._measure, self._period = measure, round(SECOND / rate)
        self.health = Health(node, name)
        self._last = self._due = 0  # of the last time, of the next at the earliest [ns]
        self._now = 0  # by the node's clock, when it was last looked at [ns]
        self._looked = time.monotonic()
        self._rests_until = 0.0  # after trouble, which is thus counted once a period

    def turn(self) -> None:
        """Measures, if that is due and a pose has come since the last time."""
        now = time.monotonic()
        passed, self._looked = now - self._looked, now
        self.health.counts["skipped"] += int(passed * SECOND / self._period)
        if now < self._rests_until:
            return
        try:
            self._turn()
        except NoPicture as none:
            self.health.trouble(none.kind, none)
            self._rests_until = now + self._period / SECOND

    def _turn(self) -> None:
        began = time.perf_counter()
        if problem := self._map.problem():
            raise NoPicture("without a map", problem)
        stamp, pose = self.pose()
        before, self._now = self._now, self._node.get_clock().now().nanoseconds
        stamp = self._now if stamp == LATEST else stamp
        if self._now < before or stamp < self._last - SECOND:  # a run has begun again
            self._last = self._due = 0
        if stamp <= self._last or stamp < self._due:
            return
        is_wanted = self._measure(stamp, pose)
        self._last = stamp
        self._due = max(self._due + self._period, stamp + self._period * 3 // 4)  # of jitter
        if is_wanted:
            self.health.well(stamp, began)

    def pose(self, stamp: int = LATEST) -> tuple[int, Pose]:
        """Time [ns] and value of the newest pose, or of one at a time. Raises NoPicture."""
        try:
            return self._poses.pose(self._frame_id, self._map.frame_id, stamp)
        except PoseError as error:
            raise NoPicture("without a pose", error) from error
