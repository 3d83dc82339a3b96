"""A robot for the demo: circles the map and publishes what its IMU and its camera measure.

Everything follows the node's clock, simulated or not. A renderer at `gaussians/render` draws the
camera's pictures.
"""

from __future__ import annotations

import time
from collections import deque
from dataclasses import dataclass
from functools import partial

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path
from numpy.typing import NDArray
from rclpy.client import Client
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.task import Future
from sensor_msgs.msg import CameraInfo, Image, Imu
from std_msgs.msg import Header

from rosplat_core.cameras import Camera
from rosplat_core.maps import GaussianMap
from rosplat_msgs.msg import GaussianArray
from rosplat_msgs.srv import RenderView
from rosplat_ros.held_map import MapSubscriber
from rosplat_ros.images import to_bytes, to_image
from rosplat_ros.poses import pose_of, to_quaternion, to_vector
from rosplat_ros.program.parameters import declare
from rosplat_ros.program.running import run_node
from rosplat_ros.qos import overridable
from rosplat_ros.view_cameras import view_camera
from rosplat_tools.cameras.calibrations import of_pinhole
from rosplat_tools.cameras.pose_history import SECOND
from rosplat_tools.emulation.flight import CAMERA_OFFSET, Flight, Motion
from rosplat_tools.frames import TFMessage, tf_publishers, transform

# Reliable: such a publisher serves best-effort subscribers, too. Deep: late ticks send bursts.
SENSOR = QoSProfile(depth=100)

BODY = "demo_robot"
CAMERA = "demo_camera_optical"

IMU_RATE = 200  # of TF, too [Hz]
IMAGE_RATE = 10  # of camera poses, and at most of pictures [Hz]
BACKLOG = SECOND // 2  # the longest delay that a tick makes up for [ns]
ORDER_TIMEOUT = 0.2  # what a renderer may wait for a sorter [s]
PICTURE_TIMEOUT = 5.0  # after which a renderer's answer is given up [s]
BACKGROUND = np.array([32, 34, 38]) / 255  # as in the shipped rviz configuration


