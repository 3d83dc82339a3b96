"""`simplify`, whole: what it writes keeps its bound, what it can't keep it refuses."""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from rosplat_core.cameras import Camera, look_at, orbit, resized
from rosplat_core.formats import load, save
from rosplat_core.generated import generate
from rosplat_core.rendering import CpuRenderer
from rosplat_core.simplification import search, simplify
from rosplat_core.simplification.judging import Judge, Trial
from rosplat_core.simplification.merging import find_pairs, merge
from rosplat_core.simplification.search import Learnt, Simplification
from rosplat_core.simplification.views import Around, whereabouts
from rosplat_core.slot_order import put_in_slot_order
from rosplat_core.splats import InputError, Splats
from rosplat_ros.program.processes import node_command
from rosplat_testing import PATIENCE
from rosplat_tools.simplify.command import main

pytestmark = pytest.mark.usefixtures("few_views")

GARDEN = "procedural:3000"


@pytest.fixture(scope="module")
def garden() -> Splats:
    """As `simplify` puts it."""
    splats = generate(3000)
    put_in_slot_order(splats)
    return splats


@pytest.fixture
def out(tmp_path: Path) -> Path:
    return tmp_path / "out.ply"


def learnt(splats: Splats) -> Learnt:
    trial = Trial(splats)
    found = Learnt(trial, Around(splats))
    found.add(trial, 24, lambda part: None)
    return found


def test_views_are_those_of_their_seed_and_of_no_other(garden: Splats) -> None:
    first, again, others = (Around(garden).cameras(6, seed) for seed in (0, 0, 1))
    assert all(
        (a.world_to_camera == b.world_to_camera).all() for a, b in zip(first, again, strict=True)
    )
    places = np.array([camera.position for camera in [*first, *others]])
    assert len(np.unique(places, axis=0)) == 12


def test_half_of_the_views_look_at_the_middle_from_near_and_far_alike(garden: Splats) -> None:
    here = whereabouts(garden)
    away = [
        np.linalg.norm(camera.position - here.centre) / here.radius
        for camera in Around(garden).cameras(200, 0)[::2]
    ]
    near, far = 0.5, 2.4
    assert near < min(away) < 0.8 * math.sqrt(near * far)
    assert 1.2 * math.sqrt(near * far) < max(away) < far * (1 + 1e-9)
    assert 25 < sum(distance < math.sqrt(near * far) for distance in away) < 60


def test_what_no_view_sees_counts_for_little(garden: Splats) -> None:
    """But for more than nothing: other views will."""
    hidden = replace(garden[:1], positions=garden.positions[:1] + np.float32(1e4))
    splats = Splats(
        *(
            np.concatenate([getattr(garden, name), getattr(hidden, name)])
            for name in ("positions", "orientations", "scales", "opacities", "sh")
        )
    )
    found = learnt(splats).contributions
    assert 0 < found.weight[-1] < 0.3 * found.weight[0]
    assert 0 < found.energy[-1] < 0.1 * found.energy[0]
    assert found.error[-1] > 0


def test_a_trial_shows_what_merging_makes(garden: Splats) -> None:
    """Whether more of the pairs are merged than before, or fewer."""
    cameras = [resized(camera, 320 * 180) for camera in Around(garden).cameras(4, 0)]
    trial = Trial(garden)
    found = learnt(garden).contributions
    pairs = find_pairs(garden, found, 0.01)
    judge = Judge(trial, cameras)
    for count in (100, 700, 300, 0):
        trial.apply(pairs, count)
        merged, _ = merge(garden, found, pairs, count)
        expected = judge.errors(Trial(merged))
        np.testing.assert_allclose(judge.errors(trial), expected, rtol=1e-3)
        assert (expected > 0).all() == (count > 0)


