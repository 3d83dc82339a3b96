"""Refines a camera's poses by the pictures that it took of a map.

Hears `gaussians`, `image_raw`, `camera_info` and `mask`. TF, or the topic `pose`, says roughly
where the camera was. Publishes `aligned`, the refined pose of each picture, while somebody hears it
or `broadcast` asks for it. Serves `~/align`, which takes a picture, and a start, or none where the
parameter `places` says from where the map has been seen.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from dataclasses import dataclass, field

import numpy as np
from geometry_msgs.msg import PoseWithCovarianceStamped
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from rclpy.qos import QoSProfile
from std_msgs.msg import Header

from rosplat_core.lens_warps import Straightened
from rosplat_core.log_text import shown
from rosplat_core.splats import InputError
from rosplat_msgs.srv import Align
from rosplat_ros.messages import is_frame
from rosplat_ros.poses import to_matrix, to_pose
from rosplat_ros.program.parameters import declare, declare_path
from rosplat_ros.program.running import run_node
from rosplat_ros.qos import PICTURES, overridable
from rosplat_tools.cameras.drawn_map import DrawnMap
from rosplat_tools.cameras.health import NoPicture
from rosplat_tools.cameras.places import Places
from rosplat_tools.cameras.pose_history import Pose
from rosplat_tools.cameras.refining import Refined, refined
from rosplat_tools.cameras.taken_pictures import Taken, TakenPictures
from rosplat_tools.frames import TF, TFMessage, transform

CALLS = QoSProfile(depth=100)  # that come at once, and are not lost before they are refused
MOST_CALLS = 2  # of the service at a time: one that is answered, one that waits
THREADS = MOST_CALLS + 2  # of callbacks: each call keeps one, and one refuses further calls


@dataclass
class _Call:
    """A call of the service, which ROS's thread hands to the drawing thread."""

    request: Align.Request
    response: Align.Response
    done: threading.Event = field(default_factory=threading.Event)


class AlignNode(Node):
    """Callbacks only hand data over; align() draws."""

    def __init__(self) -> None:
        super().__init__("align")
        self._child: str = declare(
            self, "broadcast", "", "Frame that TF has at the refined pose, empty: none."
        )
        if self._child and TFMessage is None:
            raise InputError("parameter broadcast: tf2_msgs is not installed")
        self._patience: float = declare(
            self, "patience", 5.0, "Time after which no other try at a picture begins. [s]"
        )
        self._places = Places(declare_path(
            self, "places", "",
            "Camera file, or trajectory (.txt), of poses near which pictures are found without a "
            "start.",
        ))  # fmt: skip
        self._map = DrawnMap(self)
        self._pictures = TakenPictures(self, self._map, Straightened)
        self._health = self._pictures.health
        self._calls: deque[_Call] = deque()
        self._aligned = self.create_publisher(
            PoseWithCovarianceStamped, "aligned", **overridable(PICTURES)
        )
        self._tf = (
            self.create_publisher(TFMessage, "/tf", **overridable(TF)) if self._child else None
        )
        # A call blocks its thread until the drawing thread has answered.
        self._room = threading.BoundedSemaphore(MOST_CALLS)
        calls = ReentrantCallbackGroup()
        self.create_service(
            Align, "~/align", self._on_call, qos_profile=CALLS, callback_group=calls
        )
        if not self._tf:
            topic = self._aligned.topic_name
            self.get_logger().info(f"aligns pictures while somebody hears {topic}")

    def align(self) -> None:
        """Aligns pictures until ROS ends."""
        for _ in self._map.turns():
            while self._calls:
                call = self._calls.popleft()
                self._answer(call)
                call.done.set()
            try:
                self._align_newest()
            except NoPicture as none:
                self._health.trouble(none.kind, none)

    # --- The topic --------------------------------------------------------------------------------

    def _align_newest(self) -> None:
        if not self._tf and not self._aligned.get_subscription_count():
            self._pictures.forget()
            return
        taken = self._pictures.next()
        if not taken:
            return
        began = time.perf_counter()
        found = self._refined(taken)
        header = Header(stamp=taken.header.stamp, frame_id=self._map.frame_id)
        pose = found.in_map()
        self._aligned.publish(PoseWithCovarianceStamped(header=header, pose=pose))
        if self._tf:
            self._tf.publish(TFMessage(transforms=[transform(header, self._child, pose.pose)]))
        self._health.well(taken.stamp, began)
        self._health.figures = found.figures()

    def _refined(self, taken: Taken[Straightened]) -> Refined:
        self._map.publish_cameras("", [taken.camera(taken.optics.camera)])
        return _converged(refined(self._map.renderer, taken, taken.optics, self._patience))

    # --- The service ------------------------------------------------------------------------------

    def _on_call(self, request: Align.Request, response: Align.Response) -> Align.Response:
        if not self._room.acquire(blocking=False):
            response.problem = f"busy with {MOST_CALLS} calls: call again once one is answered"
            return response
        try:
            call = _Call(request, response)
            self._calls.append(call)
            self._map.came.set()
            while not call.done.wait(0.1):
                if not self.context.ok():
                    response.problem = "the node ends"
                    break
        finally:
            self._room.release()
        return response

    def _answer(self, call: _Call) -> None:
        response = call.response
        try:
            taken = self._asked(call.request)
            if call.request.anywhere:
                renderer = self._map.renderer
                found = _converged(self._places.found(renderer, taken, self._patience))
            else:
                found = self._refined(taken)
        except NoPicture as none:
            response.problem = str(none)
            return
        found_s, pose = found.alignment, found.in_map()
        response.converged = True
        response.pose.header = Header(stamp=taken.header.stamp, frame_id=self._map.frame_id)
        response.pose.pose = pose
        response.iterations, response.residual = found_s.iterations, found_s.residual
        response.explained = found_s.explained
        response.gain, response.bias = found_s.gain, found_s.bias

    def _asked(self, request: Align.Request) -> Taken[Straightened]:
        if problem := self._map.problem():
            raise NoPicture("without a map", problem)
        start = np.eye(4) if request.anywhere else self._start(request)
        image = request.image if request.image.width else self._pictures.newest
        if image is None:
            raise NoPicture("without a picture", "no picture has come on image_raw")
        return self._pictures.reader.read(image, start)

    def _start(self, request: Align.Request) -> Pose:
        frame = request.start.header.frame_id
        if not is_frame(frame, self._map.frame_id):
            raise NoPicture(
                "without a pose",
                f"start is in '{shown(frame)}', the map is in '{shown(self._map.frame_id)}'",
            )
        try:
            return to_matrix(to_pose(request.start.pose, "start"))
        except ValueError as error:
            raise NoPicture("without a pose", error) from error


def _converged(found: Refined) -> Refined:
    """What was found. Raises NoPicture where nothing was."""
    if problem := found.alignment.problem:
        raise NoPicture("not aligned", problem)
    return found


def main() -> None:
    run_node("align", AlignNode, AlignNode.align, THREADS)
