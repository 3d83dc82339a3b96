"""Takes pictures of a map where TF, or a topic of poses, has a robot's cameras.

Hears `gaussians`. For each NAME of the parameter `cameras`, publishes NAME/camera_info and, where
somebody hears them, NAME/image_raw, NAME/depth/image_raw and NAME/normals, at the time of the pose.
"""

from __future__ import annotations

import time
from copy import copy
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile, qos_profile_sensor_data
from rclpy.time import Time
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header

from rosplat_core.lens_pictures import DEPTHS, LensPicture, Shutter, take_picture
from rosplat_core.lens_warps import Warp
from rosplat_core.lenses import Lens
from rosplat_core.splats import InputError
from rosplat_ros.diagnostics import Diagnostics
from rosplat_ros.images import to_bytes, to_image
from rosplat_ros.program.parameters import declare, declare_clip, declare_path
from rosplat_ros.program.running import run_node
from rosplat_ros.qos import overridable
from rosplat_tools.cameras import calibrations
from rosplat_tools.cameras.drawn_map import DrawnMap
from rosplat_tools.cameras.health import Health, NoPicture, drawn
from rosplat_tools.cameras.pose_history import SECOND, Pose, PoseError
from rosplat_tools.cameras.poses import Poses, declare_poses
from rosplat_tools.frames import LATEST
from rosplat_tools.latched import LatchedSubscription

# Reliable: such a publisher serves best-effort subscribers, too.
PICTURES = QoSProfile(depth=5)
TOPIC = "topic"  # value of `calibration`: hear CameraInfo, read no file


class CameraNode(Node):
    """Holds one map for all of its cameras. Callbacks only hand data over; film() draws."""

    def __init__(self) -> None:
        super().__init__("camera")
        names = declare(self, "cameras", ["camera"], "Names of the cameras.")
        rate = declare(
            self,
            "rate",
            10.0,
            "Most pictures that each camera takes in a second. [Hz]",
            0.01,
            1000.0,
        )
        near, far = declare_clip(self)
        depth = declare(self, "depth", DEPTHS[0], "Which depth", choices=DEPTHS)
        wellformed = all(name.isidentifier() and name.isascii() for name in names)
        if len(set(names)) < len(names) or not wellformed:
            raise InputError(f"parameter cameras: expected names, each once, got {names}")
        self._map = DrawnMap(self)
        poses = declare_poses(self, names, self._map.came.set)
        self._cameras = [
            _Camera(self, name, poses, self._map, Shot(round(SECOND / rate), near, far, depth))
            for name in names
        ]
        for camera in self._cameras:
            Diagnostics(self, camera.health.name, camera.health.report)

    def film(self) -> None:
        """Takes pictures until ROS ends."""
        for _ in self._map.turns():
            for camera in self._cameras:
                camera.film()


@dataclass(frozen=True)
class Shot:
    """How pictures are taken."""

    period: int
    """Least time between two pictures of a camera. [ns]"""
    near: float
    """Depths between which splats are drawn. [m]"""
    far: float
    depth: str
    """One of lens_pictures.DEPTHS."""


