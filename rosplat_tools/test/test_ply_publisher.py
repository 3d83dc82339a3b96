"""The node that publishes scene files: its start, its services, its end."""

import importlib.util
import lzma
import signal
import subprocess
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rclpy
from rcl_interfaces.srv import DescribeParameters
from rclpy.node import Node

from rosplat_core import formats
from rosplat_core.slot_order import put_in_slot_order
from rosplat_core.splats import InputError, Splats
from rosplat_msgs.srv import LoadScene, PullMap, SaveMap
from rosplat_ros.program.processes import quoted
from rosplat_ros.program.running import spinning
from rosplat_testing import PATIENCE
from rosplat_tools.ply_publisher import THREADS, PlyPublisher

Maker = Callable[..., Splats]
Start = Callable[..., subprocess.Popen[str]]


@pytest.fixture
def ply(tmp_path: Path, random_splats: Maker) -> Path:
    path = tmp_path / "scene.ply"
    labels = {"label": np.arange(5000)}
    formats.save(path, replace(random_splats(5000, 2), channels=labels))
    return path


def in_slot_order(path: Path) -> Splats:
    splats = formats.load(path)
    put_in_slot_order(splats)
    return splats


def test_the_scene_of_the_parameter_is_published_whole(
    start: Start, listener: Any, ply: Path
) -> None:
    start("ply_publisher", path=ply, frame_id="scan")
    listener.wait_for(5000)
    _, splats = listener.map.snapshot()
    scene = in_slot_order(ply)
    np.testing.assert_array_equal(splats.positions, scene.positions)
    upright = np.sign((splats.orientations * scene.orientations).sum(axis=1, keepdims=True))
    np.testing.assert_allclose(splats.orientations * upright, scene.orientations, atol=1e-4)
    np.testing.assert_allclose(splats.scales, scene.scales, rtol=4e-4)
    np.testing.assert_allclose(splats.opacities, scene.opacities, atol=1e-5)
    off = np.abs(splats.sh - scene.sh).max(axis=(1, 2)) / np.abs(scene.sh).max(axis=(1, 2))
    assert off.max() < 1.1e-3
    assert {batch.header.frame_id for batch in listener.batches} == {"scan"}
    assert {batch.expected_slots for batch in listener.batches} == {5000}


def test_a_path_may_begin_with_the_users_folder(
    monkeypatch: pytest.MonkeyPatch, start: Start, listener: Any, ply: Path
) -> None:
    monkeypatch.setenv("HOME", str(ply.parent))
    start("ply_publisher", path=f"~/{ply.name}")
    listener.wait_for(5000)


@pytest.mark.skipif(importlib.util.find_spec("pxr") is None, reason="usd-core is not installed")
def test_the_vertical_of_a_scene_is_that_of_what_is_saved(
    start: Start, listener: Any, random_splats: Maker, tmp_path: Path
) -> None:
    scene, other, saved = (tmp_path / name for name in ("scene.glb", "other.ply", "saved.usda"))
    for path in (scene, other):
        formats.save(path, random_splats(50, 2))
    start("ply_publisher", path=scene, save_root=tmp_path)
    listener.wait(lambda: listener.map)
    ups = []
    for _ in range(2):
        answer = listener.call(SaveMap, "ply_publisher/save", path=str(saved), overwrite=True)
        assert answer.success, answer.message
        ups.append(formats.axes(saved).text[0])
        assert listener.call(LoadScene, "ply_publisher/load", path=str(other)).success
    assert ups == ["y", "z"]  # a .ply has none: z, as ROS has it


