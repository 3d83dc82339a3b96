"""Sensors of a simulated robot as topics; a message is made while somebody hears it."""

from __future__ import annotations

import math

import numpy as np
from builtin_interfaces.msg import Time
from rclpy.node import Node
from rclpy.time import Time as RosTime
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header

from rosplat_core.rendering import CpuRenderer
from rosplat_core.rigid import placed
from rosplat_ros.images import to_image
from rosplat_ros.qos import PICTURES, overridable
from rosplat_tools.cameras.calibrations import of_pinhole
from rosplat_tools.cameras.pose_history import SECOND
from rosplat_tools.lidars.lidar_messages import ScanTopics
from rosplat_tools.lidars.scanning import Lidar, Scan
from rosplat_tools.simulation.robot_model import RobotModel
from rosplat_tools.simulation.splat_camera import SplatCamera

LIDAR = "lidar"  # the site where a model has one


def stamp_of(seconds: float) -> Time:
    """A simulated time as a message's."""
    return RosTime(nanoseconds=round(seconds * SECOND)).to_msg()


def optical(camera: str) -> str:
    """The frame of what a camera sees."""
    return f"{camera}_optical"


class CameraTopics:
    """A camera of a model."""

    def __init__(self, node: Node, name: str, number: int, ticks: int) -> None:
        """name: of its topics. number: in the model. ticks: of simulated time between two
        pictures."""
        self.ticks = ticks
        self._frame, self._number = optical(name), number
        kinds = {
            "image_raw": Image, "depth/image_raw": Image, "segmentation": Image,
            "camera_info": CameraInfo, "depth/camera_info": CameraInfo,
        }  # fmt: skip
        self._image, self._depth, self._bodies, *self._infos = (
            node.create_publisher(kind, f"{name}/{topic}", **overridable(PICTURES))
            for topic, kind in kinds.items()
        )

    def publish(self, stamp: Time, robot: RobotModel, eye: SplatCamera) -> None:
        """Takes a picture of now, if somebody hears it."""
        header = Header(stamp=stamp, frame_id=self._frame)
        camera = eye.camera(self._number)
        if not camera.orthographic:  # CameraInfo has no word for it
            info = of_pinhole(camera)
            info.header = header
            for publisher in self._infos:
                publisher.publish(info)
        publishers = (self._image, self._depth, self._bodies)
        if not any(publisher.get_subscription_count() for publisher in publishers):
            return
        picture = eye.picture(self._number, bodies=self._bodies.get_subscription_count() > 0)
        self._image.publish(to_image(picture.colour, "rgb8", header))
        self._depth.publish(to_image(picture.depth, "32FC1", header))
        if picture.bodies is not None:
            self._bodies.publish(to_image(picture.bodies, "16UC1", header))


class LidarTopics:
    """A lidar at the site of a model that is named so."""

    def __init__(self, node: Node, lidar: Lidar, rate: float, ticks: int) -> None:
        """rate: scans in a second [Hz]. ticks: of simulated time between two scans."""
        self.ticks, self._lidar = ticks, lidar
        self._topics = ScanTopics(node, lidar, rate)

    def publish(self, stamp: Time, robot: RobotModel, eye: SplatCamera) -> None:
        """Measures now, if somebody hears it."""
        if not self._topics.heard():
            return
        assert isinstance(eye.renderer, CpuRenderer)  # the node's own
        site = robot.sites[LIDAR]
        pose = placed(robot.data.site_xpos[site], robot.data.site_xmat[site])
        beside = eye.riders.at(robot.data, eye.map_pose)
        scan = self._lidar.scan(eye.renderer, np.linalg.inv(pose) @ eye.map_pose, beside)
        rays = self._lidar.pattern.rays @ pose[:3, :3].T
        body = int(robot.model.site_bodyid[site])
        scan = _nearer(scan, robot.cast(pose[:3, 3], rays, body), self._lidar.limits)
        self._topics.publish(Header(stamp=stamp, frame_id=LIDAR), scan)


def _nearer(scan: Scan, distances: np.ndarray, limits: tuple[float, float]) -> Scan:
    """What is met first, a map or bodies at distances (n,), which answer as brightly as grey."""
    of_body = (distances < scan.ranges) & (distances >= limits[0]) & (distances <= limits[1])
    return Scan(
        np.where(of_body, distances, scan.ranges).astype(np.float32),
        np.where(of_body, 127, scan.intensities).astype(np.float32),
    )


def ticks_of(rate: float, tick: float) -> int:
    """Ticks [s] between what comes at a rate [Hz]."""
    return max(1, math.floor(1 / (rate * tick) + 0.5))
