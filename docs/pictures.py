"""Makes the pictures of the documentation: `make pictures`, where rviz2 is."""

from __future__ import annotations

import argparse
import math
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import rclpy
from ament_index_python.packages import get_package_share_directory
from geometry_msgs.msg import TransformStamped, Twist
from PIL import Image, ImageGrab
from rclpy.node import Node
from std_srvs.srv import SetBool, Trigger
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import Marker, MarkerArray

from rosplat_core import find_up, load, save
from rosplat_lab.driven_rviz import DrivenRviz
from rosplat_ros.program.processes import Processes, quoted
from rosplat_ros.qos import LATCHED
from rosplat_tools import SplatCamera
from rosplat_tools.simulation.robot_model import put_in_map
from rviz_gaussian_plugin.offscreen import ensure_display

DOCS = Path(__file__).parent
SIZE = (1400, 900)

OCCLUSION_CONFIG = """\
Panels:
  - Class: rviz_common/Displays
    Name: Displays
    Property Tree Widget:
      Expanded: [/Gaussian Map1]
      Splitter Ratio: 0.36
    Tree Height: 700
Visualization Manager:
  Displays:
    - {Class: rviz_default_plugins/Grid, Name: Grid, Enabled: true, Value: true, Cell Size: 0.5,
       Plane Cell Count: 10, Alpha: 0.6}
    - {Class: rviz_default_plugins/TF, Name: TF, Enabled: true, Value: true, Marker Scale: 1.5}
    - {Class: rviz_default_plugins/MarkerArray, Name: MarkerArray, Enabled: true, Value: true,
       Topic: {Value: /markers, Durability Policy: Transient Local, Depth: 5}}
    - {Class: rviz_gaussian_plugin/GaussianMap, Name: Gaussian Map, Enabled: true, Value: true,
       Topic: /gaussians}
  Global Options: {Fixed Frame: map, Background Color: 32; 34; 38, Frame Rate: 30}
  Views:
    Current: {Class: rviz_default_plugins/Orbit, Name: Current View, Distance: 3.2, Yaw: 0.75,
      Pitch: 0.3, Focal Point: {X: 0, Y: 0, Z: 0.4}, Near Clip Distance: 0.01}
Window Geometry: {Width: 1400, Height: 900}
"""


SELECTION_CONFIG = """\
Panels:
  - Class: rviz_common/Selection
    Name: Selection
Visualization Manager:
  Displays:
    - {Class: rviz_default_plugins/Grid, Name: Grid, Enabled: true, Value: true, Cell Size: 1,
       Plane Cell Count: 10, Alpha: 0.4}
    - {Class: rviz_gaussian_plugin/GaussianMap, Name: Gaussian Map, Enabled: true, Value: true,
       Topic: /gaussians}
  Global Options: {Fixed Frame: map, Background Color: 32; 34; 38, Frame Rate: 30}
  Tools:
    - {Class: rviz_default_plugins/Select}
  Views:
    Current: {Class: rviz_default_plugins/Orbit, Name: Current View, Distance: 4.2, Yaw: 0.8,
      Pitch: 0.35, Focal Point: {X: 0, Y: 0, Z: 0.9}, Near Clip Distance: 0.01}
Window Geometry: {Width: 1400, Height: 900}
"""


CHANNELS_CONFIG = """\
Panels:
  - Class: rviz_common/Displays
    Name: Displays
    Property Tree Widget:
      Expanded: [/Gaussian Map1, /Gaussian Map1/Draw Mode1]
      Splitter Ratio: 0.5
    Tree Height: 540
Visualization Manager:
  Displays:
    - {Class: rviz_gaussian_plugin/GaussianMap, Name: Gaussian Map, Enabled: true, Value: true,
       Topic: /gaussians, Draw Mode: {Value: Channel, Channel: keyframe}}
  Global Options: {Fixed Frame: map, Background Color: 32; 34; 38, Frame Rate: 30}
  Views:
    Current: {Class: rviz_default_plugins/Orbit, Name: Current View, Distance: 4.4, Yaw: 0.8,
      Pitch: 0.5, Focal Point: {X: 0, Y: 0, Z: 0.5}, Near Clip Distance: 0.01}
Window Geometry: {Width: 1400, Height: 640}
"""


