"""The command on tiny sizes: what it measures is true, what it writes is whole."""

import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from unittest.mock import MagicMock

import numpy as np
import pytest

from rosplat_core.cameras import save_cameras
from rosplat_core.formats import save as save_scene
from rosplat_core.generated import generate
from rosplat_core.models import Model
from rosplat_core.splats import InputError
from rosplat_lab.bench import bound, rviz, scenes, simplify
from rosplat_lab.bench.command import main
from rosplat_lab.bench.isolation import isolated
from rosplat_lab.bench.records import Record, load
from rosplat_lab.bench.renderers import RENDERERS, GsplatRenderer
from rosplat_testing import PATIENCE


def bench(out: Path, *arguments: str) -> list[Record]:
    """What a run of `bench` wrote for its one subject, each measurement of a few samples."""
    assert main([*arguments, "--quick", "--seconds", "0.01", "--out", str(out)]) == 0
    return load([out / f"{arguments[0]}.json"])


@pytest.fixture
def here(monkeypatch: pytest.MonkeyPatch, few_views: None) -> None:
    """Simplifies within this process, with fewer and smaller views."""
    for subject in (bound, simplify):
        monkeypatch.setattr(subject, "isolated", lambda work, *arguments: work(*arguments))


def test_sorting_is_measured_for_every_backend_that_is_here(tmp_path: Path) -> None:
    records = bench(tmp_path, "sort", "--sizes", "3k", "2k")
    assert {record.scene for record in records} == {"procedural:2000", "procedural:3000"}
    methods = {str(record.parameters["method"]) for record in records}
    assert any(method.startswith("native") for method in methods)
    every = [record for record in records if record.parameters["view"] == "all"]
    assert all(record.parameters["visible"] == record.splats for record in every)
    some = [record for record in records if record.parameters["view"] == "inside"]
    assert all(0 < record.parameters["visible"] < record.splats for record in some)
    assert all(record.n >= 3 and 0 < record.p50 <= record.p95 for record in records)


def test_a_wrong_order_is_not_timed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    backend = "rosplat_sorter.backends.numpy_backend.NumpyBackend.order"
    monkeypatch.setattr(backend, lambda self, view, allocate: np.arange(3, dtype=np.uint32))
    arguments = ["sort", "--sizes", "1k", "--backends", "numpy", "--out", str(tmp_path)]
    assert main(arguments) == 1
    assert not (tmp_path / "sort.json").exists()


def test_cameras_of_a_view_turn_by_a_degree() -> None:
    splats = generate(500)
    for kind in scenes.VIEWS.values():
        first, second = kind(splats, 64, 48, 2)
        cosine = (first.world_to_camera[0, :3] * second.world_to_camera[0, :3]).sum()
        assert np.degrees(np.arccos(cosine)) == pytest.approx(1, rel=0.01)


def test_pictures_are_measured_with_each_kind_of_order(tmp_path: Path) -> None:
    records = bench(tmp_path, "frame", "--sizes", "2000", "--variants", "default", "ray")
    frames = {str(r.parameters["order"]): r for r in records if r.name == "frame"}
    assert {"given", "sorted in the frame, GPU"} <= frames.keys()
    assert all(record.parameters["drawn"] == 2000 for record in frames.values())
    assert {r.parameters["variant"] for r in records if r.name == "frame"} == {"default", "ray"}
    errors = {r.parameters["variant"]: r.value for r in records if r.name == "PSNR"}
    assert errors.keys() == {"default"}  # the reference draws the map in its own model
    assert errors["default"] > 60
    by_name = {record.name: record for record in records}
    assert by_name["GPU memory of the map"].value > 0
    assert by_name["GPU memory"].value * 1e6 >= 1280 * 720 * 4  # the picture is there, too
    assert "OpenGL" in records[0].gpu


def test_frames_are_measured_for_the_sorters_that_are_asked_for(tmp_path: Path) -> None:
    records = bench(
        tmp_path, "frame", "--sizes", "2000", "--variants", "default", "--backends", "gpu"
    )
    orders = {r.parameters["order"] for r in records if r.name == "frame"}
    assert orders == {"sorted in the frame, GPU"}


def test_other_renderers_are_measured_beside_the_display_s(tmp_path: Path) -> None:
    records = bench(tmp_path, "frame", "--sizes", "2000", "--variants", *RENDERERS)
    assert {r.parameters["variant"] for r in records} >= {"cpu"}
    assert all(r.splats == 2000 and r.gpu for r in records)
    by_cpu = {r.name: r.value for r in records if r.parameters["variant"] == "cpu"}
    assert by_cpu.keys() == {"frame", "PSNR"}
    assert by_cpu["PSNR"] > 70