def test_fewer_splats_that_keep_the_bound(garden: Splats, out: Path, tmp_path: Path) -> None:
    report = tmp_path / "report.json"
    assert main([GARDEN, str(out), "--psnr", "35", "--report", str(report)]) == 0
    found = json.loads(report.read_text())
    fewer = load(out)
    assert len(fewer) == found["splats"] < 0.97 * len(garden)
    assert found["bytes"] == out.stat().st_size
    assert Simplification(garden).judge(fewer).mean >= 35
    assert found["psnr"] >= 34 and found["mean"] >= 35
    assert found["worst"] <= found["psnr"] <= found["mean"]
    assert found["views"]["new"] == 20 >= found["views"]["new_that_reach"] > 16


def test_a_row_is_of_the_map_that_has_so_many_splats(garden: Splats) -> None:
    """What an earlier map made in views that were not drawn again is in no row."""
    work = Simplification(garden)
    work.shrink(33)
    (row,) = [step for step in work.steps if step.splats == len(work.splats)]
    new = Judge(Trial(garden), work.views.cameras(search.FRESH, search.FRESH_SEED + 1))
    assert row.quality.mean == pytest.approx(new(work.splats).mean, abs=0.01)
    assert row.quality.worst == pytest.approx(new(work.splats).worst, abs=0.01)


