"""Poses of a moving frame by their times, interpolated in between. Pure."""

from __future__ import annotations

from bisect import bisect_left

import numpy as np
from numpy.typing import NDArray

from rosplat_core.quaternions import from_matrices, to_matrices

SECOND = 10**9  # [ns]

Pose = NDArray[np.float64]
"""(4, 4), from the moving frame into the frame in which it moves. [m]"""


class PoseError(LookupError):
    """A pose that isn't known; the text says why."""


class PoseHistory:
    """Poses of the last seconds by time [ns]. A pose of time 0 holds until the next pose."""

    def __init__(self, keeps: float = 10.0, restarts: float = 1.0) -> None:
        """keeps: how far back. restarts: two poses in a row that are so much older than the newest
        one begin a new run: a bag is played again, say. [s]
        """
        self._keeps, self._restarts = round(keeps * SECOND), round(restarts * SECOND)
        self._poses: list[tuple[int, Pose]] = []
        self._late: tuple[int, Pose] | None = None  # the last pose, if it was so old

    def add(self, stamp: int, pose: Pose) -> None:
        """Takes a pose. The others are forgotten where a new run has begun."""
        late, self._late = self._late, None
        if stamp and self._poses and stamp < self._poses[-1][0] - self._restarts:
            if not late:
                self._late = stamp, pose  # it may be a straggler
                return
            self._poses = [late]
        elif not stamp:
            self._poses.clear()
        if stamp and self._poses and not self._poses[0][0]:
            self._poses.clear()  # the pose of time 0, which held until now
        place = self._place(stamp)
        known = place < len(self._poses) and self._poses[place][0] == stamp
        self._poses[place : place + known] = [(stamp, pose)]
        del self._poses[: self._place(self._poses[-1][0] - self._keeps)]

    def clear(self) -> None:
        """Forgets all poses but one of time 0, which holds."""
        self._late = None
        if self._poses and self._poses[0][0]:
            self._poses.clear()

    def _place(self, stamp: int) -> int:
        """Index of the first pose that isn't older."""
        return bisect_left(self._poses, stamp, key=lambda each: each[0])

    def newest(self) -> tuple[int, Pose]:
        """The last pose and its time. Raises PoseError before the first one."""
        if not self._poses:
            raise PoseError("no pose has come yet")
        return self._poses[-1]

    def at(self, stamp: int) -> Pose:
        """The pose at a time: position linear, rotation by the shortest turn (slerp).

        Raises PoseError before the oldest pose and after the newest.
        """
        newest, pose = self.newest()
        oldest = self._poses[0][0]
        if not newest:
            return pose
        if not oldest <= stamp <= newest:
            side, apart = (
                ("after", stamp - newest) if stamp > newest else ("before", oldest - stamp)
            )
            raise PoseError(f"{apart / SECOND:.3f} s {side} all poses that are known")
        number = self._place(stamp)
        after, second = self._poses[number]
        if after == stamp:
            return second
        before, first = self._poses[number - 1]
        return between(first, second, (stamp - before) / (after - before))


def between(first: Pose, second: Pose, share: float) -> Pose:
    """The pose at a share, 0 to 1, of the way from one to another."""
    a, b = from_matrices(np.stack([first, second])[:, :3, :3])
    cosine = float(a @ b)
    if cosine < 0:  # the other quaternion of the same rotation
        b, cosine = -b, -cosine
    angle = np.arccos(min(cosine, 1.0))
    if angle < 1e-6:
        weights = 1 - share, share
    else:
        weights = np.sin((1 - share) * angle), np.sin(share * angle)
    pose = np.eye(4)
    pose[:3, :3] = to_matrices(weights[0] * a + weights[1] * b)
    pose[:3, 3] = (1 - share) * first[:3, 3] + share * second[:3, 3]
    return pose
