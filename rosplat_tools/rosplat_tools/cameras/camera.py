"""Takes pictures of a map where TF, or a topic of poses, has a robot's cameras.

Hears `gaussians`. For each NAME of the parameter `cameras`, publishes NAME/camera_info and, where
somebody hears them, NAME/image_raw, NAME/depth/image_raw and NAME/normals, at the time of the pose.
"""

from __future__ import annotations

from copy import copy
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import qos_profile_sensor_data
from rclpy.time import Time
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header

from rosplat_core.lens_pictures import DEPTHS, LensPicture, Shutter, take_picture
from rosplat_core.lens_warps import Warp
from rosplat_core.lenses import Lens
from rosplat_core.splats import InputError
from rosplat_ros.images import to_bytes, to_image
from rosplat_ros.program.parameters import declare, declare_clip, declare_path
from rosplat_ros.program.running import run_node
from rosplat_ros.qos import PICTURES, overridable
from rosplat_tools.cameras import calibrations
from rosplat_tools.cameras.drawn_map import DrawnMap
from rosplat_tools.cameras.health import drawn
from rosplat_tools.cameras.heard_lens import HeardLens
from rosplat_tools.cameras.pose_history import SECOND, Pose
from rosplat_tools.cameras.posed_sensor import PosedSensor
from rosplat_tools.cameras.poses import Poses, declare_poses
from rosplat_tools.latched import LatchedSubscription

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
            _Camera(self, name, poses[name], self._map, rate, near, far, depth) for name in names
        ]

    def film(self) -> None:
        """Takes pictures until ROS ends."""
        for _ in self._map.turns():
            for camera in self._cameras:
                camera.sensor.turn()


class _Camera:
    """One camera: its parameters, topics and lens."""

    def __init__(
        self, node: CameraNode, name: str, poses: Poses, drawn_map: DrawnMap, rate: float,
        near: float, far: float, depth: str,
    ) -> None:  # fmt: skip
        """near, far: depths between which splats are drawn [m]. depth: one of DEPTHS."""
        self._node, self._name, self._map = node, name, drawn_map
        self._near, self._far, self._which_depth = near, far, depth
        self._frame_id: str = declare(
            node, f"{name}.frame_id", f"{name}_optical", "Its optical frame, of TF and of pictures."
        )
        self.sensor = PosedSensor(node, name, self._frame_id, poses, drawn_map, rate, self._film)
        readout = declare(
            node, f"{name}.readout", 0.0,
            "Time from the first row to the last, of a rolling shutter. [s]", 0.0, 1.0,
        )  # fmt: skip
        self._readout = round(SECOND * readout)  # [ns]
        topic = node.resolve_topic_name(f"{name}/calibration")
        self._lens = HeardLens(self._optics_of, "the calibration", topic)
        self._calibrate()

        def advertise(kind: type, topic: str) -> Publisher:
            return node.create_publisher(kind, f"{name}/{topic}", **overridable(PICTURES))

        self._infos = [advertise(CameraInfo, t) for t in ("camera_info", "depth/camera_info")]
        self._image = advertise(Image, "image_raw")
        self._depth = advertise(Image, "depth/image_raw")
        self._normals = advertise(Image, "normals")

    def _calibrate(self) -> None:
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
            LatchedSubscription(
                self._node, CameraInfo, f"{self._name}/calibration", self._lens.hear,
                qos_profile_sensor_data,
            )  # fmt: skip
        elif path:
            self._lens.hear(calibrations.load(path))
        else:
            self._lens.hear(calibrations.of_lens(Lens.of_view(width, height, angle)))

    def _optics_of(self, info: CameraInfo) -> tuple[Warp, Shutter | None]:
        lens = calibrations.lens_of(info)
        return Warp(lens), Shutter(lens) if self._readout else None

    def _film(self, stamp: int, pose: Pose) -> bool:
        exposed = max(0, stamp - self._readout)  # when the first row is
        info, (warp, shutter) = self._lens.made()
        picture = self._draw(warp, shutter, pose, exposed)
        header = Header(stamp=Time(nanoseconds=exposed).to_msg(), frame_id=self._frame_id)
        self._publish(picture, info, header)
        return True

    def _draw(
        self, warp: Warp, shutter: Shutter | None, pose: Pose, exposed: int
    ) -> LensPicture | None:
        listened = [
            t.get_subscription_count() > 0 for t in (self._image, self._depth, self._normals)
        ]
        if not any(listened):
            return None
        world_to_lens = np.linalg.inv(pose).astype(np.float64)
        self._map.publish_cameras(self._name, warp.cameras(world_to_lens, self._near, self._far))
        wanted: dict[str, Any] = {
            "near": self._near,
            "far": self._far,
            "depth": self._which_depth if listened[1] else "",
            "normals": listened[2],
        }

        def moved(share: float) -> NDArray[np.float64]:
            _, pose = self.sensor.pose(exposed + round(share * self._readout))
            return np.linalg.inv(pose).astype(np.float64)

        with drawn():
            if shutter:
                return shutter.take(self._map.renderer, moved, **wanted)
            return take_picture(self._map.renderer, warp, world_to_lens, **wanted)

    def _publish(self, picture: LensPicture | None, info: CameraInfo, header: Header) -> None:
        info = copy(info)
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
