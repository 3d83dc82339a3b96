"""Offers a scene's first view on `gaussians/first_view`, and stands the scene upright by TF."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node
from std_msgs.msg import Header

from rosplat_core.first_look import FirstView as View
from rosplat_core.first_look import cameras_beside, first_view, sample
from rosplat_core.log_text import shown
from rosplat_core.splats import InputError, PackedSplats, Splats
from rosplat_core.upright import find_up, standing_pose
from rosplat_msgs.msg import FirstView
from rosplat_ros.first_views import first_view_message
from rosplat_ros.poses import to_pose
from rosplat_ros.program.parameters import declare
from rosplat_ros.qos import LATCHED, overridable
from rosplat_tools.frames import TFMessage, transform

Found = tuple[View, NDArray[np.float64]]


class FirstViews:
    """Finds and publishes where a node's scenes are first looked at from, and which way is up."""

    def __init__(self, node: Node, frame_id: str) -> None:
        """Declares `up` and `upright_frame`. Raises InputError for an `up` that is no direction."""
        self._node, self._frame_id = node, frame_id
        self._given = _direction(
            declare(
                node, "up", "",
                "The scene's vertical, such as '0 -1 0'; empty: the file's, or else by its ground.",
            )
        )  # fmt: skip
        self._upright_frame = declare(
            node, "upright_frame", "",
            "Frame in which the scene stands upright, its ground at z = 0: the transform from it "
            "to frame_id is published; empty: none is.",
        )  # fmt: skip
        if self._upright_frame and TFMessage is None:
            raise InputError("parameter upright_frame: tf2_msgs is not installed")
        topic = node.resolve_topic_name("gaussians")  # remapping it remaps the view
        self._views = node.create_publisher(
            FirstView, f"{topic}/first_view", **overridable(LATCHED)
        )
        if self._upright_frame:
            self._transforms = node.create_publisher(TFMessage, "/tf_static", LATCHED)
            self._publish_upright(np.eye(4))

    def find(self, scene: str, splats: Splats | PackedSplats) -> Found | None:
        """The first view of a scene, and how it stands upright; None, with a warning, without."""
        log = self._node.get_logger()
        some = sample(splats)
        try:
            cameras = cameras_beside(scene)
            if self._given is not None:
                up = self._given
            elif some.up is not None:
                up = np.array(some.up)
            else:
                up = find_up(some, cameras)
                told = " ".join(f"{part:.2f}" for part in up)
                log.info(f"{shown(scene)}: up is {told} by its ground (parameter up changes that)")
            view = first_view(splats, up, cameras)
        except (ArithmeticError, MemoryError, ValueError) as error:  # the map is shown without
            log.warning(f"{shown(scene)}: no first view is found: {shown(error, 300)}")
            return None
        return view, standing_pose(some, up)

    def offer(self, found: Found | None) -> None:
        """Publishes what was found, for a map that is about to be published."""
        if found is None:
            return
        view, pose = found
        if self._upright_frame:
            self._publish_upright(pose)
        stamp = self._node.get_clock().now().to_msg()
        self._views.publish(first_view_message(view, self._frame_id, stamp))

    def _publish_upright(self, pose: NDArray[np.float64]) -> None:
        stamp = self._node.get_clock().now().to_msg()
        header = Header(frame_id=self._upright_frame, stamp=stamp)
        stands = transform(header, self._frame_id, to_pose(pose))
        self._transforms.publish(TFMessage(transforms=[stands]))


def _direction(text: str) -> NDArray[np.float64] | None:
    """A unit vector as a user writes it; None for an empty text. Raises InputError."""
    if not text.strip():
        return None
    try:
        numbers = np.array([float(number) for number in text.replace(",", " ").split()])
        length = np.linalg.norm(numbers)
    except ValueError:
        numbers, length = np.zeros(0), np.float64(0)
    if len(numbers) != 3 or not 0 < length < np.inf:
        raise InputError(f"parameter up: expected a direction such as 0 -1 0, got '{shown(text)}'")
    return np.asarray(numbers / length)
