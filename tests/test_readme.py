"""What the README and the guides show runs as it stands there, block after block."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from threading import Timer

import pytest
import rclpy
from ament_index_python.packages import (
    get_package_prefix,
    get_package_share_directory,
    get_packages_with_prefixes,
)
from rclpy.node import Node

from rosplat_core import Camera, generate, load, look_at, save
from rosplat_lab.driven_rviz import is_here
from rosplat_msgs.msg import GaussianArray, SplatOrder, ViewCamera
from rosplat_msgs.srv import PullMap, RepeatMap
from rosplat_ros import MapPublisher, qos
from rosplat_ros.view_cameras import view_camera
from rosplat_testing import PATIENCE, Listener

ROOT = Path(__file__).resolve().parents[1]
README = ROOT / "README.md"
GUIDES = ROOT / "docs" / "guides"
PAGES = [README, ROOT / "docs" / "reference.md", *sorted(GUIDES.glob("*.md"))]

WITHOUT_ROS = "import rosplat_core"
SCENE = "/path/to/scene.ply"

# `ros2` where ROS 2 comes from PyPI, which lacks it.
ROS2 = f"""#!{sys.executable}
import os, sys
from ament_index_python.packages import get_package_prefix, get_package_share_directory
match sys.argv[1:]:
    case ["run", package, program, *rest]:
        path = f"{{get_package_prefix(package)}}/lib/{{package}}/{{program}}"
        os.execv(path, [path, *rest])
    case ["pkg", "prefix", "--share", package]:
        print(get_package_share_directory(package))
    case unknown:
        sys.exit(f"not in this stand-in for ros2: {{unknown}}")
"""

# What its text leaves to the reader.
OF_THE_READER = """
import numpy as np
ids = slots = labels = confidences = np.arange(1000)
pose = np.eye(4)
corrected = {submap: pose for submap in (1, 2, 3)}
from rosplat_core import Camera
camera = Camera(0, 64, 48, 50, 50, 32, 24, pose)
"""
SAYS = """
slots, splats = publisher.snapshot()
print(len(publisher), slots[-1], *splats.channels)
"""


CMAKE = """
cmake_minimum_required(VERSION 3.16)
project({name} LANGUAGES CXX)
find_package(rosplat_ros REQUIRED)
add_executable({name} {name}.cpp)
target_link_libraries({name} rosplat_ros::{library})
"""

# A lifecycle node in place of the plain one.
LIFECYCLE = {
    "rclcpp::Node": "rclcpp_lifecycle::LifecycleNode",
    "spin(node)": "spin(node->get_node_base_interface())",
    "#include <": "#include <rclcpp_lifecycle/lifecycle_node.hpp>\n#include <",
}
CMAKE_OF_LIFECYCLE = """
find_package(rclcpp_lifecycle REQUIRED)
target_link_libraries(slam rclcpp_lifecycle::rclcpp_lifecycle)
"""


def blocks_of(page: Path, language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)


def test_the_readme_is_short() -> None:
    assert len(README.read_text(encoding="utf-8").split()) <= 900


def test_python_publishes_a_map() -> None:
    blocks = [block for block in blocks_of(README, "python") if WITHOUT_ROS not in block]
    assert "\nspin(node)" in blocks[0]
    blocks += blocks_of(GUIDES / "publish.md", "python")
    script = OF_THE_READER + "\n".join(blocks).replace("\nspin(node)", "\npass") + SAYS
    run = subprocess.run(
        [sys.executable, "-c", script],
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        check=False,
    )
    assert run.stderr == ""
    assert run.stdout == "2000 2023 label confidence\n"


@pytest.mark.parametrize("page", [README, GUIDES / "sensor.md"], ids=lambda page: page.stem)
def test_an_example_ends_by_ctrl_c_without_a_traceback(page: Path) -> None:
    block = blocks_of(page, "python")[0]
    spins = re.compile(r"^( *)spin\((.*)\)", re.MULTILINE)
    assert spins.search(block)
    says = r"\1node = \2; node.create_timer(0.1, lambda: print(flush=True)); spin(node)"
    script = spins.sub(says, block)
    with subprocess.Popen(
        [sys.executable, "-c", script], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as run:
        assert run.stdout and run.stdout.readline()
        run.send_signal(signal.SIGINT)
        assert run.communicate(timeout=PATIENCE)[1] == ""


# A room filmed with depths, heard by the guide's node; then it is moved by a loop closure.
FILMED = """
from rosplat_core import CpuRenderer, generate
from rosplat_core.rendering import posed, psnr_of
from rosplat_lab.bench.scenes import room
from rosplat_ros.images import to_bytes, to_image
from rosplat_ros.poses import to_pose