def test_searches_judge_by_views_that_nothing_was_learnt_from(
    garden: Splats, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Learnt from, the views that missed a bound would no longer tell of others."""
    learnt: list[Camera] = []
    add = Learnt.add_again

    def add_again(self: Learnt, trial: Trial, cameras: list[Camera], *rest: Any) -> None:
        learnt.extend(cameras)
        add(self, trial, cameras, *rest)

    monkeypatch.setattr(Learnt, "add_again", add_again)
    work = Simplification(garden)
    work.shrink(45)
    judged = {camera.world_to_camera.tobytes() for camera in work.judge.cameras}
    assert len(judged) == 40 and learnt
    assert not judged & {camera.world_to_camera.tobytes() for camera in learnt}


def test_the_bound_is_that_of_the_file(garden: Splats, tmp_path: Path) -> None:
    """SPZ rounds; less may then be merged, or nothing."""
    out = tmp_path / "out.spz"
    assert main([GARDEN, str(out), "--psnr", "30"]) == 0
    assert Simplification(garden).judge(load(out)).mean >= 30


def test_an_empty_map(garden: Splats) -> None:
    with pytest.raises(InputError, match="no splats"):
        simplify(garden[:0], psnr=45)


@pytest.mark.parametrize(
    ("given", "error"),
    [
        ({"max_splats": 2.5}, "max_splats is 2.5, expected a whole number"),
        ({"psnr": 40, "margin": -1.0}, "margin is -1.0, expected a distance in metres, 0 or more"),
        ({"psnr": 40, "margin": math.nan}, "margin is nan, expected a distance in metres"),
        ({"psnr": math.nan}, "give psnr or max_splats, above 0; got nan and None"),
    ],
)
def test_arguments_that_are_none(garden: Splats, given: dict[str, Any], error: str) -> None:
    with pytest.raises(InputError, match=f"simplify: {error}"):
        simplify(garden, **given, cameras=orbit([[-2, -2, -2], [2, 2, 2]], 12))


@pytest.mark.parametrize("name", ["positions", "scales", "opacities", "orientations", "sh"])
def test_splats_that_can_not_be_drawn_are_dropped(
    garden: Splats, caplog: pytest.LogCaptureFixture, name: str
) -> None:
    spoilt = getattr(garden, name).copy()
    spoilt[3], spoilt[5] = np.nan, np.inf
    splats = replace(garden, **{name: spoilt})
    fewer = simplify(splats, max_splats=500)
    assert len(fewer) == 500
    assert np.isfinite(getattr(fewer, name)).all()
    assert "simplify: dropped 2 of 3,000 splats: a number that is not finite" in caplog.text
    with pytest.raises(InputError, match="no splats"):
        simplify(splats[[3, 5]], max_splats=500)


def test_a_bound_that_no_splat_can_be_spared_for(
    out: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([GARDEN, str(out), "--psnr", "120"]) == 1
    assert "none of 3,000 splats can be spared at 120 dB: " in capsys.readouterr().err
    assert not out.exists()


def test_a_bound_that_the_format_breaks(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out.splat"
    assert main([GARDEN, str(out), "--psnr", "80"]) == 1
    assert "80 dB can't be had: its format keeps " in capsys.readouterr().err
    assert not out.exists()


def test_refitting_makes_what_is_left_better(out: Path, tmp_path: Path) -> None:
    report = tmp_path / "report.json"
    arguments = [GARDEN, str(out), "--max-splats", "1000", "--report", str(report)]
    assert main([*arguments, "--refine", "0.05"]) == 0
    found = json.loads(report.read_text())
    before = found["steps"][-2]
    assert found["splats"] == before["splats"] <= 1000
    assert found["psnr"] > before["psnr"]
    assert found["worst"] >= before["worst"]


def test_fewer_splats_keep_a_bound_where_they_are_refitted(garden: Splats, tmp_path: Path) -> None:
    merged, refitted = tmp_path / "merged.ply", tmp_path / "refitted.ply"
    assert main([GARDEN, str(merged), "--psnr", "33"]) == 0
    assert main([GARDEN, str(refitted), "--psnr", "33", "--refine", "0.3"]) == 0
    assert len(load(refitted)) < len(load(merged))
    assert Simplification(garden).judge(load(refitted)).mean >= 33


@pytest.mark.parametrize("disturbed", [False, True], ids=["in vain", "Ctrl-C"])
def test_where_refitting_falls_short_nothing_is_refitted(
    garden: Splats, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, disturbed: bool
) -> None:
    tries = 0

    def refit(*_: object) -> Iterator[Splats]:
        nonlocal tries
        tries += 1
        yield replace(garden, sh=0.96 * garden.sh)  # better than what it starts with, not enough
        if disturbed:
            raise KeyboardInterrupt

    monkeypatch.setattr(search, "refit", refit)
    refitted = tmp_path / "refitted.ply"
    assert main([GARDEN, str(refitted), "--psnr", "38", "--refine", "1"]) == 0
    assert tries == (1 if disturbed else 2)
    assert len(load(refitted)) < len(garden)
    assert Simplification(garden).judge(load(refitted)).mean >= 38


def test_bounds_that_exclude_each_other(out: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([GARDEN, str(out), "--psnr", "50", "--max-splats", "300"]) == 1
    said = capsys.readouterr().err
    assert "50 dB take " in said and "; 300 splats have " in said
    assert not out.exists()


@pytest.mark.parametrize("count", [1, 1000, 3000, 5000])
def test_so_many_splats(out: Path, count: int) -> None:
    assert main([GARDEN, str(out), "--max-splats", str(count)]) == 0
    assert len(load(out)) == min(count, 3000)


@pytest.mark.parametrize("ending", [".ply", ".spz", ".sog"])
def test_so_many_bytes(tmp_path: Path, ending: str) -> None:
    out = tmp_path / f"out{ending}"
    save(out, generate(3000))
    most = out.stat().st_size * 2 // 3
    assert main([GARDEN, str(out), "--max-bytes", str(most), "--overwrite"]) == 0
    assert 0.9 * most < out.stat().st_size <= most


def test_what_is_left_makes_up_for_what_left(
    garden: Splats, monkeypatch: pytest.MonkeyPatch
) -> None:
    made, plain = Simplification(garden), Simplification(garden)
    made.reduce(1000)
    monkeypatch.setattr(Simplification, "_brighten", lambda _: None)
    plain.reduce(1000)
    ours, others = made.judge(made.splats), made.judge(plain.splats)
    assert ours.mean > others.mean + 0.3
    assert ours.psnr > others.psnr
    assert (made.splats.sh[:, 1:] == plain.splats.sh[:, 1:]).all()


def test_fewer_bytes_than_any_file(out: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([GARDEN, str(out), "--max-bytes", "10"]) == 1
    assert "1 splats take " in capsys.readouterr().err
    assert not out.exists()


def one(**fields: object) -> Splats:
    return replace(generate(1), **fields)


SCENES = {
    "one splat": one(),
    "all in one place": replace(generate(500), positions=np.ones((500, 3), np.float32)),
    "one that covers the world": replace(
        generate(500), scales=np.full((500, 3), 0.01) + 1e8 * (np.arange(500) == 7)[:, None]
    ),
    "points": replace(generate(500), scales=np.zeros((500, 3))),
    "far from zero": replace(generate(500), origin=np.array([5e6, -4e6, 30.0])),
}


@pytest.mark.parametrize("name", SCENES)
def test_scenes_unlike_others(name: str, out: Path, tmp_path: Path) -> None:
    scene = tmp_path / "scene.ply"
    save(scene, SCENES[name])
    assert main([str(scene), str(out), "--max-splats", "100"]) == 0
    fewer = load(out)
    assert len(fewer) == min(100, len(SCENES[name]))
    assert np.isfinite(fewer.positions).all() and (fewer.scales >= 0).all()


def test_one_splat_can_not_be_spared(
    out: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = tmp_path / "scene.ply"
    save(scene, SCENES["one splat"])
    assert main([str(scene), str(out), "--psnr", "20"]) == 1
    assert "none of 1 splats can be spared" in capsys.readouterr().err


@pytest.mark.parametrize(
    "bound",
    [
        ["--psnr", "0"], ["--psnr", "inf"], ["--psnr", "nan"], ["--psnr", "-3"], ["--psnr", "much"],
        ["--max-splats", "0"], ["--max-splats", "1.5"], ["--max-bytes", "0"], ["--max-bytes", "M"],
    ],
    ids=" ".join,
)  # fmt: skip
def test_bounds_that_are_none(
    bound: list[str], out: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        main([GARDEN, str(out), *bound])
    assert f"argument {bound[0]}: '" in capsys.readouterr().err


def test_refusals_before_any_work(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene, empty = tmp_path / "scene.ply", tmp_path / "empty.ply"
    save(scene, generate(10))
    save(empty, generate(10)[:0])
    wide, remote = tmp_path / "wide.ply", tmp_path / "remote.ply"
    save(wide, replace(generate(10), positions=1e30 * generate(10).positions))
    save(remote, replace(generate(10), positions=generate(10).positions + 1e20))
    out, folder = tmp_path / "out.ply", tmp_path / "folder.ply"
    folder.mkdir()
    os.mkfifo(pipe := tmp_path / "pipe.json")
    for arguments, error in {
        (GARDEN, str(out)): "Give --psnr, --max-splats or --max-bytes",
        (str(scene), str(scene), "--psnr", "50", "--overwrite"): f"{scene}: is the scene itself",
        (str(scene), str(scene), "--psnr", "50"): f"{scene}: exists already",
        (GARDEN, str(tmp_path / "no" / "a.ply"), "--psnr", "50"): "is no folder",
        (GARDEN, str(out), "--psnr", "50", "--report", "no/a.json"): "no/a.json: no is no folder",
        (GARDEN, str(out), "--psnr", "50", "--report", str(pipe)): f"{pipe}: is no file",
        (GARDEN, str(tmp_path / "a.obj"), "--psnr", "50"): "can't write this ending",
        (GARDEN, str(folder), "--psnr", "50", "--overwrite"): f"{folder}: is a folder",
        (str(empty), str(out), "--psnr", "50"): f"{empty}: holds no splats",
        (str(wide), str(out), "--psnr", "50"): "m wide: no camera can look at it",
        (str(remote), str(out), "--psnr", "50"): f"{remote}: the scene is 0.002 m wide and 1e+20 m",
        (str(tmp_path / "none.ply"), str(out), "--psnr", "50"): "none.ply",
    }.items():
        assert main([*arguments]) == 1
        assert error in capsys.readouterr().err
    assert not out.exists()


def test_a_report_replaces_nothing_unasked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene, cameras, poses, bag = (
        tmp_path / name for name in ("scene.ply", "cameras.json", "poses.txt", "bag.mcap")
    )
    save(scene, generate(10))
    for file in (cameras, poses, bag):
        file.write_text("precious")
    (link := tmp_path / "link.json").symlink_to(cameras)
    out = tmp_path / "out.ply"
    bound = [str(scene), str(out), "--psnr", "50", "--cameras", str(cameras)]
    for report, *more in (
        (scene, "--overwrite"),
        (out,),
        (cameras, "--overwrite"),
        (link, "--overwrite"),
        (poses, "--overwrite", "--trajectory", str(poses)),
        (bag, "--overwrite", "--trajectory", f"{bag}:/poses"),
    ):
        assert main([*bound, "--report", str(report), *more]) == 1
        assert f"{report}: is an input, or the output" in capsys.readouterr().err
    assert main([*bound, "--report", str(poses)]) == 1
    assert f"{poses}: exists already (--overwrite replaces it)" in capsys.readouterr().err
    assert {file.read_text() for file in (cameras, poses, bag)} == {"precious"}
    assert not out.exists()


def test_a_report_is_replaced_where_that_is_asked_for(out: Path, tmp_path: Path) -> None:
    (report := tmp_path / "report.json").write_text("old")
    arguments = [GARDEN, str(out), "--max-splats", "100", "--report", str(report)]
    assert main([*arguments, "--overwrite"]) == 0
    assert json.loads(report.read_text())["splats"] == 100


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_interrupted_it_leaves_nothing(tmp_path: Path, number: int) -> None:
    folder = tmp_path / "out"
    folder.mkdir()
    command = node_command("rosplat_tools", "simplify", "procedural:1000000")
    with subprocess.Popen(
        [*command, str(folder / "out.ply"), "--psnr", "40"], stderr=subprocess.PIPE, text=True
    ) as process:
        time.sleep(6)  # of 15 on two cores, most of which it spends with views
        process.send_signal(number)
        assert process.stderr
        assert (process.wait(PATIENCE), process.stderr.read()) == (130, "")
    assert not list(folder.iterdir())


def test_what_shows_nothing_of_the_map_counts_for_nothing(garden: Splats) -> None:
    """A wider picture of the same view has the same PSNR."""
    narrow = Camera(0, 160, 90, 150, 150, 80, 45, look_at((0, -9, 3), (0, 0, 0)))
    wide = replace(narrow, width=240, height=180, cx=120, cy=90)
    darker = replace(garden, sh=garden.sh * np.float32(0.9))
    trial = Trial(garden)
    assert trial.renderer.render(narrow)[[0, -1], :, 3].max() < 0.01
    one, other = (Judge(trial, [camera])(darker).psnr for camera in (narrow, wide))
    assert one == pytest.approx(other, abs=0.05)


def test_the_worst_of_the_views_is_the_one_that_is_shown(garden: Splats) -> None:
    cameras = [resized(camera, 160 * 90) for camera in Around(garden).cameras(5, 5)]
    darker = replace(garden, sh=garden.sh * np.float32(0.9))
    judge = Judge(Trial(garden), cameras)
    original, ours = judge.worst(darker)
    worst = cameras[judge.errors(Trial(darker)).argmax()]
    for picture, splats in ((original, garden), (ours, darker)):
        expected = CpuRenderer(splats).render(worst)[..., :3].clip(0, 1)
        np.testing.assert_allclose(picture, expected, atol=1e-4)


def test_a_picture_of_the_worst_view(
    out: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = [GARDEN, str(out), "--max-splats", "1000", "--picture"]
    assert main([*arguments, str(tmp_path / "worst.bmp")]) == 1
    assert "worst.bmp: a picture ends in .png or .jpg" in capsys.readouterr().err
    assert main([*arguments, str(tmp_path / "worst.png")]) == 0
    whole, left, difference = np.split(cv2.imread(str(tmp_path / "worst.png")), 3, axis=1)
    assert np.abs(whole.astype(int) - left).mean() < 0.3 * whole.mean()
    assert difference.any()


def test_a_judge_tells_what_differs(garden: Splats) -> None:
    cameras = [resized(camera, 160 * 90) for camera in Around(garden).cameras(3, 5)]
    judge = Judge(Trial(garden), cameras)
    assert judge(garden).psnr == judge(garden).worst == 150
    darker = replace(garden, sh=garden.sh * np.float32(0.9))
    assert 10 < judge(darker).worst <= judge(darker).psnr < 60