def test_gsplat_draws_each_map_by_its_model(monkeypatch: pytest.MonkeyPatch) -> None:
    gsplat = MagicMock(__version__="")
    monkeypatch.setitem(sys.modules, "gsplat", gsplat)
    monkeypatch.setitem(sys.modules, "torch", MagicMock())
    splats = generate(5)
    renderer = GsplatRenderer()
    for model, function, settings in (
        (Model.EWA, gsplat.rasterization, {}),
        (Model.RAY, gsplat.rasterization, {"with_ut": True, "with_eval3d": True}),
        (Model.DISC, gsplat.rasterization_2dgs, {}),
    ):
        function.reset_mock()
        renderer.set_map(replace(splats, model=model))
        renderer.set_camera(scenes.overview(splats, 64, 48, 1)[0])
        renderer.draw()
        told = function.call_args.kwargs
        assert {name: told[name] for name in told if name.startswith("with_")} == settings


def test_levels_of_detail_are_built_repaired_and_faded(tmp_path: Path) -> None:
    records = bench(tmp_path, "levels", "--sizes", "2000")
    assert {"build", "repair", "memory", "frame", "popping of a camera at rest, worst pixel"} <= {
        record.name for record in records
    }
    details = {r.parameters["detail"] for r in records if r.name == "frame"}
    assert details == {"full", "1000000"}


def test_a_streamed_scene_comes_as_the_camera_goes(tmp_path: Path) -> None:
    records = bench(tmp_path, "stream", "--sizes", "40000")
    assert {record.parameters["budget"] for record in records} == {10_000}
    found = {(r.name, *r.parameters.values()): r for r in records}
    pictures = {name[2]: r for name, r in found.items() if name[0] == "PSNR"}
    assert pictures["at rest"].least > 15
    assert pictures["in flight"].n > 0
    waits = [r for r in records if r.name == "until at rest"]
    assert [r.parameters["after"] for r in waits] == ["start", "flight", "jump"]
    assert waits[0].value > 0
    assert {r.parameters["process"] for r in records if r.name == "RAM"} == {"viewer", "publisher"}


def test_a_camera_takes_pictures_beside_render_view(tmp_path: Path) -> None:
    records = bench(tmp_path, "camera", "--sizes", "2000")
    warp = [r.value for r in records if r.name == "PSNR of the warp"]
    assert len(warp) == 2
    assert min(warp) > 30
    times = {r.parameters["by"]: r for r in records if r.name == "pose to picture"}
    rates = {r.parameters["by"]: r.value for r in records if r.name == "pictures"}
    assert {"camera", "camera, distorted", "RenderView"} <= times.keys()
    assert {"camera", "camera, distorted"} <= rates.keys()
    assert times["RenderView"].gpu != times["camera"].gpu == "processor"
    assert rates["camera"] > 0