rclpy.init()
mapper, film = Mapper(), rclpy.create_node("film")
scene = generate(60_000, scene="rooms")
renderer, cameras = CpuRenderer(scene), room(scene, 160, 120, 60)[::5]
publishers = {name: film.create_publisher(kind, name, 30) for name, kind in TOPICS.items()}
executor = rclpy.executors.SingleThreadedExecutor()
executor.add_node(mapper), executor.add_node(film)
pictures, added, add = [], [], mapper.add
mapper.add = lambda *frame: (added.append(frame[-1]), add(*frame))
for second, camera in enumerate(cameras, 1):
    drawn = renderer.draw(posed(camera), mean_depth=True)
    pictures.append(np.clip(drawn["colour"][..., :3], 0, 1))
    k = [camera.fx, 0.0, camera.cx - 0.5, 0.0, camera.fy, camera.cy - 0.5, 0.0, 0.0, 1.0]
    messages = (
        to_image(to_bytes(pictures[-1]), "rgb8"),
        CameraInfo(width=160, height=120, k=k),
        to_image(np.ascontiguousarray(drawn["depth"][..., 0]), "32FC1"),
        PoseStamped(pose=to_pose(camera.camera_to_world)),
    )
    while not any(np.allclose(pose, camera.camera_to_world) for pose in added):
        for publisher, message in zip(publishers.values(), messages, strict=True):
            message.header.stamp.sec = second
            publisher.publish(message)
        executor.spin_once(0.1)

def psnr(moved):
    taken = CpuRenderer(mapper.map.snapshot()[1])
    errors = []
    for camera, picture in zip(cameras, pictures, strict=True):
        pose = np.linalg.inv(moved @ camera.camera_to_world)
        drawn = taken.render(dataclasses.replace(camera, world_to_camera=pose))
        shown = drawn[..., 3] > 0.5
        errors.append(np.mean((np.clip(drawn[..., :3], 0, 1) - picture)[shown] ** 2))
        assert shown.mean() > 0.5
    return psnr_of(float(np.mean(errors)))