@dataclass
class Beat:
    """Moments at whole multiples of a period [ns]: a late tick shifts none of them."""

    period: int
    last: int = 0

    def due(self, now: int) -> list[int]:
        """The moments since the last call, oldest first; after a leap of the clock the newest."""
        newest = now // self.period
        if not 0 <= newest - self.last <= max(1, BACKLOG // self.period):
            self.last = newest - 1
        moments = [number * self.period for number in range(self.last + 1, newest + 1)]
        self.last = newest
        return moments


class DemoSensors(Node):
    """Publishes TF, IMU, camera and path of a robot that circles the map."""

    def __init__(self) -> None:
        """Waits for a map."""
        super().__init__("demo_sensors")
        self._period: float = declare(self, "period", 24.0, "Time of one round. [s]", 1.0, 3600.0)
        self._acceleration_noise: float = declare(
            self, "acceleration_noise", 0.03, "Standard deviation of the IMU. [m/s^2]", 0.0, 10.0
        )
        self._angular_velocity_noise: float = declare(
            self,
            "angular_velocity_noise",
            0.003,
            "Standard deviation of the IMU. [rad/s]",
            0.0,
            1.0,
        )
        self._width: int = declare(self, "image_width", 320, "Width of the picture. [px]", 16, 4096)
        self._height: int = declare(
            self, "image_height", 240, "Height of the picture. [px]", 16, 4096
        )
        self._noise = np.random.default_rng(0)
        self._imu_beat = Beat(SECOND // IMU_RATE)
        self._image_beat = Beat(SECOND // IMAGE_RATE)
        self._flight: Flight | None = None
        self._frame_id = ""  # the map's, since the path is laid
        self._trail: deque[PoseStamped] = deque(maxlen=round(self._period * IMAGE_RATE))
        self._asked: tuple[Future, float] | None = None  # for a picture, and when

        self._imu = self.create_publisher(Imu, "imu/data", **overridable(SENSOR))
        self._image = self.create_publisher(Image, "camera/image_raw", **overridable(SENSOR))
        self._info = self.create_publisher(CameraInfo, "camera/camera_info", **overridable(SENSOR))
        self._pose = self.create_publisher(PoseStamped, "camera/pose", **overridable(SENSOR))
        self._path = self.create_publisher(Path, "camera/path", **overridable(SENSOR))
        self._tf, self._tf_static = tf_publishers(self)

        self._map = MapSubscriber(self, GaussianMap(), most_sh_degree=0)
        self._map.applied = self._on_batch
        self._is_new = False  # whether the path is still to be laid around the map
        self._topic = self._map.topic
        self._renderer: Client = self.create_client(RenderView, f"{self._topic}/render")
        self.get_logger().info(f"waiting for a map on {self._topic} to fly around")
        self.create_timer(self._imu_beat.period / SECOND, self._tick)

    # --- The path ---------------------------------------------------------------------------------

    def _on_batch(self, batch: GaussianArray) -> None:
        self._is_new |= batch.operation == GaussianArray.REPLACE

    def _plan_flight(self) -> None:
        """Lays the path anew around a map that was sent, once all of it has come."""
        self._map.apply_waiting()
        if self._is_new and not self._map.problem() and len(sample := self._map.books.sample):
            self._is_new = False
            self._frame_id = self._map.header.frame_id
            self._begin_flight(Flight.around(sample, self._period))

    def _begin_flight(self, flight: Flight) -> None:
        self._flight = flight
        self._trail.clear()
        self.get_logger().info(
            f"circling ({', '.join(f'{value:.2f}' for value in flight.centre)}) in "
            f"{self._frame_id}: radius {flight.radius:.2f} m, height {flight.height:.2f} m"
        )
        if self._tf_static:
            header = Header(stamp=self.get_clock().now().to_msg(), frame_id=BODY)
            mount = pose_of((CAMERA_OFFSET, 0, 0), flight.mount.quaternion)
            self._tf_static.publish(TFMessage(transforms=[transform(header, CAMERA, mount)]))

    # --- What is measured -------------------------------------------------------------------------

    def _tick(self) -> None:
        self._plan_flight()
        flight = self._flight
        if not flight:
            return
        now = self.get_clock().now().nanoseconds
        motions = [(stamp, self._motion(flight, stamp)) for stamp in self._imu_beat.due(now)]
        if motions and self._tf:
            # Before the measurements, for the newest: displays look the pose up for each of them.
            stamp, motion = motions[-1]
            header = Header(stamp=_time(stamp), frame_id=self._frame_id)
            pose = pose_of(motion.position, motion.attitude.quaternion)
            self._tf.publish(TFMessage(transforms=[transform(header, BODY, pose)]))
        for stamp, motion in motions:
            self._imu.publish(self._measure(stamp, motion))
        for stamp in self._image_beat.due(now)[-1:]:
            camera = flight.camera(self._motion(flight, stamp), self._width, self._height)
            self._request_picture(camera, _time(stamp))

    def _motion(self, flight: Flight, stamp: int) -> Motion:
        # In whole nanoseconds: a float64 of today's date resolves a quarter of a microsecond.
        return flight.at(stamp % round(self._period * SECOND) / SECOND)

    def _measure(self, stamp: int, motion: Motion) -> Imu:
        noise = self._noise.normal(size=(2, 3))
        force = motion.specific_force + self._acceleration_noise * noise[0]
        angular_velocity = motion.angular_velocity + self._angular_velocity_noise * noise[1]
        return Imu(
            header=Header(stamp=_time(stamp), frame_id=BODY),
            orientation=to_quaternion(motion.attitude.quaternion),
            orientation_covariance=_covariance(0.0),
            angular_velocity=to_vector(angular_velocity),
            angular_velocity_covariance=_covariance(self._angular_velocity_noise),
            linear_acceleration=to_vector(force),
            linear_acceleration_covariance=_covariance(self._acceleration_noise),
        )

    # --- The camera -------------------------------------------------------------------------------

    def _request_picture(self, camera: Camera, stamp: Time) -> None:
        view = view_camera(camera)
        view.header = Header(stamp=stamp, frame_id=self._frame_id)
        pose = PoseStamped(header=view.header, pose=view.pose)
        self._pose.publish(pose)
        self._trail.append(pose)
        self._path.publish(Path(header=pose.header, poses=list(self._trail)))
        if self._asked:
            future, when = self._asked
            if time.monotonic() - when < PICTURE_TIMEOUT:
                return
            self._renderer.remove_pending_request(future)
            self._asked = None
        if not self._renderer.service_is_ready():
            return
        request = RenderView.Request(camera=view, order_timeout=ORDER_TIMEOUT)
        future = self._renderer.call_async(request)
        self._asked = future, time.monotonic()
        future.add_done_callback(partial(self._on_picture, camera, stamp))

    def _on_picture(self, camera: Camera, stamp: Time, future: Future) -> None:
        if not self._asked or self._asked[0] is not future:
            return
        self._asked = None
        try:
            pixels = _pixels(future.result(), camera)
        except ValueError as error:
            self.get_logger().warning(
                f"{self._topic}/render: no picture of the map: {error}", throttle_duration_sec=10.0
            )
            return
        header = Header(stamp=stamp, frame_id=CAMERA)
        self._image.publish(to_image(pixels, "rgb8", header))
        info = of_pinhole(camera)
        info.header = header
        self._info.publish(info)


def _time(stamp: int) -> Time:
    return Time(sec=stamp // SECOND, nanosec=stamp % SECOND)


def _pixels(response: RenderView.Response, camera: Camera) -> NDArray[np.uint8]:
    """(height, width, 3) the picture over the background. Raises ValueError where there is none."""
    color = response.color
    if not response.success:
        raise ValueError(response.message)
    values = np.frombuffer(color.data, np.uint8)
    if color.encoding != "32FC4" or values.size != camera.height * camera.width * 16:
        raise ValueError(f"{values.size} bytes of {color.encoding}")
    rgba = values.view(np.float32).reshape(camera.height, camera.width, 4)
    return to_bytes(rgba[..., :3] + (1 - rgba[..., 3:]) * BACKGROUND)


def _covariance(deviation: float) -> NDArray[np.float64]:
    """(9,) of three independent values; never all zero, which would mean unknown."""
    return np.eye(3).ravel() * max(deviation**2, 1e-9)


def main() -> None:
    run_node("demo_sensors", DemoSensors)
