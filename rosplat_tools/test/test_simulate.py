"""The program simulate, in a process of its own: time, commands, sensors, and what goes wrong."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Twist, TwistStamped
from nav_msgs.msg import Odometry
from point_cloud import points_of
from rclpy.node import Node
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, Image, Imu, JointState, LaserScan, PointCloud2
from std_msgs.msg import Float64, Float64MultiArray
from std_srvs.srv import SetBool, Trigger

from rosplat_core.formats import save
from rosplat_core.generated import generate
from rosplat_msgs.msg import GaussianArray
from rosplat_ros.images import from_image
from rosplat_ros.map_publisher import MapPublisher
from rosplat_ros.qos import LATCHED
from rosplat_testing import Listener
from rosplat_testing.studio import Log
from rosplat_tools.simulation.robot_model import RobotModel, robot_file
from rosplat_tools.simulation.solids import Boxes
from rosplat_tools.simulation.states import AGAIN, States

pytest.importorskip("mujoco", reason="no mujoco here (PyPI)")

ROOMS = generate(60_000, scene="rooms")
ROBOTS = Path(__file__).resolve().parents[1] / "robots"
OWN_CLOCK = {"/clock": "clock"}  # of the test's namespace
START = {"start": "[-1.2, -1.2, 0.0]", "resolution": 0.1}


class Stage:
    """A map, and what a simulation in it publishes."""

    def __init__(self, node: Node, listener: Listener) -> None:
        self.node, self.listener = node, listener
        self.heard: dict[str, list[Any]] = {}
        self.map = MapPublisher(node)
        self.map.replace(ROOMS)

    def hear(self, **topics: Any) -> None:
        for topic, kind in topics.items():
            name = topic.replace("__", "/")
            self.node.create_subscription(kind, name, self.heard.setdefault(name, []).append, 10)

    def next(self, topic: str) -> Any:
        """A message that comes from now on, and not of a moment before."""
        count = len(self.heard[topic])
        self.listener.wait(lambda: len(self.heard[topic]) > count)
        return self.heard[topic][-1]

    def seconds(self) -> float:
        """The simulated time."""
        clock = self.next("clock").clock
        return float(clock.sec + 1e-9 * clock.nanosec)

    def settled(self) -> float:
        """The simulated time, once no other comes."""
        before = -1
        while len(self.heard["clock"]) != before:
            before = len(self.heard["clock"])
            for _ in range(5):
                self.listener.spin_once()
        clock = self.heard["clock"][-1].clock
        return float(clock.sec + 1e-9 * clock.nanosec)


@pytest.fixture
def stage(node: Node, listener: Listener) -> Stage:
    made = Stage(node, listener)
    made.hear(clock=Clock, odom=Odometry)
    return made


def test_a_robot_drives_sees_and_measures(
    stage: Stage, start: Callable[..., subprocess.Popen[str]]
) -> None:
    stage.hear(
        camera__image_raw=Image, camera__depth__image_raw=Image, camera__segmentation=Image,
        chase__segmentation=Image, camera__camera_info=CameraInfo, points=PointCloud2,
        scan=LaserScan, joint_states=JointState, imu=Imu, sensors__orientation=Float64MultiArray,
    )  # fmt: skip
    start("simulate", OWN_CLOCK, **START)
    first = stage.next("odom")
    assert (first.header.frame_id, first.child_frame_id) == ("odom", "base_link")
    assert abs(first.pose.pose.position.z) < 0.05
    velocity = stage.node.create_publisher(Twist, "cmd_vel", 10)
    twist = Twist()
    twist.linear.x = 0.3

    def drives() -> bool:
        velocity.publish(twist)
        odom = stage.next("odom")
        return bool(abs(odom.twist.twist.linear.x - 0.3) < 0.05)

    stage.listener.wait(drives)
    at = stage.next("odom").pose.pose.position.x
    assert at > first.pose.pose.position.x
    # Without a command it stops, after half a simulated second.
    stage.listener.wait(lambda: abs(stage.next("odom").twist.twist.linear.x) < 0.01)

    info = stage.next("camera/camera_info")
    assert (info.width, info.height, info.header.frame_id) == (640, 360, "camera_optical")
    assert info.k[2] == pytest.approx(319.5)
    picture = from_image(stage.next("camera/image_raw"))
    assert picture.shape == (360, 640, 3)
    assert picture.std() > 5  # there is something to see
    depth = stage.next("camera/depth/image_raw")
    assert depth.encoding == "32FC1"
    metres = np.frombuffer(depth.data, np.float32).reshape(360, 640)
    assert np.isfinite(metres).mean() > 0.8
    bodies = stage.next("chase/segmentation")
    assert bodies.encoding == "16UC1"
    assert set(np.unique(np.frombuffer(bodies.data, np.uint16))) >= {0, 1}

    scan = stage.next("scan")
    ranges = np.array(scan.ranges)
    assert scan.header.frame_id == "lidar"
    assert len(ranges) == 1024
    assert scan.angle_min == pytest.approx(-np.pi, abs=0.01)
    points = points_of(stage.next("points"))
    assert set(points.dtype.names or ()) == {"x", "y", "z", "intensity", "ring", "time"}
    assert 1000 < len(points) <= 16 * 1024
    assert points["ring"].max() == 15
    assert 0.05 < points["time"].max() < 0.1
    assert np.isfinite(points["x"]).all()
    joints = stage.next("joint_states")
    assert joints.name == ["left_wheel", "right_wheel"]
    turn = stage.next("sensors/orientation").data  # w first, as MuJoCo has it
    assert np.linalg.norm(turn) == pytest.approx(1) and abs(turn[0]) > 0.9
    assert stage.next("imu").linear_acceleration.z == pytest.approx(9.81, abs=1)


def test_time_can_stand_still_pass_in_steps_and_begin_anew(
    stage: Stage, start: Callable[..., subprocess.Popen[str]]
) -> None:
    start("simulate", OWN_CLOCK, **START)
    stage.seconds()
    call = stage.listener.call
    assert not call(Trigger, "simulate/step").success  # it isn't paused
    assert call(SetBool, "simulate/pause", data=True).success
    still = stage.settled()
    assert stage.settled() == still
    assert call(Trigger, "simulate/step").success
    assert stage.settled() == pytest.approx(still + 0.01)
    assert call(Trigger, "simulate/reset").message == "begins anew"
    assert call(SetBool, "simulate/pause", data=False).success
    stage.heard["clock"].clear()
    assert stage.seconds() < 1


def test_a_reset_puts_the_robot_into_the_map_as_it_is_now(
    stage: Stage, start: Callable[..., subprocess.Popen[str]]
) -> None:
    stage.hear(camera__image_raw=Image)
    log = Log(start("simulate", OWN_CLOCK, **START))
    before = from_image(stage.next("camera/image_raw"))
    stage.map.replace(ROOMS[::4], expected_slots=len(ROOMS) // 2)
    stage.listener.wait(lambda: log.has("cameras and lidar wait: "))
    stage.map.upsert(range(len(ROOMS) // 4, len(ROOMS) // 2), ROOMS[1::4])
    stage.listener.wait(lambda: (from_image(stage.next("camera/image_raw")) != before).any())
    assert "as it is now" in stage.listener.call(Trigger, "simulate/reset").message
    stage.listener.wait(lambda: sum("mobile stands at" in line for line in log.lines) == 2)
    stage.next("camera/image_raw")
    assert not log.has("Exception")


def test_velocities_may_have_stamps(
    stage: Stage, start: Callable[..., subprocess.Popen[str]]
) -> None:
    start("simulate", OWN_CLOCK, **START, enable_stamped_cmd_vel=True)
    velocity = stage.node.create_publisher(TwistStamped, "cmd_vel", 10)
    twist = TwistStamped()
    twist.twist.linear.x = 0.3

    def drives() -> bool:
        velocity.publish(twist)
        return bool(stage.next("odom").twist.twist.linear.x > 0.2)

    stage.listener.wait(drives)


def test_actuators_have_topics(stage: Stage, start: Callable[..., subprocess.Popen[str]]) -> None:
    stage.hear(joint_states=JointState)
    start("simulate", OWN_CLOCK, robot="arm", **START)
    pan = stage.node.create_publisher(Float64, "actuators/shoulder_pan", 10)

    def turned() -> bool:
        pan.publish(Float64(data=float("nan")))  # is left out
        pan.publish(Float64(data=0.4))
        joints = stage.next("joint_states")
        return bool(abs(joints.position[joints.name.index("shoulder_pan")] - 0.4) < 0.02)

    stage.listener.wait(turned)
    assert not stage.heard["odom"]  # what doesn't drive has none


def test_a_state_that_explodes_is_said_once_and_reset_recovers(
    stage: Stage, start: Callable[..., subprocess.Popen[str]], tmp_path: Path
) -> None:
    wild = tmp_path / "wild.xml"
    wild.write_text(
        '<mujoco><worldbody><body name="b" pos="0 0 1"><joint name="slide" type="slide"/>'
        '<geom size="0.1"/></body></worldbody><actuator><motor name="linear_x" joint="slide" '
        'gear="1e12"/></actuator></mujoco>'
    )
    log = Log(start("simulate", OWN_CLOCK, robot=wild, **START))
    stage.next("odom")
    push = stage.node.create_publisher(Float64, "actuators/linear_x", 10)

    def exploded() -> bool:
        push.publish(Float64(data=1e12))
        stage.listener.spin_once()
        return log.has("the state is not finite after")

    stage.listener.wait(exploded)
    assert not stage.listener.call(SetBool, "simulate/pause", data=False).success
    for odom in stage.heard["odom"]:
        assert np.isfinite(odom.pose.pose.position.x)
    stage.heard["odom"].clear()
    assert stage.listener.call(Trigger, "simulate/reset").success
    stage.next("odom")
    assert sum("not finite" in line for line in log.lines) == 1


def test_without_a_whole_map_the_robot_waits(
    node: Node, listener: Listener, start: Callable[..., subprocess.Popen[str]]
) -> None:
    log = Log(start("simulate", OWN_CLOCK, **START))
    listener.wait(lambda: log.has("the robot waits: ") and log.has("no map has come yet"))
    publisher = MapPublisher(node)
    publisher.replace(ROOMS[:30_000], expected_slots=len(ROOMS))
    listener.wait(lambda: log.has("the robot waits: ") and log.has("the map isn't complete"))
    publisher.upsert(range(30_000, len(ROOMS)), ROOMS[30_000:])
    listener.wait(lambda: log.has("mobile stands at -1.20, -1.20"))


def test_what_is_no_robot_is_named(refusal: Callable[..., str], tmp_path: Path) -> None:
    assert "robot 'walker': expected arm, mobile, quadrotor" in refusal("simulate", robot="walker")
    broken = tmp_path / "broken.xml"
    broken.write_text('<mujoco><asset><mesh name="a" file="away.stl"/></asset></mujoco>')
    line = refusal("simulate", robot=broken)
    assert "broken.xml" in line and "away.stl" in line
    mug = tmp_path / "base_link.ply"
    save(mug, ROOMS[:100])
    line = refusal("simulate", objects=f"['{mug}']")
    assert "object base_link: the robot has a body of this name" in line
    assert "parameter start: expected x, y and yaw" in refusal("simulate", start="[1.0]")


def test_frames_of_bodies_cameras_and_the_map(node: Node) -> None:
    """As TF has them, where tf2_msgs is."""
    floor = Boxes(np.array([[-5.0, -5, -1]]), np.array([[5.0, 5, 0]]))
    robot = RobotModel(robot_file("mobile", ROBOTS), floor, np.eye(4))
    robot.command("linear_x", 0.5)
    robot.step(1.0)
    states = States(node, "odom")
    states.stand(robot, "map", np.eye(4))
    found = {each.child_frame_id: each for each in states.transforms(Time(sec=1))}
    assert set(found) == {"base_link", "left_wheel", "right_wheel"}
    assert found["base_link"].header.frame_id == "odom"
    assert found["base_link"].transform.translation.x == pytest.approx(robot.pose(1)[0, 3])
    assert found["left_wheel"].header.frame_id == "base_link"
    assert found["left_wheel"].transform.translation.y == pytest.approx(0.17)
    fixed = {each.child_frame_id: each for each in states.fixed(robot)}
    assert fixed["camera_optical"].header.frame_id == "base_link"
    turn = fixed["camera_optical"].transform.rotation  # forward is x, right is -y
    np.testing.assert_allclose([turn.x, turn.y, turn.z, turn.w], [-0.5, 0.5, -0.5, 0.5], atol=1e-9)
    assert fixed["lidar"].transform.translation.z == pytest.approx(0.265)


FOREIGN = """
<mujoco><option timestep="0.003"/><worldbody><geom type="plane" pos="0 0 -7" size="0 0 1"/>
  <site name="scan" pos="0 1 0"/>
  <body name="trunk" pos="0 0 1"><freejoint/><geom size="0.1"/>
    <site name="trunk" pos="0 0 0.1" euler="0 0 90"/><site name="map"/>
    <site name="all" size="0.5"/>
    <camera name="y-axis" pos="0 -2 0" xyaxes="1 0 0 0 0 1" mode="trackcom"/><camera/>
    <body name="scan"><joint name="tilt"/><geom size="0.05"/></body>
  </body></worldbody>
  <actuator><motor joint="tilt"/><motor name="hip/tilt" joint="tilt"/></actuator>
  <sensor><rangefinder site="trunk"/><gyro site="map"/><gyro site="trunk"/>
    <accelerometer name="a" site="trunk"/><touch name="on-the-ground" site="all"/></sensor>