moved = np.eye(4)
moved[:3, 3] = 1, 2, 3
before = psnr(np.eye(4))
mapper.close_loop([moved @ pose for pose in mapper.keyframes])
print(len(mapper.keyframes), before, psnr(moved))
"""


def test_a_sensor_makes_a_live_map() -> None:
    (block,) = blocks_of(GUIDES / "sensor.md", "python")
    node, main = block.split("if __name__")
    assert "    spin(Mapper())" in main
    assert len(node[node.index("def splats_of") :].splitlines()) <= 61
    run = subprocess.run(
        [sys.executable, "-c", "import dataclasses\n" + node + FILMED],
        capture_output=True, text=True, timeout=PATIENCE, check=False,
    )  # fmt: skip
    assert run.stderr == ""
    keyframes, before, after = (float(value) for value in run.stdout.split())
    assert 1 < keyframes < 12, run.stdout
    assert before > 22 and abs(after - before) < 0.1


def test_python_draws_without_ros(tmp_path: Path) -> None:
    blocks = [block for block in blocks_of(README, "python") if WITHOUT_ROS in block]
    blocks += blocks_of(GUIDES / "draw-without-ros.md", "python")
    save(tmp_path / "scene.ply", generate(5000, seed=1))
    says = "print(picture.shape, picture.dtype, len(order) > 0, len(pictures))"
    run = subprocess.run(
        [sys.executable, "-c", "\n".join([*blocks, says])],
        capture_output=True, text=True, timeout=PATIENCE, check=False, cwd=tmp_path,
    )  # fmt: skip
    assert run.stderr == ""
    assert run.stdout == "(720, 1280, 4) float32 True 8\n"
    assert 0 < len(load(tmp_path / "smaller.ply")) < 5000
    assert len(load(tmp_path / "scene.spz")) == 5000


def test_a_body_and_a_map_in_one_picture(tmp_path: Path) -> None:
    pytest.importorskip("mujoco", reason="no mujoco here (PyPI)")
    says = "print(camera.problem, rgb.shape, rgb.dtype, depth.shape, depth.dtype, rgb.max() > 50)"
    one, many = blocks_of(GUIDES / "simulate.md", "python")
    save(tmp_path / "scene.ply", generate(3000))
    script = "\n".join([one.replace(SCENE, str(tmp_path / "scene.ply")), says, many, says])
    run = subprocess.run(
        [sys.executable, "-c", script],
        capture_output=True, text=True, timeout=PATIENCE, check=False,
    )  # fmt: skip
    assert run.stdout == (
        " (360, 640, 3) uint8 (360, 640) float32 True\n"
        " (16, 360, 640, 3) uint8 (16, 360, 640) float32 True\n"
    ), run.stderr


def built(folder: Path, guide: Path, source: str, cmake: str) -> None:
    """Builds a program in C++ as its guide says."""
    linking = next(line for line in cmake.splitlines() if line.startswith("target_link"))
    assert linking in " ".join(guide.read_text(encoding="utf-8").split())
    name = linking.split("(")[1].split()[0]
    (folder / f"{name}.cpp").write_text(source)
    (folder / "CMakeLists.txt").write_text(cmake)
    for command in (["cmake", "-S", ".", "-B", "."], ["cmake", "--build", "."]):
        subprocess.run(command, cwd=folder, check=True, capture_output=True)


@pytest.mark.parametrize("library", ["rclcpp", "rclcpp_lifecycle"])
def test_cpp_publishes_a_map(library: str, tmp_path: Path, node: Node, listener: Listener) -> None:
    if library not in get_packages_with_prefixes():
        pytest.skip(f"no {library} here")
    guide = GUIDES / "publish.md"
    (source,) = blocks_of(guide, "cpp")
    cmake = CMAKE.format(name="slam", library="map_publisher")
    if library == "rclcpp_lifecycle":
        cmake += CMAKE_OF_LIFECYCLE
        for plain, other in LIFECYCLE.items():
            assert plain in source
            source = source.replace(plain, other, 1)
    built(tmp_path, guide, source, cmake)
    arguments = ["--ros-args", "-r", f"__ns:={node.get_namespace()}"]
    with subprocess.Popen([tmp_path / "slam", *arguments]) as slam:
        try:
            listener.wait_for(1997)
            heard = len(listener.batches)
            request = {"map_id": listener.batches[0].map_id}
            answer = listener.call(PullMap, "gaussians/pull", **request)
            assert [batch.operation for batch in answer.batches] == [
                GaussianArray.REPLACE, GaussianArray.UPSERT,
            ]  # fmt: skip
            assert listener.call(RepeatMap, "gaussians/repeat").splats == 1997
            listener.wait(lambda: len(listener.batches) > heard)
            assert listener.batches[-1].operation == GaussianArray.REPLACE
        finally:
            slam.send_signal(signal.SIGINT)
    assert slam.returncode == 0


def test_cpp_receives_a_map(tmp_path: Path, node: Node) -> None:
    """It pulls what was sent before it was there, and hears the rest."""
    if "rclcpp" not in get_packages_with_prefixes():
        pytest.skip("no rclcpp here")
    guide = GUIDES / "receive.md"
    (source,) = blocks_of(guide, "cpp")
    built(tmp_path, guide, source, CMAKE.format(name="robot", library="map_receiver"))
    splats = generate(400)
    with MapPublisher(node, chunk_bytes=2000) as publisher:  # more batches than a newcomer hears
        publisher.replace(splats)
        arguments = ["--ros-args", "-r", f"__ns:={node.get_namespace()}"]
        with subprocess.Popen([tmp_path / "robot", *arguments], stderr=subprocess.PIPE) as robot:
            overdue = Timer(PATIENCE, robot.kill)
            overdue.start()
            assert robot.stderr
            try:
                said = iter(robot.stderr)
                assert any(b" 400 splats" in line for line in said)
                publisher.append(splats)
                assert any(b" 800 splats" in line for line in said)
                publisher.delete([3, 17, 99])
                assert any(b" 797 splats" in line for line in said)
            finally:
                overdue.cancel()
                robot.send_signal(signal.SIGINT)
                robot.communicate()
    assert robot.returncode == 0


# --- The path of a ROS workspace ------------------------------------------------------------------


def block_with(words: str) -> list[str]:
    (block,) = (block for block in blocks_of(README, "bash") if words in block)
    return block.splitlines()


def test_the_workspace_builds_what_it_runs(tmp_path: Path) -> None:
    lines = block_with("colcon build")
    (rosdep,) = (line for line in lines if line.startswith("rosdep"))
    braces = rosdep.split("--from-paths ")[1].split(" --")[0].replace("src/rosplat", str(ROOT))
    expand = ["bash", "-c", f"ls -d {braces}/package.xml 2>&1; basename -a {braces}"]
    folders = subprocess.run(expand, capture_output=True, text=True, check=False).stdout.split()
    (build,) = (line for line in lines if line.startswith("colcon build"))
    listed = build.replace("colcon build", "colcon --log-base /dev/null list --names-only")
    names = subprocess.run(
        [*listed.split(), "--base-paths", ROOT],
        capture_output=True, text=True, check=True, cwd=tmp_path,
    ).stdout.split()  # fmt: skip
    assert {name for name in folders if "/" not in name} == set(names)
    assert set(names) <= get_packages_with_prefixes().keys()


@pytest.fixture
def workspace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Node]:
    """A node in a domain where the README's programs are alone; beside it, their scene."""
    domain = 215 + os.getpid() % 17  # above those that others choose
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
    if not shutil.which("ros2"):
        (tmp_path / "ros2").write_text(ROS2)
        (tmp_path / "ros2").chmod(0o755)
        monkeypatch.setenv("PATH", str(tmp_path), prepend=os.pathsep)
    save(tmp_path / "scene.ply", generate(5000, seed=1))
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=domain)
    node = rclpy.create_node("newcomer", context=context)
    yield node
    node.destroy_node()
    context.try_shutdown()


