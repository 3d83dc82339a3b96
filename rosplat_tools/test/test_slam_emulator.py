"""The emulated SLAM back end over DDS: what it sends, and that it arrives at the scene."""

import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rclpy

from rosplat_core import formats
from rosplat_core.splats import Splats
from rosplat_msgs.msg import GaussianArray
from rosplat_ros.program import parameter_help
from rosplat_testing.messages import as_held
from rosplat_tools.emulation import slam_emulator

Start = Callable[..., subprocess.Popen[str]]


def test_the_map_grows_is_edited_and_ends_as_the_scene(
    start: Start, listener: Any, tmp_path: Path, random_splats: Callable[..., Splats]
) -> None:
    path = tmp_path / "scene.ply"
    formats.save(path, random_splats(3050))
    process = start("slam_emulator", path=path, batch_size=100, rate=200.0, prune_fraction=0.1)
    assert process.stdout
    # Says so when the last edit is out; the listener pulls the map then.
    assert f"mapping {path}: 3,050 splats" in process.stdout.readline()
    assert "3,050 splats mapped" in process.stdout.readline()
    listener.wait_for(3050)
    assert {batch.expected_slots for batch in listener.batches} == {3050}

    _, splats = listener.map.snapshot()
    scene = as_held(formats.load(path))
    mine, its = np.lexsort(splats.positions.T), np.lexsort(scene.positions.T)
    for name in ("positions", "orientations", "scales", "opacities", "sh"):
        np.testing.assert_array_equal(getattr(splats, name)[mine], getattr(scene, name)[its])
    np.testing.assert_array_equal(splats.channels["keyframe"], np.arange(3050) // 100)


def test_it_sends_at_its_rate(start: Start, listener: Any) -> None:
    start("slam_emulator", path="procedural:30000", batch_size=100, rate=20.0, refine_fraction=0.0)

    def last() -> list[GaussianArray]:
        return listener.batches[-41:]

    # That are heard: all that is pulled at once is of one revision.
    listener.wait(lambda: len(last()) == 41 and last()[40].revision - last()[0].revision == 40)
    stamps = [batch.header.stamp for batch in last()]
    seconds = [stamp.sec + stamp.nanosec * 1e-9 for stamp in stamps]
    assert seconds[-1] - seconds[0] == pytest.approx(2, abs=0.6)


def test_a_loop_starts_over(start: Start, listener: Any) -> None:
    start("slam_emulator", path="procedural:500", batch_size=100, rate=50.0, loop="true")
    listener.wait(lambda: sum(batch.operation == 0 for batch in listener.batches) > 2)
    assert len({batch.map_id for batch in listener.batches}) == 1


@pytest.mark.parametrize(
    ("parameters", "named"),
    [
        ({"path": "/nowhere/scene.ply"}, "/nowhere/scene.ply"),
        ({"refine_fraction": 0.8, "prune_fraction": 0.8}, "refine_fraction, prune_fraction"),
        ({"rate": 0.0}, "rate"),
        ({"batch_size": "many"}, "batch_size"),
        ({"compression": "zip"}, "compression: expected one of none, quantised, got 'zip'"),
    ],
)
def test_a_start_that_makes_no_sense_is_one_line_and_code_1(
    refusal: Callable[..., str], parameters: dict[str, object], named: str
) -> None:
    assert named in refusal("slam_emulator", **({"path": "procedural:10"} | parameters))


def test_submaps_drift_until_a_loop_closure_moves_them(start: Start, listener: Any) -> None:
    start("slam_emulator", path="procedural:3000", batch_size=500, rate=200.0, submaps=3)
    listener.wait_for(3000)
    poses = listener.map.poses
    listener.wait(lambda: len(poses) == 2 and not any(pose[0, 3] for pose in poses.values()))
    assert [part.group for part in listener.map.groups()] == [0, 1, 2]
    assert sorted(poses) == [1, 2]


def test_it_sends_payloads_if_it_is_to(start: Start, listener: Any) -> None:
    start("slam_emulator", path="procedural:1000", rate=200.0, compression="quantised")
    listener.wait_for(1000)
    assert {batch.format for batch in listener.batches if batch.count} <= {"quantised", ""}
    assert any(batch.format for batch in listener.batches)


def test_help_loads_no_scene(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parameter_help, "asked", True)
    monkeypatch.setattr(slam_emulator, "load_scene", lambda *_: pytest.fail("loaded"))
    rclpy.init()
    try:
        with pytest.raises(parameter_help._Stop):
            slam_emulator.SlamEmulator()
    finally:
        rclpy.shutdown()
