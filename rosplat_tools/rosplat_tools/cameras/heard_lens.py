"""The lens of a camera as its newest calibration has it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, TypeVar

from sensor_msgs.msg import CameraInfo
from std_msgs.msg import Header

from rosplat_tools.cameras.health import NoPicture

Optics = TypeVar("Optics")


class HeardLens(Generic[Optics]):
    """Keeps what is made of a lens while the calibration stays the same."""

    def __init__(self, make: Callable[[CameraInfo], Optics], name: str, topic: str) -> None:
        """make: may raise LensError. name, topic: of the calibration, for what is said of it."""
        self._make, self._name, self._topic = make, name, topic
        self._info: CameraInfo | None = None
        self._made: tuple[CameraInfo, Optics] | None = None

    def hear(self, info: CameraInfo) -> None:
        """Takes a calibration; one that differs in the time alone is the same."""
        info.header = Header()
        if info != self._info:
            self._info = info

    def made(self) -> tuple[CameraInfo, Optics]:
        """The newest calibration, and what is made of it. Raises NoPicture."""
        info = self._info
        if info is None:
            raise NoPicture("without a lens", f"no CameraInfo has come on {self._topic}")
        if not self._made or self._made[0] is not info:
            try:
                self._made = info, self._make(info)
            except ValueError as error:  # LensError, or beyond what float32 or int64 holds
                raise NoPicture("without a lens", f"{self._name} is refused: {error}") from error
        return self._made