def test_the_chain_is_measured_from_pose_to_picture(tmp_path: Path) -> None:
    records = bench(tmp_path, "chain", "--sizes", "2000", "--backends", "native")
    by_name = {record.name: record for record in records if "RAM" not in record.name}
    assert by_name["pose to picture"].p50 > by_name["of which sorting"].p50
    assert by_name["pose to picture"].splats == 2000
    programs = {r.parameters["process"]: r.value for r in records if r.name == "RAM"}
    assert programs.keys() == {"publisher", "sorter", "viewer"}
    assert min(programs.values()) > 20
    most = {r.parameters["process"]: r.value for r in records if r.name == "most RAM"}
    assert all(most[name] >= programs[name] for name in programs)
    (idle,) = (record for record in records if record.name == "idle RAM")
    assert 20 < idle.value < programs["sorter"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["sort", "--sizes", "many"], "'many' is no number of splats"),
        (["sort", "--sizes", "inf"], "'inf' is no number of splats"),
        (["sort", "--seconds", "-1"], "--seconds: '-1' is no time"),
        (["sorting"], "unknown subject 'sorting'"),
    ],
)
def test_what_makes_no_sense_is_said(
    arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        main(arguments)
    assert words in capsys.readouterr().err


def test_a_scene_that_is_not_there_is_named_before_anything_is_measured(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["sort", "--scenes", "no.ply", "--out", str(tmp_path / "out")]) == 1
    assert capsys.readouterr().err == "bench: no.ply: No such file or directory\n"


def test_a_scene_that_is_none_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = tmp_path / "none.ply"
    command = ["sort", "--sizes", "500", "--scenes", str(scene), "--out", str(tmp_path)]
    scene.write_text("?")
    assert main(command) == 1
    assert "none.ply: not a scene, but text that begins '?'" in capsys.readouterr().err
    assert not (tmp_path / "sort.json").exists()
    scene.write_text("ply\n")
    assert main(command) == 1
    assert "none.ply: a PLY with no end_header" in capsys.readouterr().out.replace("\n", "")
    assert load([tmp_path / "sort.json"])  # what came before it is kept


def test_a_scene_without_a_finite_splat_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    splats = generate(3)
    splats.positions[:] = np.nan
    save_scene(tmp_path / "none[0].ply", splats)
    scene = str(tmp_path / "none[0].ply")
    assert main(["sort", "--sizes", "500", "--scenes", scene, "--out", str(tmp_path)]) == 1
    said = capsys.readouterr().out
    assert f"{scene}: holds no splats" in said  # with its brackets
    assert "order in host memory [ms]" in said


def test_a_file_in_the_place_of_the_folder_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "text.txt"
    file.touch()
    assert main(["sort", "--sizes", "500", "--out", str(file)]) == 1
    assert capsys.readouterr().err == f"bench: {file}: no folder for results: File exists\n"


def test_an_interrupted_run_keeps_what_it_measured(tmp_path: Path) -> None:
    process = subprocess.Popen(
        [sys.executable, "-m", "rosplat_lab.bench", "sort", "--sizes", "10k", "10M",
         "--out", str(tmp_path)],
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
    )  # fmt: skip
    deadline = time.monotonic() + PATIENCE
    while not (tmp_path / "sort.json").exists():
        assert time.monotonic() < deadline
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    said, _ = process.communicate(timeout=PATIENCE)
    assert process.returncode == 130
    assert "Traceback" not in said
    assert load([tmp_path / "sort.json"])
    assert "sort: order in host memory [ms]" in said


SLOW_TO_END = """
import multiprocessing.util, time
multiprocessing.util.Finalize(None, time.sleep, (1,), exitpriority=1)
int("three")
"""


def test_isolated_work_runs_elsewhere_and_its_end_is_told(
    capfd: pytest.CaptureFixture[str],
) -> None:
    (pid,) = isolated(map, eval, ["__import__('os').getpid()"])
    assert pid != os.getpid()
    with pytest.raises(RuntimeError, match=r"ValueError: .*'three'"):
        list(isolated(map, exec, [SLOW_TO_END]))
    assert capfd.readouterr().err == ""
    with pytest.raises(RuntimeError, match="ended with code 3"):
        list(isolated(map, os._exit, [3]))


@pytest.mark.parametrize(
    ("text", "why"),
    [("a: [", "not YAML"), ("Class: x", "expected a list"), ("- {Class: x}", "Class and Name")],
)
def test_a_list_of_displays_is_refused_with_its_file(tmp_path: Path, text: str, why: str) -> None:
    file = tmp_path / "displays.yaml"
    file.write_text(text)
    with pytest.raises(InputError, match=f"displays.yaml: .*{why}"):
        rviz.read_displays(file)


@pytest.mark.usefixtures("here")
def test_a_bound_is_judged_in_views_that_were_held_back(tmp_path: Path) -> None:
    records = bench(tmp_path, "bound", "--sizes", "2k")
    found = {
        (record.name, record.parameters["views"]): record.value
        for record in records
        if record.unit == "dB" and record.parameters["bound"] == 35
    }
    assert found["PSNR", "held back"] > 34.7
    for views in ("printed", "held back"):
        worst, most, mean = (
            found[name, views]
            for name in ("PSNR of the worst view", "PSNR that most views reach", "PSNR")
        )
        assert worst <= most <= mean + 1


@pytest.mark.usefixtures("here")
def test_ways_to_fewer_splats_are_judged_along_a_path(tmp_path: Path) -> None:
    cameras = scenes.overview(generate(3000), 320, 180, 20)
    save_cameras(tmp_path / "path.json", cameras)
    records = bench(tmp_path, "simplify", "--sizes", "3k", "--cameras", str(tmp_path / "path.json"))
    found = {
        record.parameters["method"]: record.value
        for record in records
        if record.name == "PSNR" and record.parameters["share"] == 0.5
    }
    assert found["simplify, along the path"] > found["random"] + 3
    assert found["simplify, along the path, refitted"] >= found["simplify, along the path"]
    assert found["simplify"] < found["simplify, along the path"]


def test_a_simulated_robot_is_timed_and_its_lidar_judged(tmp_path: Path) -> None:
    pytest.importorskip("mujoco", reason="no mujoco here (PyPI)")
    records = bench(tmp_path, "simulate", "--sizes", "60k")
    found = {(record.name, *record.parameters.values()): record.value for record in records}
    for timed in ("picture and depth, with physics", "physics of 0.1 s"):
        assert found[timed,] > 0
    assert found["steps a second", 16, "84x84"] > 0
    assert found["error of ranges", "0 to 60 deg", "off edges"] < 5
    assert found["ranges within 0.03 m", "0 to 60 deg", "off edges"] > 0.9
