"""The node that publishes what views of a scene need: its start, what it hears, its end."""

import signal
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rclpy.node import Node
from streamed_scene import APART, LEVELS, edited, write_scene

from rosplat_core.cameras import Camera, look_at
from rosplat_msgs.msg import ViewCamera
from rosplat_ros.qos import VIEW
from rosplat_ros.view_cameras import view_camera
from rosplat_testing import PATIENCE
from rosplat_testing.studio import Studio
from rosplat_tools.streaming.slot_allocator import slots_for

Start = Callable[..., subprocess.Popen[str]]
# For one chunk at its finest, and the others at their coarsest.
ROOM = slots_for(LEVELS[0]) + 3 * slots_for(LEVELS[2])


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_scene(tmp_path_factory.mktemp("scene"))


def before(chunk: int, view_id: str) -> ViewCamera:
    """A view near a chunk."""
    eye = np.array([APART * chunk, -4.0, 1.0])
    camera = Camera(0, 640, 480, 500, 500, 320, 240, look_at(eye, eye + np.array([0, 4, -0.5])))
    view = view_camera(camera)
    view.view_id, view.header.frame_id = view_id, "map"  # as one that wants no order
    return view


def finest(listener: Any) -> list[int]:
    """The chunks that are there at their finest, where all are there."""
    if listener.map is None:
        return []
    splats = listener.map.snapshot()[1]
    counts = np.bincount(np.round(splats.positions[:, 0] / APART).astype(int), minlength=4)
    if not counts.all() or len(splats) > ROOM:
        return []
    return np.flatnonzero(counts == LEVELS[0]).tolist()


def test_what_is_looked_at_is_fine_and_nothing_is_ever_missing(
    start: Start, node: Node, listener: Any, path: Path
) -> None:
    views = node.create_publisher(ViewCamera, "gaussians/view", VIEW)
    process = start("stream_publisher", path=path, max_splats=ROOM, frame_id="scan", error=0.1)
    listener.wait_for(4 * LEVELS[2])  # before anybody looks
    for chunk in (0, 3):
        broken = before(chunk, "broken")
        broken.fx = 0.0

        def seen(chunk: int = chunk, broken: ViewCamera = broken) -> bool:
            views.publish(broken)
            views.publish(before(chunk, "one"))
            return finest(listener) == [chunk]

        listener.wait(seen)
    assert {batch.header.frame_id for batch in listener.batches} == {"scan"}
    process.send_signal(signal.SIGINT)
    output, _ = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0
    assert "Traceback" not in output
    assert "view broken is left out: fx is 0.0" in output
    assert f"of {4 * LEVELS[0]:,} splats, 4 of 4 chunks" in output


def test_a_camera_s_pictures_show_what_is_fine(
    start: Start, node: Node, listener: Any, path: Path
) -> None:
    start("stream_publisher", path=path, max_splats=ROOM, error=0.1)
    start("camera", poses="topic")
    studio = Studio(node, listener)
    studio.hear("image_raw")
    eye = np.array([2 * APART, -4.0, 1.0])
    pose = look_at(eye, eye + np.array([0, 4, -0.5]))

    def seen() -> bool:
        studio.pose(pose)
        return finest(listener) == [2]

    listener.wait(seen)


def test_a_budget_that_lacks_room_for_all_says_so(start: Start, listener: Any, path: Path) -> None:
    process = start("stream_publisher", path=path, max_splats=256)
    listener.wait_for(2 * LEVELS[2])
    process.send_signal(signal.SIGINT)
    output, _ = process.communicate(timeout=PATIENCE)
    assert "max_splats 256 is too few for all of" in output
    assert "take 512 splats at their coarsest" in output


@pytest.mark.parametrize(
    "parameters",
    [{"max_splats": 0}, {"max_splats": 2**25 + 1}, {"error": 0.0}],
)
def test_a_parameter_that_makes_no_sense(
    refusal: Callable[..., str], path: Path, parameters: dict[str, object]
) -> None:
    said = refusal("stream_publisher", path=path, **parameters)
    assert all(name in said for name in parameters)


def test_a_scene_that_is_none_is_one_line_that_names_the_file(start: Start, tmp_path: Path) -> None:
    scene = write_scene(tmp_path)
    process = start("stream_publisher")
    assert process.communicate(timeout=PATIENCE)[0].startswith(
        "stream_publisher: parameter path: expec"
    )
    outputs = []
    for damage in (
        lambda: (tmp_path / "1_0" / "meta.json").unlink(),
        lambda: edited(scene, lodLevels=1, tree={}),
        lambda: scene.unlink(),
    ):
        damage()
        process = start("stream_publisher", path=scene)
        output, _ = process.communicate(timeout=PATIENCE)
        assert process.returncode == 1
        outputs.append(output)
    assert outputs[0].startswith(f"stream_publisher: {tmp_path}/1_0/meta.json: can't read")
    assert outputs[1] == f"stream_publisher: {scene}: holds no splats\n"
    assert outputs[2] == f"stream_publisher: {scene}: No such file or directory\n"