def shoot(name: str, rviz: DrivenRviz, crop: tuple[int, int, int, int] | None = None) -> None:
    """A picture of the screen into docs/, small enough for a README.

    SystemExit where a display in it isn't Ok.
    """
    rviz.processes.check()
    picture = ImageGrab.grab(xdisplay=os.environ["DISPLAY"]).convert("RGB")
    if complaints := rviz.complaints():
        raise SystemExit("\n".join([f"no {name}: rviz2 isn't well", *complaints]))
    picture.crop(crop or (0, 0, *SIZE)).save(DOCS / name, quality=82, optimize=True)
    print(f"wrote {DOCS / name}, {(DOCS / name).stat().st_size >> 10} KiB")


def shipped_configuration(folder: Path, seconds: float) -> None:
    """The demo: the procedural garden and the sensors that circle it."""
    share = Path(get_package_share_directory("rviz_gaussian_plugin"))
    with Processes(folder) as processes:
        processes.node(
            "rosplat_tools", "ply_publisher", "--ros-args", "-p", "path:=procedural:200000"
        )
        processes.node("rosplat_sorter", "sorter")
        processes.node("rosplat_tools", "demo_sensors")
        rviz = DrivenRviz(processes, (share / "config/sensors.rviz").read_text())
        time.sleep(seconds)
        shoot("rviz.jpg", rviz)


def occlusion(folder: Path, scene: Path, seconds: float) -> None:
    """A scene in a frame of its own; an opaque and a translucent cube in it; who sorted it."""
    rclpy.init()
    node = Node("pictures")
    transform = TransformStamped()
    transform.header.frame_id, transform.child_frame_id = "map", "scene"
    transform.transform.rotation.x = -math.sqrt(0.5)  # the scene's y points down
    transform.transform.rotation.w = math.sqrt(0.5)
    tf = node.create_publisher(TFMessage, "/tf_static", LATCHED)
    tf.publish(TFMessage(transforms=[transform]))
    cubes = MarkerArray()
    for position, size, alpha in (((0.1, -0.1, 0.42), 0.42, 1.0), ((0.75, 0.45, 0.3), 0.5, 0.4)):
        cube = Marker(type=Marker.CUBE, id=len(cubes.markers))
        cube.header.frame_id = "map"
        cube.pose.position.x, cube.pose.position.y, cube.pose.position.z = position
        cube.pose.orientation.w = 1.0
        cube.scale.x = cube.scale.y = cube.scale.z = size
        cube.color.r, cube.color.g, cube.color.b, cube.color.a = 0.2, 0.75, 0.9, alpha
        cubes.markers.append(cube)
    markers = node.create_publisher(MarkerArray, "/markers", LATCHED)
    markers.publish(cubes)
    with Processes(folder) as processes:
        processes.node(
            "rosplat_tools", "ply_publisher", "--ros-args",
            "-p", f"path:={quoted(scene)}", "-p", "frame_id:=scene",
        )  # fmt: skip
        rviz = DrivenRviz(processes, OCCLUSION_CONFIG)
        time.sleep(seconds)
        # Widen the panel and unfold the display's Status: rviz doesn't remember that.
        for step in ("mousemove 342 600", "mousedown 1", "mousemove 400 600", "mousemove 460 600",
                     "mouseup 1", "mousemove 31 208 click 1"):  # fmt: skip
            subprocess.run(["xdotool", *step.split()], check=True)
            time.sleep(seconds / 20)  # as long as frames take in software
        time.sleep(seconds / 2)
        shoot("occlusion.jpg", rviz)
    node.destroy_node()
    rclpy.shutdown()


def selection(folder: Path, seconds: float) -> None:
    """Splats that a box of the Select tool has selected, one of them unfolded in the panel."""
    with Processes(folder) as processes:
        processes.node(
            "rosplat_tools", "ply_publisher", "--ros-args", "-p", "path:=procedural:6000"
        )
        rviz = DrivenRviz(processes, SELECTION_CONFIG)
        time.sleep(seconds)
        drag = ["mousemove", "820", "330", "mousedown", "1", "mousemove", "840", "350"]
        subprocess.run(["xdotool", *drag, "mousemove", "860", "370", "mouseup", "1"], check=True)
        time.sleep(seconds / 4)
        subprocess.run(["xdotool", "mousemove", "12", "92", "click", "1"], check=True)
        time.sleep(seconds / 4)
        shoot("selection.jpg", rviz)