</mujoco>"""


def test_a_foreign_robot_has_all_that_its_file_has(node: Node, tmp_path: Path) -> None:
    """Whatever its cameras, actuators, sites and sensors are called, if anything."""
    (tmp_path / "foreign.xml").write_text(FOREIGN)
    floor = Boxes(np.array([[-5.0, -5, -9]]), np.array([[5.0, 5, -8]]))
    robot = RobotModel(tmp_path / "foreign.xml", floor, np.eye(4))
    assert robot.cameras == {"y_axis": 0, "camera_1": 1}
    assert robot.actuators == {"actuator_0": 0, "hip_tilt": 1}
    assert robot.travels
    down = robot.cast(np.array([3.0, 0, 0]), np.array([[0.0, 0, -1]]), 0)
    assert np.isinf(down)  # its ground is run into, and not seen: that is the map's part
    for _ in range(100):
        robot.step(0.01)
    assert robot.time == pytest.approx(1, abs=0.003)  # which 0.01 is no multiple of
    site, rotation, turn, _ = robot.imu() or pytest.fail("no IMU")
    assert (site, len(turn)) == ("trunk", 3)
    np.testing.assert_allclose(rotation, [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-6)
    assert list(robot.sensors) == ["sensor_0", "sensor_1", "sensor_2", "a", "on_the_ground"]
    assert robot.measured(robot.sensors["on_the_ground"]) == 0
    robot.step(3.0)
    assert robot.measured(robot.sensors["on_the_ground"]) > 0  # it has fallen on it

    states = States(node, "odom")
    states.stand(robot, "map", np.eye(4))
    moving = {each.child_frame_id: each for each in states.transforms(Time(sec=1))}
    fixed = {each.child_frame_id: each for each in states.fixed(robot)}
    assert set(moving) == {"trunk", "scan", "y_axis_optical"}  # that one turns with no body
    assert set(fixed) == {"camera_1_optical", "trunk_site", "map_site", "scan_site", "all"}
    assert fixed["trunk_site"].header.frame_id == "trunk"
    assert fixed["scan_site"].header.frame_id == "odom"


def test_markers_are_what_cameras_see_of_the_robot(tmp_path: Path) -> None:
    messages = pytest.importorskip("visualization_msgs.msg", reason="no visualization_msgs here")
    from rosplat_tools.simulation.markers import markers_of

    floor = Boxes(np.array([[-5.0, -5, -1]]), np.array([[5.0, 5, 0]]))
    mobile = RobotModel(robot_file("mobile", ROBOTS), floor, np.eye(4))
    mobile.step(0.5)
    first, *shapes = markers_of(mobile, {1: "base_link", 2: "left_wheel", 3: "right_wheel"}).markers
    assert first.action == messages.Marker.DELETEALL
    assert len(shapes) == 9  # the map isn't among them
    assert len({shape.id for shape in shapes}) == 9
    (wheel,) = (shape for shape in shapes if shape.header.frame_id == "left_wheel")
    assert wheel.type == messages.Marker.CYLINDER
    np.testing.assert_allclose([wheel.scale.x, wheel.scale.y, wheel.scale.z], [0.12, 0.12, 0.03])
    np.testing.assert_allclose([wheel.pose.position.x, wheel.pose.position.z], 0, atol=1e-9)
    assert abs(wheel.pose.orientation.x) == pytest.approx(np.sqrt(0.5))
    assert wheel.frame_locked

    (tmp_path / "mesh.xml").write_text(
        '<mujoco><asset><mesh name="a" builtin="sphere" params="1"/></asset><worldbody>'
        '<body name="b" pos="0 0 2"><geom type="mesh" mesh="a" rgba="1 0 0 1"/>'
        '<geom type="capsule" size="0.1 0.2" rgba="0 1 0 1"/></body></worldbody></mujoco>'
    )
    robot = RobotModel(tmp_path / "mesh.xml", floor, np.eye(4))
    _, mesh, tube, *caps = markers_of(robot, {1: "b"}).markers
    assert mesh.type == messages.Marker.TRIANGLE_LIST
    corners = np.array([(point.x, point.y, point.z) for point in mesh.points])
    assert len(corners) == 3 * 80
    np.testing.assert_allclose(np.linalg.norm(corners, axis=1), 1, atol=0.02)
    assert (mesh.color.r, tube.color.g) == (1.0, 1.0)
    assert sorted(cap.pose.position.z for cap in caps) == pytest.approx([-0.2, 0.2])


def test_markers_come_again_for_who_is_new_and_after_a_reset(
    node: Node, listener: Listener
) -> None:
    """rviz2 hears of them before TF, and forgets them when time goes back."""
    messages = pytest.importorskip("visualization_msgs.msg", reason="no visualization_msgs here")
    pytest.importorskip("tf2_msgs.msg", reason="no tf2_msgs here")
    floor = Boxes(np.array([[-5.0, -5, -1]]), np.array([[5.0, 5, 0]]))
    robot = RobotModel(robot_file("mobile", ROBOTS), floor, np.eye(4))
    states, heard = States(node, "odom"), list[Any]()
    states.stand(robot, "map", np.eye(4))
    node.create_subscription(messages.MarkerArray, "robot_markers", heard.append, LATCHED)

    def published(count: int) -> bool:
        for _ in range(AGAIN[0]):
            states.publish(Time(sec=1))
        listener.spin_once()
        return len(heard) >= count

    listener.wait(lambda: published(2))
    states.begin_anew()
    again = len(heard)
    listener.wait(lambda: published(again + len(AGAIN)))
    assert len(heard[-1].markers) == 10
    assert not published(again + len(AGAIN) + 1)


def test_an_object_falls_in_a_map_of_its_own(
    stage: Stage, start: Callable[..., subprocess.Popen[str]], tmp_path: Path
) -> None:
    near = (np.abs(ROOMS.positions[:, :2] - (-1.2, -1.2)) < 0.3).all(axis=1)
    slab = ROOMS[near & (ROOMS.positions[:, 2] < 0.05)]
    save(tmp_path / "slab.ply", replace(slab, origin=np.array([0.4, 0.0, 0.5])))
    stage.hear(objects=GaussianArray)
    start("simulate", OWN_CLOCK, **START, objects=f"['{tmp_path}/slab.ply']")

    def has_fallen() -> bool:
        moves = [m for m in stage.heard["objects"] if m.operation == GaussianArray.MOVE]
        return bool(moves) and moves[-1].poses[0].position.z < -0.3

    stage.listener.wait(has_fallen)
    splats = sum(m.count for m in stage.heard["objects"])
    assert splats == len(slab)