def test_scenes_are_loaded_and_saved_while_it_runs(
    start: Start, listener: Any, ply: Path, tmp_path: Path
) -> None:
    start("ply_publisher", save_root=tmp_path)
    answer = listener.call(LoadScene, "ply_publisher/load", path=str(ply))
    assert answer.success
    assert answer.splats == 5000
    assert "5,000 splats" in answer.message
    listener.wait_for(5000)

    copy = tmp_path / "new" / "copy.ply"
    deeper = tmp_path / "no" / "ne" / "copy.ply"
    answer = listener.call(SaveMap, "ply_publisher/save", path=str(deeper))
    assert answer.message == f"{deeper.parent}: No such file or directory"
    answer = listener.call(SaveMap, "ply_publisher/save", path=str(copy))
    assert (answer.success, answer.splats) == (True, 5000)
    saved, scene = formats.load(copy), in_slot_order(ply)
    np.testing.assert_allclose(saved.scales, scene.scales, rtol=4e-4)
    np.testing.assert_array_equal(saved.channels["label"], scene.channels["label"])

    before = copy.read_bytes()
    answer = listener.call(SaveMap, "ply_publisher/save", path=str(copy))
    assert not answer.success
    assert str(copy) in answer.message
    assert copy.read_bytes() == before
    assert listener.call(SaveMap, "ply_publisher/save", path=str(copy), overwrite=True).success


def test_only_folders_that_are_allowed_are_read_and_written(
    start: Start, listener: Any, ply: Path, tmp_path: Path
) -> None:
    allowed = tmp_path / "scenes"
    allowed.mkdir()
    (allowed / "link.ply").symlink_to(ply)
    start("ply_publisher", scene_root=allowed)
    for path in (ply, allowed / ".." / ply.name, allowed / "link.ply", tmp_path / "none.ply"):
        answer = listener.call(LoadScene, "ply_publisher/load", path=str(path))
        assert not answer.success
        assert answer.message.startswith(f"{path}: refused")
        assert "scene_root" in answer.message
    (allowed / "scene.ply").write_bytes(ply.read_bytes())
    path = str(allowed / "scene.ply")
    assert listener.call(LoadScene, "ply_publisher/load", path=path).success
    assert listener.call(LoadScene, "ply_publisher/load", path="procedural:10").success
    copy = allowed / "copy.ply"
    answer = listener.call(SaveMap, "ply_publisher/save", path=str(copy))
    assert not answer.success
    assert "set the parameter save_root" in answer.message
    assert not copy.exists()


def test_a_scene_that_can_t_be_loaded_leaves_the_map_as_it_was(
    start: Start, listener: Any, ply: Path, tmp_path: Path
) -> None:
    start("ply_publisher", path=ply)
    listener.wait_for(5000)
    broken = tmp_path / "broken.ply"
    broken.write_bytes(ply.read_bytes()[:-1000])
    impossible = ("procedural:1000000000000", "procedural:" + "9" * 5000, "procedural:")
    for path in (broken, tmp_path / "none.ply", *impossible):
        answer = listener.call(LoadScene, "ply_publisher/load", path=str(path))
        assert (answer.success, answer.splats) == (False, 5000)
        assert str(path) in answer.message
    assert len(listener.map) == 5000
    assert {batch.revision for batch in listener.batches} == {1}


@pytest.mark.parametrize(
    "parameters",
    [{"path": "/nowhere/scene.ply"}, {"path": "procedural:many"}, {"compression": "7z"}],
)
def test_a_start_that_makes_no_sense_is_one_line_and_code_1(
    refusal: Callable[..., str], parameters: dict[str, object]
) -> None:
    said = refusal("ply_publisher", **parameters)
    assert all(str(value) in said for value in parameters.values())


@pytest.mark.parametrize("path", ["/data/my scene #2/it's.ply", "/data/a: b/c.ply", "2024", "yes"])
def test_a_path_that_yaml_would_take_for_something_else(start: Start, path: str) -> None:
    output, _ = start("ply_publisher", path=quoted(path)).communicate(timeout=PATIENCE)
    assert output == f"ply_publisher: {path}: No such file or directory\n"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("busy", [True, False])