def channels(folder: Path, seconds: float) -> None:
    """A map in the colours of the keyframes that its splats came with, as SLAM sends them."""
    with Processes(folder) as processes:
        processes.node(
            "rosplat_tools", "slam_emulator", "--ros-args", "-p", "path:=procedural:60000",
            "-p", "batch_size:=3000", "-p", "prune_fraction:=0.0",
        )  # fmt: skip
        rviz = DrivenRviz(processes, CHANNELS_CONFIG)
        time.sleep(seconds)
        shoot("channels.jpg", rviz, (0, 0, 1400, 640))


def embedded_viewer(folder: Path, scene: Path) -> None:
    """The picture of `make demo` without a display."""
    with Processes(folder) as processes:
        demo = processes.start(
            "host",
            [sys.executable, "-m", "rviz_gaussian_plugin.demo", str(scene), "--up", "0", "1", "0",
             "--host", "--out", str(folder)],
            DISPLAY="",
        )  # fmt: skip
        if demo.wait() != 0:
            raise SystemExit(processes.said("host"))
    Image.open(folder / "demo.png").convert("RGB").save(DOCS / "demo.jpg", quality=85)
    print(f"wrote {DOCS / 'demo.jpg'}")


def camera(folder: Path, seconds: float) -> None:
    """What camera.launch.py starts: the camera films rooms that aren't furnished as the map's."""
    share = Path(get_package_share_directory("rviz_gaussian_plugin"))
    filmed = ("--ros-args", "-r", "gaussians:=filmed/gaussians")
    taken = [f"{name}:=filmed/{name}" for name in ("image_raw", "camera_info")]
    with Processes(folder) as processes:
        processes.node("rosplat_tools", "ply_publisher", "--ros-args", "-p", "path:=rooms:100000:1")
        processes.node(
            "rosplat_tools", "ply_publisher", *filmed, "-p", "path:=rooms:100000:2", name="filmed"
        )
        processes.node("rosplat_tools", "demo_sensors")
        processes.node("rosplat_tools", "occupancy")
        processes.node(
            "rosplat_tools", "camera", *filmed, "-p", "cameras:=[filmed]",
            "-p", "filmed.frame_id:=demo_camera_optical",
        )  # fmt: skip
        processes.node(
            "rosplat_tools", "compare", "--ros-args", "-r", taken[0], "-r", taken[1],
            "-p", "attribute:=true",
        )  # fmt: skip
        rviz = DrivenRviz(processes, (share / "config/camera.rviz").read_text())
        for name, value in (("Distance", 18), ("Pitch", 1.1), ("Yaw", 0.5)):
            rviz.set(name, value=value, root="view")
        time.sleep(seconds)
        shoot("camera.jpg", rviz)


def simulation(scene: Path) -> None:
    """The robot mobile drives through a scene: as its camera chase sees it, and what its own camera
    sees."""
    splats = load(scene)
    file = Path(get_package_share_directory("rosplat_tools")) / "robots/mobile.xml"
    stands = put_in_map(file, splats, find_up(splats), (-0.65, -0.47, 0.22))
    robot = stands.robot
    robot.step(0.5)  # onto its wheels
    eye = SplatCamera(robot.model, robot.data, splats, map_pose=stands.map_pose)
    robot.command("linear_x", 0.2)
    robot.command("angular_z", 0.25)
    period, film = 1 / 6, []
    for _ in range(34):
        robot.step(period)
        sheet = Image.new("RGB", (720, 270))
        colours, depths = eye.render("camera")
        near = (255 * np.exp(-depths / 1.5)).astype(np.uint8)
        sheet.paste(Image.fromarray(eye.render("chase")[0]).resize((480, 270)), (0, 0))
        for row, part in enumerate((colours, near)):
            small = Image.fromarray(part).resize((240, 135)).convert("RGB")
            sheet.paste(small, (480, 135 * row))
        film.append(sheet)
    show(film, "simulate.webp", period, quality=28)


