"""Where frames are, by TF."""

from __future__ import annotations

import numpy as np
from geometry_msgs.msg import Point, Pose
from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.time import Time

from rosplat_core.log_text import shown
from rosplat_core.splats import SceneError
from rosplat_tools.poses import to_matrix, to_pose

# The wheels of PyPI don't have it.
try:
    import tf2_ros
except ImportError:
    tf2_ros = None


class FrameError(LookupError):
    """A frame that isn't known, or not yet; the text says which."""


class Frames:
    """Poses of frames as TF has them last."""

    def __init__(self, node: Node) -> None:
        """Raises SceneError where there is no TF."""
        if tf2_ros is None:
            raise SceneError("frames other than the map's need TF: tf2_ros is not installed")
        self._buffer = tf2_ros.Buffer()
        self._listener = tf2_ros.TransformListener(self._buffer, node)

    def pose(self, frame: str, within: str) -> NDArray[np.float64]:
        """Where a frame is in another, (4, 4). Raises FrameError."""
        try:
            found = self._buffer.lookup_transform(within, frame, Time()).transform
        except tf2_ros.TransformException as error:
            raise FrameError(shown(str(error), 300)) from error
        place = found.translation
        try:
            pose = Pose(position=Point(x=place.x, y=place.y, z=place.z), orientation=found.rotation)
            return to_matrix(to_pose(pose))
        except ValueError as error:
            raise FrameError(f"'{shown(frame)}' in '{shown(within)}': {error}") from error
