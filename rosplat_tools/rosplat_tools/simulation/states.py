"""What a robot in a simulation says of itself: TF, markers, odometry, joints, sensors."""

from __future__ import annotations

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import TransformStamped, Twist
from nav_msgs.msg import Odometry
from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import Float64MultiArray, Header

from rosplat_core.quaternions import from_matrices
from rosplat_core.rigid import placed
from rosplat_ros.poses import to_pose, to_quaternion, to_vector
from rosplat_ros.qos import LATCHED, overridable
from rosplat_tools.frames import TFMessage, tf_publishers, transform
from rosplat_tools.simulation.body_pictures import OPTICAL
from rosplat_tools.simulation.robot_model import RobotModel, another
from rosplat_tools.simulation.sensors import LIDAR, optical

try:  # which environments from PyPI may lack
    from visualization_msgs.msg import MarkerArray

    from rosplat_tools.simulation.markers import markers_of
except ImportError:
    MarkerArray = None

Array = NDArray[np.float64]

SENSOR = QoSProfile(depth=10)
FIXED = 0  # mjCAMLIGHT_FIXED: of a camera, on its body
AGAIN = 50, 250, 1000  # states after which a new rviz2 may know of all frames: 1, 5 and 20 s


class States:
    """Publishes the state of a robot; what a model lacks is left out."""

    def __init__(self, node: Node, odom: str) -> None:
        """odom: frame of the robot's world."""
        self._node, self._odom = node, odom
        self._robot: RobotModel | None = None
        self._joints = node.create_publisher(JointState, "joint_states", **overridable(SENSOR))
        self._odometry = node.create_publisher(Odometry, "odom", **overridable(SENSOR))
        self._imu = node.create_publisher(Imu, "imu", **overridable(SENSOR))
        self._sensors: dict[int, Publisher] = {}
        self._tf, self._tf_static = tf_publishers(node)
        self._shapes: Publisher | None = None
        self._viewers = 0  # of the markers
        self._since = 0  # states since there was a new one, or time began anew
        if self._tf and MarkerArray:
            self._shapes = node.create_publisher(
                MarkerArray, "robot_markers", **overridable(LATCHED)
            )

    def stand(self, robot: RobotModel, map_frame: str, map_pose: Array) -> None:
        """From now on, publishes the state of this robot. map_pose: (4, 4) of the map in the
        robot's world [m]."""
        self._robot = robot
        self._bodies = robot.bodies()
        self._name_frames(robot, map_frame)
        for name, number in robot.sensors.items() if not self._sensors else ():
            self._sensors[number] = self._node.create_publisher(
                Float64MultiArray, f"sensors/{name}", **overridable(SENSOR)
            )
        if self._tf_static:
            header = Header(frame_id=map_frame)
            stands = transform(header, self._odom, to_pose(np.linalg.inv(map_pose)))
            self._tf_static.publish(TFMessage(transforms=[stands, *self.fixed(robot)]))
        if self._shapes:
            self._shapes.publish(markers_of(robot, self.frames))
        self.begin_anew()

    def _name_frames(self, robot: RobotModel, map_frame: str) -> None:
        """Gives each body, camera and site a frame of its own, whatever they share names with."""
        self._eyes = {number: optical(name) for name, number in robot.cameras.items()}
        taken = {map_frame, self._odom, *self._eyes.values(), *robot.sites.keys() & {LIDAR}}
        self.frames = {0: self._odom}
        """Of bodies, by their numbers."""
        for number, name, _ in self._bodies:
            self.frames[number] = another(name, taken, "body")
            taken.add(self.frames[number])
        self._sites = {}
        for name, number in robot.sites.items():
            frame = name if name == LIDAR else another(name, taken, "site")
            self._sites[name] = number, frame
            taken.add(frame)

    def begin_anew(self) -> None:
        """Simulated time goes back: rviz2 forgets all markers then, which come again."""
        self._since = 0

    def _show_again(self) -> None:
        """Publishes the markers once more if it is time. A new rviz2 gets them before TF, and calls
        them an error until they come again."""
        assert self._robot and self._shapes
        viewers = self._shapes.get_subscription_count()
        self._since = 0 if viewers > self._viewers else self._since + 1
        self._viewers = viewers
        if self._since in AGAIN:
            self._shapes.publish(markers_of(self._robot, self.frames))

    def publish(self, stamp: Time) -> None:
        """Publishes the state as it is now."""
        assert self._robot
        robot = self._robot
        joints = robot.joints()
        if joints:
            names, places, speeds = (list(each) for each in zip(*joints, strict=True))
            self._joints.publish(
                JointState(
                    header=Header(stamp=stamp),
                    name=names,
                    position=robot.data.qpos[places].tolist(),
                    velocity=robot.data.qvel[speeds].tolist(),
                    effort=robot.data.qfrc_actuator[speeds].tolist(),
                )
            )
        if self._shapes:
            self._show_again()
        if self._tf:
            self._tf.publish(TFMessage(transforms=self.transforms(stamp)))
        if robot.travels:
            self._odometry.publish(self._odometry_message(robot, stamp))
        for number, publisher in self._sensors.items():
            if publisher.get_subscription_count():
                publisher.publish(Float64MultiArray(data=robot.measured(number).tolist()))
        if (imu := self._imu_message(robot, stamp)) is not None:
            self._imu.publish(imu)

    def transforms(self, stamp: Time) -> list[TransformStamped]:
        """Where bodies are in their parents' frames, and cameras that turn to what they track."""
        assert self._robot
        found = []
        for number, _, parent in self._bodies:
            pose = np.linalg.inv(self._robot.pose(parent)) @ self._robot.pose(number)
            header = Header(stamp=stamp, frame_id=self.frames[parent])
            found.append(transform(header, self.frames[number], to_pose(pose)))
        return found + self._cameras(self._robot, stamp, fixed=False)

    def fixed(self, robot: RobotModel) -> list[TransformStamped]:
        """Where the optical frames of cameras, and sites, are on their bodies."""
        found = self._cameras(robot, Time(), fixed=True)
        for number, frame in self._sites.values():
            body = int(robot.model.site_bodyid[number])
            pose = placed(robot.data.site_xpos[number], robot.data.site_xmat[number])
            found.append(self._on_body(robot, Time(), body, frame, pose))
        return found

    def _cameras(self, robot: RobotModel, stamp: Time, *, fixed: bool) -> list[TransformStamped]:
        found, model, data = [], robot.model, robot.data
        for number, frame in self._eyes.items():
            if (model.cam_mode[number] == FIXED) == fixed:
                pose = placed(data.cam_xpos[number], data.cam_xmat[number])
                pose[:3, :3] = pose[:3, :3] @ OPTICAL
                body = int(model.cam_bodyid[number])
                found.append(self._on_body(robot, stamp, body, frame, pose))
        return found

    def _on_body(
        self, robot: RobotModel, stamp: Time, body: int, frame: str, pose: Array
    ) -> TransformStamped:
        header = Header(stamp=stamp, frame_id=self.frames.get(body, self._odom))
        return transform(header, frame, to_pose(np.linalg.inv(robot.pose(body)) @ pose))

    def _odometry_message(self, robot: RobotModel, stamp: Time) -> Odometry:
        base = robot.base
        message = Odometry(header=Header(stamp=stamp, frame_id=self._odom))
        message.child_frame_id = self.frames[base]
        message.pose.pose = to_pose(robot.pose(base))
        velocity = robot.velocity(base)
        message.twist.twist = Twist(linear=to_vector(velocity[:3]), angular=to_vector(velocity[3:]))
        return message

    def _imu_message(self, robot: RobotModel, stamp: Time) -> Imu | None:
        measured = robot.imu()
        if measured is None:
            return None
        site, rotation, turn, acceleration = measured
        return Imu(
            header=Header(stamp=stamp, frame_id=self._sites[site][1]),
            orientation=to_quaternion(from_matrices(rotation)),
            angular_velocity=to_vector(turn),
            linear_acceleration=to_vector(acceleration),
        )