def push(folder: Path, scene: Path, seconds: float) -> None:
    """A film of rviz2: the figure that hovers in playbot falls, and mobile drives into it."""
    whole = load(scene)
    figure = whole.positions[:, 1] + whole.origin[1] < -0.2  # y is down
    save(folder / "rest.ply", whole[~figure], overwrite=True)
    save(folder / "figure.ply", whole[figure], overwrite=True)
    share = Path(get_package_share_directory("rviz_gaussian_plugin"))
    before, name, after = (share / "config/simulate.rviz").read_text().partition("Name: Objects\n")
    rclpy.init()
    node = Node("pictures")
    velocities = node.create_publisher(Twist, "cmd_vel", 10)

    def call(kind: type, service: str, **request: object) -> None:
        client = node.create_client(kind, f"simulate/{service}")
        client.wait_for_service()
        rclpy.spin_until_future_complete(node, client.call_async(kind.Request(**request)))

    period, film = 1 / 6, []
    forward = Twist()
    forward.linear.x = 0.3
    with Processes(folder) as processes:
        processes.node(
            "rosplat_tools", "simulate", "--ros-args", "-p", "start:=[-0.65,-0.47,0.6]",
            "-p", f"objects:=[{quoted(folder / 'figure.ply')}]",
        )  # fmt: skip
        call(SetBool, "pause", data=True)
        processes.node(
            "rosplat_tools", "ply_publisher", "--ros-args", "-p", "frame_id:=scene",
            "-p", "upright_frame:=map", "-p", f"path:={quoted(folder / 'rest.ply')}",
        )  # fmt: skip
        config = before + name + after.replace("false", "true", 2)  # as with a click
        rviz = DrivenRviz(processes, config, "--ros-args", "-p", "use_sim_time:=true")
        time.sleep(seconds)
        for axis, value in (("X", 0.1), ("Y", 0.1), ("Z", 0.25)):
            rviz.set("Focal Point", axis, value=value, root="view")
        rviz.set("Distance", value=2.9, root="view")
        for _ in range(10):  # so that TF has the robot
            call(Trigger, "step")
        time.sleep(seconds / 4)
        call(SetBool, "pause", data=False)
        began = time.monotonic()
        for number in range(40):
            time.sleep(max(0, began + number * period - time.monotonic()))
            if number > 8:
                velocities.publish(forward)
            picture = ImageGrab.grab(xdisplay=os.environ["DISPLAY"]).convert("RGB")
            film.append(picture.resize((840, 540)))
        processes.check()
    node.destroy_node()
    rclpy.shutdown()
    show(film, "push.webp", period, quality=45)


def show(film: list[Image.Image], name: str, period: float, quality: int) -> None:
    """A film into docs/. period: between two pictures [s]. quality: 0 to 100."""
    film[0].save(
        DOCS / name, save_all=True, append_images=film[1:], loop=0, quality=quality,
        duration=round(1e3 * period), method=6, minimize_size=True,
    )  # fmt: skip
    print(f"wrote {DOCS / name}, {(DOCS / name).stat().st_size >> 10} KiB")


PICTURES = ("simulate", "push", "demo", "occlusion", "selection", "channels", "camera", "rviz")


def main() -> None:
    """Makes all of them, or some."""
    parser = argparse.ArgumentParser(prog="make pictures", description=__doc__)
    parser.add_argument("scene", type=Path, help="trained scene with y down: playbot here")
    parser.add_argument("upright", type=Path, help="trained scene with y up: wolf.spz here")
    parser.add_argument("--only", nargs="+", choices=PICTURES, default=PICTURES, metavar="PICTURE")
    parser.add_argument("--seconds", type=float, default=60, help="for rviz2 to come to rest")
    options = parser.parse_args()
    folder = Path("out/pictures")
    folder.mkdir(parents=True, exist_ok=True)
    if "demo" in options.only:
        embedded_viewer(folder, options.upright)
    if "simulate" in options.only:
        simulation(options.scene)
    os.environ.pop("DISPLAY", None)
    with ensure_display(*SIZE):
        if "push" in options.only:
            push(folder, options.scene, options.seconds)
        if "occlusion" in options.only:
            occlusion(folder, options.scene, options.seconds)
        if "selection" in options.only:
            selection(folder, options.seconds)
        if "channels" in options.only:
            channels(folder, options.seconds)
        if "camera" in options.only:
            camera(folder, options.seconds)
        if "rviz" in options.only:
            shipped_configuration(folder, options.seconds)


if __name__ == "__main__":
    main()
