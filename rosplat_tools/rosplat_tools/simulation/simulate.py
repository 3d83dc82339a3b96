"""Simulates a robot in a map: MuJoCo moves it, the map is what its sensors see and it runs into.

Hears `gaussians`, and publishes objects that it moves as the map `objects`. Publishes /clock, /tf,
odom, joint_states, imu and sensors/NAME; for each CAMERA of the model CAMERA/image_raw,
CAMERA/depth/image_raw, CAMERA/segmentation and their camera_info; for a site named lidar, points
and scan. Hears cmd_vel, and actuators/NAME for each actuator. Pictures and scans are made while
somebody hears them, and time waits for them. Services: ~/reset, ~/pause and ~/step.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from ament_index_python.packages import get_package_share_directory
from geometry_msgs.msg import Twist, TwistStamped
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Float64
from std_srvs.srv import SetBool, Trigger

from rosplat_core.formats import load
from rosplat_core.log_text import counted, shown
from rosplat_core.occupancy import RESOLUTION
from rosplat_core.splats import InputError, Splats
from rosplat_msgs.msg import FirstView
from rosplat_ros.diagnostics import Diagnostics, Report
from rosplat_ros.map_publisher import MapPublisher
from rosplat_ros.program.parameters import declare
from rosplat_ros.program.running import run_node
from rosplat_ros.program.said_once import SaidOnce
from rosplat_ros.qos import LATCHED, overridable
from rosplat_tools.cameras.drawn_map import DrawnMap
from rosplat_tools.lidars.lidar_messages import declare_lidar
from rosplat_tools.simulation.physics import compiled, read_spec
from rosplat_tools.simulation.robot_model import (
    VELOCITY,
    BrokenState,
    RobotModel,
    put_in_map,
    robot_file,
)
from rosplat_tools.simulation.sensors import (
    LIDAR,
    CameraTopics,
    LidarTopics,
    stamp_of,
    ticks_of,
)
from rosplat_tools.simulation.solids import check_name
from rosplat_tools.simulation.splat_camera import SplatCamera
from rosplat_tools.simulation.states import States

COMMANDS = QoSProfile(depth=10)
TICK = 0.01  # simulated time between two messages on /clock [s]
STATES = 2  # ticks between two states
BREATH = 0.0005  # pause in which another thread can begin with a callback [s]
LATE = 0.2  # so far behind real time, it isn't made up for [s]
STALE = 0.5  # simulated time after which a velocity is no longer followed [s]


class Simulate(Node):
    """Simulates one robot. Callbacks set what is wanted; simulate() does it."""

    def __init__(self) -> None:
        """Raises InputError for a parameter that makes no sense, and where MuJoCo is missing."""
        super().__init__("simulate")
        folder = Path(get_package_share_directory("rosplat_tools")) / "robots"
        self._file = robot_file(
            declare(self, "robot", "mobile", "mobile, arm, quadrotor, or an MJCF file."), folder
        )
        start = declare(
            self, "start", [0.0, 0.0, 0.0],
            "x, y [m] and yaw [rad] in the upright map, or the nearest place with room.",
        )  # fmt: skip
        if len(start) != 3 or not np.isfinite(start).all():
            raise InputError(f"parameter start: expected x, y and yaw, got {list(start)}")
        self._start: tuple[float, float, float] = (start[0], start[1], start[2])
        self._objects = _objects(
            declare(
                self, "objects", [""], "Scene files, in the map's coordinates: each is a body that "
                "moves freely.",
            )
        )  # fmt: skip
        spec = read_spec(self._file)  # what is wrong ends it here, before there is a map
        for name in self._objects:
            check_name(spec, name)
        compiled(spec, self._file)
        self._resolution: float = declare(
            self, "resolution", RESOLUTION, "Edge of voxels of the map's solid parts. [m]",
            0.005, 10.0,
        )  # fmt: skip
        self._speed: float = declare(
            self, "speed", 1.0, "Simulated seconds in a second; 0: as many as can be.", 0.0, 100.0
        )
        odom: str = declare(
            self, "odom_frame", "odom", "Frame of the robot's world: its origin is at the start."
        )
        self._velocities: type = TwistStamped if declare(
            self, "enable_stamped_cmd_vel", False,
            "Whether cmd_vel is a TwistStamped, as by this parameter of Nav2.",
        ) else Twist  # fmt: skip
        rate = declare(self, "rate", 10.0, "Pictures of a camera in a second. [Hz]", 0.1, 100.0)
        self._picture_ticks = ticks_of(rate, TICK)
        self._lidar, self._lidar_rate = declare_lidar(self, "lidar.")
        self._map = DrawnMap(self)
        self._lock = threading.Lock()  # of all that follows
        self._scene: _Scene | None = None
        self._states = States(self, odom)
        self._sensors: list[CameraTopics | LidarTopics] | None = None  # none is known yet
        self._up = np.array([0.0, 0.0, 1.0])
        self._ticks = self._steps = 0  # that have passed, that ~/step asks for
        self._velocity_until = 0.0  # simulated time [s]
        self._paused = self._broken = False
        self._outdated = False  # whether the robot is to be put into the map anew
        self._reported = (0.0, 0.0)  # real and simulated time of the last report [s]
        self._problem = SaidOnce(self.get_logger().warning)
        # A map in which each object is a group that moves.
        self._bodies = MapPublisher(self, topic="objects") if self._objects else None
        self._time = self.create_publisher(Clock, "/clock", **overridable(QoSProfile(depth=10)))
        self.create_subscription(
            FirstView, f"{self._map.topic}/first_view", self._on_first_view,
            **overridable(LATCHED),
        )  # fmt: skip
        self.create_subscription(
            self._velocities, "cmd_vel", self._on_velocity, **overridable(COMMANDS)
        )
        self.create_service(Trigger, "~/reset", self._on_reset)
        self.create_service(SetBool, "~/pause", self._on_pause)
        self.create_service(Trigger, "~/step", self._on_step)
        Diagnostics(self, self._file.stem, self._report)
        self.get_logger().info(
            f"waiting for a map on {self._map.topic} to put {shown(self._file.stem)} in"
        )

    # --- Time -------------------------------------------------------------------------------------

    def simulate(self) -> None:
        """Simulates until ROS ends."""
        due = time.monotonic()
        while self.context.ok():
            with self._lock:
                self._map.apply_waiting()
                passes = self._place() and (not self._paused or self._steps > 0)
                if passes:
                    self._tick()
            now = time.monotonic()
            if not passes:
                due = now + TICK
            elif self._speed:
                due = max(due, now - LATE) + TICK / self._speed
            time.sleep(max(due - now, BREATH))

    def _tick(self) -> None:
        """One tick of simulated time, and what is published at its end."""
        assert self._scene and self._sensors is not None
        robot, eye = self._scene.robot, self._scene.eye
        self._steps = max(0, self._steps - 1)
        if self._velocity_until and robot.time > self._velocity_until:
            self._follow(Twist())
        try:
            robot.step(TICK)
        except BrokenState as error:
            self._paused = self._broken = True
            self._steps = 0
            self._problem.say(f"{error}: paused, and nothing is published; ~/reset begins anew")
            return
        self._ticks += 1
        stamp = stamp_of(robot.time)
        self._time.publish(Clock(clock=stamp))
        if self._ticks % STATES == 0:
            self._states.publish(stamp)
            if self._bodies is not None:
                self._bodies.move(eye.riders.poses(robot.data, eye.map_pose))
        if problem := self._map.problem():
            self._problem.say(f"cameras and lidar wait: {problem}")
            return
        self._problem.say(f"pictures lack bodies: {eye.problem}" if eye.problem else "")
        for sensor in self._sensors:
            if self._ticks % sensor.ticks == 0:
                sensor.publish(stamp, robot, eye)

    # --- The robot in the map ---------------------------------------------------------------------

    def _place(self) -> bool:
        """Puts the robot into the map once that is whole; returns whether it is there."""
        if self._outdated:  # dropped here: OpenGL's objects are this thread's
            self._scene, self._outdated = None, False
        if self._scene:
            return True
        problem = self._map.problem()
        if not problem:
            try:
                self._put()
                return True
            except InputError as error:
                problem = str(error)
        self._problem.say(f"the robot waits: {problem}")
        return False

    def _put(self) -> None:
        """Makes the model anew, in the map as it is now. Raises InputError."""
        began = time.monotonic()
        _, splats = self._map.renderer.snapshot()
        standing = put_in_map(
            self._file, splats, self._up, self._start, self._resolution, self._objects
        )
        robot, (x, y, ground) = standing.robot, standing.place
        if not standing.has_room:
            self.get_logger().warning(f"no ground with room for a robot is near {x:g}, {y:g}")
        pose = standing.map_pose
        eye = SplatCamera(
            robot.model, robot.data, self._map.renderer, map_pose=pose, riding=standing.riding
        )
        if self._bodies is not None:
            self._bodies.frame_id = self._map.frame_id
            self._bodies.replace(next(iter(self._objects.values()))[:0])
            for number, thing in enumerate(self._objects.values()):
                self._bodies.append(thing, group=number)
        if self._sensors is None:
            self._sensors = self._connect(robot)
        self._states.stand(robot, self._map.frame_id, pose)
        self._scene = _Scene(robot, eye, self._map.edits)
        self._problem.say("")
        self.get_logger().info(
            f"{shown(self._file.stem)} stands at {x:.2f}, {y:.2f}, {ground:.2f} m among "
            f"{counted(standing.boxes, 'box', 'boxes')}, after {time.monotonic() - began:.1f} s"
        )

    def _connect(self, robot: RobotModel) -> list[CameraTopics | LidarTopics]:
        """Opens the topics of the robot's cameras, lidar and actuators."""
        sensors: list[CameraTopics | LidarTopics] = [
            CameraTopics(self, name, number, self._picture_ticks)
            for name, number in robot.cameras.items()
        ]
        if not sensors:
            self.get_logger().info(f"{shown(self._file.stem)} has no camera: it takes no pictures")
        if LIDAR in robot.sites:
            ticks = ticks_of(self._lidar_rate, TICK)
            sensors.append(LidarTopics(self, self._lidar, self._lidar_rate, ticks))
        for name in robot.actuators:
            self.create_subscription(
                Float64, f"actuators/{name}", self._commander(name), **overridable(COMMANDS)
            )
        return sensors

    # --- Commands ---------------------------------------------------------------------------------

    def _on_first_view(self, view: FirstView) -> None:
        up = np.array([view.up.x, view.up.y, view.up.z])
        if np.isfinite(up).all() and np.linalg.norm(up) > 0:
            self._up = up

    def _commander(self, name: str) -> Callable[[Float64], None]:
        def on_command(message: Float64) -> None:
            with self._lock:
                self._command(name, message.data)

        return on_command

    def _command(self, name: str, value: float) -> None:
        try:
            if self._scene:
                self._scene.robot.command(name, value)
        except ValueError as error:
            self.get_logger().warning(f"left out: {error}", throttle_duration_sec=5.0)

    def _on_velocity(self, message: Twist | TwistStamped) -> None:
        with self._lock:
            if self._scene:
                self._follow(getattr(message, "twist", message))
                self._velocity_until = self._scene.robot.time + STALE

    def _follow(self, twist: Twist) -> None:
        self._velocity_until = 0.0
        assert self._scene
        for name in self._scene.robot.actuators.keys() & VELOCITY.keys():
            kind, axis = VELOCITY[name]
            self._command(name, getattr(getattr(twist, kind), axis))

    # --- Services ---------------------------------------------------------------------------------

    def _on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        with self._lock:
            if self._scene is None:
                response.message = "the robot waits for a map"
                return response
            self._velocity_until, self._ticks, self._steps = 0.0, 0, 0
            self._paused = self._paused and not self._broken
            self._broken = False
            self._problem.say("")
            response.success, response.message = True, "begins anew"
            if self._map.edits != self._scene.edits:
                self._outdated = True
                response.message = "begins anew in the map as it is now"
            else:
                self._scene.robot.reset()
                self._states.begin_anew()
        return response

    def _on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        with self._lock:
            if self._broken and not request.data:
                response.message = "the state is not finite: reset first"
                return response
            self._paused, self._steps = request.data, 0
        response.success, response.message = True, "paused" if request.data else "time passes"
        return response

    def _on_step(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        with self._lock:
            if self._scene is None or self._broken or not self._paused:
                response.message = "a step needs a robot that stands in a map and is paused"
                return response
            self._steps += 1
        response.success, response.message = True, f"{TICK:g} s pass"
        return response

    def _report(self) -> Report:
        scene = self._scene
        now = (time.monotonic(), scene.robot.time if scene else 0.0)
        real, simulated = np.subtract(now, self._reported).tolist()
        self._reported = now
        figures = {
            **self._map.figures(),
            "Simulated time (s)": round(now[1], 2),
            "Real-time factor": round(max(0.0, simulated) / max(real, 1e-6), 2),
        }
        problem = self._problem.now
        state = "paused" if self._paused else "time passes"
        return Report(problem or state, figures, warns=bool(problem))


def _objects(files: list[str]) -> dict[str, Splats]:
    """Splats of scene files, by names that are theirs without the ending. Raises InputError."""
    found: dict[str, Splats] = {}
    for file in filter(None, files):
        name = Path(file).stem
        if name in found:
            raise InputError(f"parameter objects: two are named {shown(name)}")
        found[name] = load(file)
    return found


@dataclass(frozen=True, eq=False)
class _Scene:
    """A robot that stands in a map."""

    robot: RobotModel
    eye: SplatCamera
    edits: int  # of the map by then


def main() -> None:
    run_node("simulate", Simulate, Simulate.simulate)