def test_it_ends_quietly_in_the_middle_of_anything(
    start: Start, node: Node, listener: Any, number: signal.Signals, busy: bool
) -> None:
    process = start("ply_publisher", path="procedural:3000000" if busy else "procedural:1000")
    if busy:
        listener.wait(lambda: node.count_publishers("gaussians"))
    else:
        listener.wait_for(1000)
    process.send_signal(number)
    output, _ = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0
    assert "Error" not in output
    assert "exception" not in output


def test_what_is_read_holds_up_nobody_and_ends_by_a_newer_request(
    node: Node, listener: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, random_splats: Maker
) -> None:
    """However long it tells no progress."""
    go_on = threading.Event()

    def slow(_: object, name: str, progress: formats.Progress, __: formats.Warn) -> Splats:
        go_on.wait(2 * PATIENCE)
        progress(0.5)
        return random_splats(int(name))

    monkeypatch.setattr("rosplat_tools.ply_publisher.load_scene_into", slow)
    roots = ["-r", f"__ns:={node.get_namespace()}", "-p", f"save_root:={tmp_path}"]
    rclpy.init(args=["--ros-args", *roots])
    publisher = PlyPublisher()
    publisher._map.replace(random_splats(7))

    def load(path: str) -> Any:
        return listener.request(LoadScene, "ply_publisher/load", path=path)

    try:
        with spinning(publisher, THREADS):
            loads = [load(str(count)) for count in range(1, 7)]
            name = "ply_publisher/describe_parameters"
            described = listener.call(DescribeParameters, name, names=["path", "save_root"])
            assert all(d.description and d.read_only for d in described.descriptors)
            map_id = publisher._map.map_id
            assert listener.call(PullMap, "gaussians/pull", map_id=map_id).batches
            path = str(tmp_path / "copy.ply")
            assert listener.call(SaveMap, "ply_publisher/save", path=path).splats == 7
            listener.wait(lambda: sum(load.done() for load in loads) == 5)
            assert all(
                load.result().message.endswith(": cancelled") for load in loads if load.done()
            )
            (newest,) = (load for load in loads if not load.done())
            assert listener.call(LoadScene, "ply_publisher/load", path="").success
            listener.wait(newest.done)
            assert (newest.result().success, newest.result().splats) == (False, 7)
            last = load("20")
            go_on.set()
            listener.wait(last.done)
            assert (last.result().success, last.result().splats) == (True, 20)
    finally:
        rclpy.try_shutdown()


@pytest.mark.parametrize("error", [lzma.LZMAError("corrupt\n" * 10**6), MemoryError(), KeyError(3)])
def test_whatever_loading_raises_is_an_answer(
    node: Node, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], error: Exception
) -> None:
    def fail(*_: object) -> None:
        raise error

    monkeypatch.setattr("rosplat_tools.ply_publisher.load_scene_into", fail)
    rclpy.init()
    try:
        publisher = PlyPublisher()
        answer = publisher._on_load(LoadScene.Request(path="a.ply"), LoadScene.Response())
        publisher.destroy_node()
    finally:
        rclpy.shutdown()
    assert not answer.success
    assert type(error).__name__ in answer.message
    (line,) = capfd.readouterr().err.splitlines()
    assert "the map stays" in line
    assert len(line) < 1000


def test_a_map_that_stays_keeps_its_vertical(
    random_splats: Maker, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    formats.save(tmp_path / "a.glb", random_splats(7))
    rclpy.init()
    try:
        publisher = PlyPublisher()
        publisher.load(str(tmp_path / "a.glb"))

        def fail(*_: object, **__: object) -> None:
            raise MemoryError

        monkeypatch.setattr(publisher._map, "replace", fail)
        with pytest.raises(InputError, match="memory"):
            publisher.load("procedural:10")
        assert publisher._up == (0, 1, 0)
        publisher.destroy_node()
    finally:
        rclpy.shutdown()