@pytest.fixture
def run(workspace: Node, tmp_path: Path) -> Iterator[Callable[[str], None]]:
    """Runs the README's line that begins with these words until the test ends."""
    running: list[subprocess.Popen[bytes]] = []

    def run(beginning: str) -> None:
        lines = block_with("ros2 run rosplat_sorter")
        (line,) = (line for line in lines if line.startswith(beginning))
        command = line.replace(SCENE, str(tmp_path / "scene.ply"))
        running.append(subprocess.Popen(["bash", "-c", command], start_new_session=True))

    yield run
    early = [program.args for program in running if program.poll() is not None]
    for program in running:
        with suppress(ProcessLookupError):
            os.killpg(program.pid, signal.SIGINT)
    for program in running:
        program.wait(PATIENCE)
    assert not early


def test_the_workspace_publishes_and_sorts(
    workspace: Node, run: Callable[[str], None], tmp_path: Path
) -> None:
    run("ros2 run rosplat_sorter")
    run("ros2 run rosplat_tools ply_publisher")
    listener = Listener(workspace)
    listener.wait_for(5000)
    orders: list[SplatOrder] = []
    workspace.create_subscription(SplatOrder, "/gaussians/order", orders.append, qos.ORDER)
    views = workspace.create_publisher(ViewCamera, "/gaussians/view", qos.VIEW)
    camera = Camera(0, 640, 480, 400.0, 400.0, 320.0, 240.0, look_at((0, -20, 5), (0, 0, 0)))
    view = view_camera(camera)
    view.header.frame_id, view.view_id = "map", "newcomer"

    def sorted_all() -> bool:
        view.sequence += 1
        views.publish(view)
        return any(order.count > 1000 for order in orders)

    listener.wait(sorted_all)


@pytest.mark.rviz
@pytest.mark.skipif(not is_here(), reason="no rviz2: the README's line is not run")
def test_the_workspace_shows_the_map(
    workspace: Node,
    run: Callable[[str], None],
    display: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("DISPLAY", display)
    run("ros2 run rosplat_tools ply_publisher")
    run("rviz2")
    listener = Listener(workspace)
    views: list[ViewCamera] = []
    workspace.create_subscription(ViewCamera, "/gaussians/view", views.append, qos.VIEW)
    listener.wait_for(5000)
    listener.wait(lambda: views)  # of a display that knows the map
    assert views[-1].width > 100


# --- Commands -------------------------------------------------------------------------------------


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_commands_and_their_parameters_exist(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    for package, program, rest in re.findall(
        r"ros2 run (rosplat_\w+|rviz_\w+) (\w+)([^\n`]*)", text
    ):
        assert (Path(get_package_prefix(package)) / "lib" / package / program).exists(), program
        sources = "".join(path.read_text() for path in (ROOT / package).rglob("*.py"))
        for name in re.findall(r"-p (?:\w+\.)*(\w+):=", rest):
            assert re.search(rf'[".]{name}"', sources), f"{program}: {name}"
    shared = (ROOT / "rosplat_ros/rosplat_ros/program/launching.py").read_text()
    scene = shared.split("\nSCENE = ")[1].split("\n}\n")[0]
    for package, file, rest in re.findall(r"ros2 launch (\w+) (\S+)([^\n`]*)", text):
        launch = (Path(get_package_share_directory(package)) / "launch" / file).read_text()
        launch = launch.replace("**SCENE,", scene)
        for name in re.findall(r"(\w+):=", rest):
            assert f'"{name}"' in launch, f"{file}: {name}"
    makefile = (ROOT / "Makefile").read_text()
    for target, rest in re.findall(r"(?:`|^|&& )make ([a-z]+)([^\n`#]*)", text, re.MULTILINE):
        recipe = makefile.split(f"\n{target}: ## ")[1].split("\n\n")[0]
        for name in re.findall(r"\b([A-Z]+)=", rest):
            assert f"$({name})" in recipe, f"{target}: {name}"