class _Camera:
    """One camera: its parameters, topics and lens."""

    def __init__(
        self, node: CameraNode, name: str, poses: Poses, drawn_map: DrawnMap, shot: Shot
    ) -> None:
        self._node, self._name, self._poses, self._map = node, name, poses, drawn_map
        self._shot = shot
        self.health = Health(name, node.get_logger().warning)
        self._frame_id: str = declare(
            node, f"{name}.frame_id", f"{name}_optical", "Its optical frame, of TF and of pictures."
        )
        self._info = self._calibration()
        readout = declare(
            node, f"{name}.readout", 0.0,
            "Time from the first row to the last, of a rolling shutter. [s]", 0.0, 1.0,
        )  # fmt: skip
        self._readout = round(SECOND * readout)  # [ns]
        self._warp: Warp | None = None
        self._shutter: Shutter | None = None  # if there is a readout
        self._fault = ""  # why there is no warp
        self._warped: CameraInfo | None = None  # that the warp was made for
        self._last = self._due = 0  # of the last picture, of the next at the earliest [ns]
        self._now = 0  # by the node's clock, when it was last looked at [ns]
        self._looked = time.monotonic()
        self._rests_until = 0.0  # after trouble, which is thus counted once a period

        def advertise(kind: type, topic: str) -> Publisher:
            return node.create_publisher(kind, f"{name}/{topic}", **overridable(PICTURES))

        self._infos = [advertise(CameraInfo, t) for t in ("camera_info", "depth/camera_info")]
        self._image = advertise(Image, "image_raw")
        self._depth = advertise(Image, "depth/image_raw")
        self._normals = advertise(Image, "normals")

    def _calibration(self) -> CameraInfo | None:
        def of(what: str, *rest: Any) -> Any:
            return declare(self._node, f"{self._name}.{what}", *rest)

        path = declare_path(
            self._node, f"{self._name}.calibration", "",
            "File of camera_calibration; topic: heard on NAME/calibration.",
        )  # fmt: skip
        width = of("width", 640, "Width of pictures without a calibration. [px]", 1, 8192)
        height = of("height", 360, "Height of pictures without a calibration. [px]", 1, 8192)
        angle = of("fov", 1.2, "Horizontal field of view without a calibration. [rad]", 0.01, 3.1)
        if path == TOPIC:
            heard = LatchedSubscription(
                self._node, CameraInfo, f"{self._name}/calibration", self._on_calibration,
                qos_profile_sensor_data,
            )  # fmt: skip
            self._topic = heard.topic
            return None
        return (
            calibrations.load(path)
            if path
            else calibrations.of_lens(Lens.of_view(width, height, angle))
        )

    def _on_calibration(self, info: CameraInfo) -> None:
        info.header = Header()  # with another time it is the same calibration
        if info != self._info:
            self._info = info

    def film(self) -> None:
        """Takes a picture, if one is due and a pose has come since the last picture."""
        now = time.monotonic()
        passed, self._looked = now - self._looked, now
        self.health.counts["skipped"] += int(passed * SECOND / self._shot.period)
        if now < self._rests_until:
            return
        try:
            self._film()
        except NoPicture as none:
            self.health.trouble(none.kind, none)
            self._rests_until = now + self._shot.period / SECOND

    def _film(self) -> None:
        began = time.perf_counter()
        warp = self._lens()
        if problem := self._map.problem():
            raise NoPicture("without a map", problem)
        try:
            stamp, pose = self._poses.newest(self._name, self._frame_id, self._map.frame_id)
        except PoseError as error:
            raise NoPicture("without a pose", error) from error
        before, self._now = self._now, self._node.get_clock().now().nanoseconds
        stamp = self._now if stamp == LATEST else stamp
        if self._now < before or stamp < self._last - SECOND:  # a run has begun again
            self._last = self._due = 0
        if stamp <= self._last or stamp < self._due:
            return
        exposed = max(0, stamp - self._readout)  # when the first row is
        picture = self._draw(warp, pose, exposed)
        period = self._shot.period
        self._last, self._due = stamp, max(self._due + period, stamp + period * 3 // 4)  # of jitter
        self._publish(
            picture, Header(stamp=Time(nanoseconds=exposed).to_msg(), frame_id=self._frame_id)
        )
        latency = (self._node.get_clock().now().nanoseconds - stamp) / SECOND
        self.health.well(latency, time.perf_counter() - began)

    def _lens(self) -> Warp:
        info = self._info
        if info is None:
            raise NoPicture("without a lens", f"no CameraInfo has come on {self._topic}")
        if info is not self._warped:
            self._warp, self._warped = None, info
            try:
                lens = calibrations.lens_of(info)
                self._warp = Warp(lens)
                self._shutter = Shutter(lens) if self._readout else None
            except ValueError as error:  # LensError, or beyond what float32 or int64 holds
                self._fault = f"the calibration is refused: {error}"
        if self._warp is None:
            raise NoPicture("without a lens", self._fault)
        return self._warp

    def _draw(self, warp: Warp, pose: Pose, exposed: int) -> LensPicture | None:
        listened = [
            t.get_subscription_count() > 0 for t in (self._image, self._depth, self._normals)
        ]
        if not any(listened):
            return None
        depth, shot = self._shot.depth if listened[1] else "", self._shot
        world_to_lens = np.linalg.inv(pose).astype(np.float64)
        self._map.publish_cameras(self._name, warp.cameras(world_to_lens, shot.near, shot.far))
        wanted: dict[str, Any] = {
            "near": shot.near,
            "far": shot.far,
            "depth": depth,
            "normals": listened[2],
        }

        def moved(share: float) -> NDArray[np.float64]:
            at = exposed + round(share * self._readout)
            pose = self._poses.at(self._name, self._frame_id, self._map.frame_id, at)
            return np.linalg.inv(pose).astype(np.float64)

        try:
            with drawn():
                if self._shutter:
                    return self._shutter.take(self._map.renderer, moved, **wanted)
                return take_picture(self._map.renderer, warp, world_to_lens, **wanted)
        except PoseError as error:
            raise NoPicture("without a pose", error) from error

    def _publish(self, picture: LensPicture | None, header: Header) -> None:
        assert self._warped
        info = copy(self._warped)
        info.header = header
        for publisher in self._infos:
            publisher.publish(info)
        if not picture:
            return
        self._image.publish(to_image(to_bytes(picture.colour), "rgb8", header))
        if picture.depth is not None:
            self._depth.publish(to_image(picture.depth, "32FC1", header))
        if picture.normals is not None:
            self._normals.publish(to_image(picture.normals, "32FC3", header))


def main() -> None:
    run_node("camera", CameraNode, CameraNode.film)
