"""The README's code is what it says: it runs, block after block, as a newcomer would paste it."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from ament_index_python.packages import get_packages_with_prefixes
from rclpy.node import Node

from rosplat_core import generate, load, save
from rosplat_msgs.msg import GaussianArray
from rosplat_msgs.srv import PullMap, RepeatMap
from rosplat_testing import PATIENCE, Listener

README = Path(__file__).resolve().parents[1] / "README.md"

WITHOUT_ROS = "import rosplat_core"

# What its text leaves to the reader.
OF_THE_READER = """
import numpy as np
ids = slots = labels = confidences = np.arange(1000)
pose = np.eye(4)
corrected = {submap: pose for submap in (1, 2, 3)}
"""
SAYS = """
slots, splats = publisher.snapshot()
print(len(publisher), slots[-1], *splats.channels)
"""


CMAKE = """
cmake_minimum_required(VERSION 3.16)
project(slam LANGUAGES CXX)
find_package(rosplat_tools REQUIRED)
add_executable(slam slam.cpp)
target_link_libraries(slam rosplat_tools::map_publisher)
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


def blocks_of(language: str) -> list[str]:
    text = README.read_text(encoding="utf-8")
    return re.findall(rf"```{language}\n(.*?)```", text, re.DOTALL)


def test_its_python_runs() -> None:
    blocks = [block for block in blocks_of("python") if WITHOUT_ROS not in block]
    assert "rclpy.spin(node)" in blocks[0]
    script = OF_THE_READER + "\n".join(blocks).replace("rclpy.spin(node)", "pass") + SAYS
    run = subprocess.run(
        [sys.executable, "-c", script],
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        check=False,
    )
    assert run.stderr == ""
    assert run.stdout == "2000 4071 label confidence\n"


def test_its_python_without_ros_runs(tmp_path: Path) -> None:
    (block,) = (block for block in blocks_of("python") if WITHOUT_ROS in block)
    save(tmp_path / "scene.ply", generate(5000, seed=1))
    says = "print(picture.shape, picture.dtype, len(order) > 0)"
    run = subprocess.run(
        [sys.executable, "-c", block + says],
        capture_output=True, text=True, timeout=120, check=False, cwd=tmp_path,
    )  # fmt: skip
    assert run.stderr == ""
    assert run.stdout == "(720, 1280, 4) float32 True\n"
    assert 0 < len(load(tmp_path / "smaller.ply")) < 5000


@pytest.mark.parametrize("library", ["rclcpp", "rclcpp_lifecycle"])
def test_its_cpp_publishes_a_map(
    library: str, tmp_path: Path, node: Node, listener: Listener
) -> None:
    if library not in get_packages_with_prefixes():
        pytest.skip(f"no {library} here")
    (source,), cmake = blocks_of("cpp"), CMAKE
    assert CMAKE.splitlines()[-1] in " ".join(README.read_text(encoding="utf-8").split())
    if library == "rclcpp_lifecycle":
        cmake += CMAKE_OF_LIFECYCLE
        for plain, other in LIFECYCLE.items():
            assert plain in source
            source = source.replace(plain, other, 1)
    (tmp_path / "slam.cpp").write_text(source)
    (tmp_path / "CMakeLists.txt").write_text(cmake)
    for command in (["cmake", "-S", ".", "-B", "."], ["cmake", "--build", "."]):
        subprocess.run(command, cwd=tmp_path, check=True, capture_output=True)
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
