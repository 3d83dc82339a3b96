"""The laboratory's maths: models against closed forms, orders, the frontier, what pages say."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.text import Text
from numpy.typing import NDArray

from rosplat_core import depth
from rosplat_core.cameras import Camera, look_at
from rosplat_core.generated import generate
from rosplat_core.splats import Splats, concatenate
from rosplat_core.view import SortView
from rosplat_lab import reference
from rosplat_lab.bench import truths
from rosplat_lab.bench.records import Measurement, Record
from rosplat_lab.bench.scenes import placed, turned
from rosplat_lab.bench.sort import view_of
from rosplat_lab.lab import orders, pages, picture, viewers, ways
from rosplat_lab.lab.command import kind_of
from rosplat_lab.lab.points import Point, for_decibels, frontier, points, verdict

Make = Callable[..., Splats]

CAMERA = Camera(0, 64, 48, 60, 60, 32, 24, look_at((3, 2, 1), (0, 0, 0)))
AHEAD = replace(CAMERA, world_to_camera=np.eye(4))
WHOLE = (0, 0, 64, 48)


# --- Models ---------------------------------------------------------------------------------------


def ball(**changes: object) -> Splats:
    """One white, round splat before the camera."""
    fields = {
        "positions": np.array([[0.0, 0.0, 2.0]], np.float32),
        "orientations": np.array([[0, 0, 0, 1]], np.float32),
        "scales": np.full((1, 3), 0.2, np.float32), "opacities": np.full(1, 0.9, np.float32),
        "sh": np.full((1, 1, 3), 0.5 / 0.28209479, np.float32),
    }  # fmt: skip
    return Splats(**(fields | changes))  # type: ignore[arg-type]


def test_rvizsplat_leaves_out_faint_splats_and_faint_rims() -> None:
    faint = ball(opacities=np.full(1, 0.39, np.float32))
    assert not viewers.rvizsplat(faint, AHEAD, WHOLE).any()
    seen = viewers.rvizsplat(ball(), AHEAD, WHOLE)[24, :, 0]
    assert seen.max() == pytest.approx(0.9, abs=0.02)
    assert seen[seen > 0].min() >= 0.05


def test_what_is_compared_is_the_middle_of_the_whole_picture() -> None:
    splats = generate(300)
    camera = replace(CAMERA, width=700, height=400, cx=350.0, cy=200.0, fx=600.0, fy=600.0)
    rows, columns = truths.compared(700, 400)
    whole = reference.render(splats, camera).rgba[..., :3]
    crop = (columns.start, rows.start, columns.stop, rows.stop)
    np.testing.assert_allclose(truths.exact(splats, camera, crop), whole[rows, columns])
    assert whole[rows, columns].shape == (360, 640, 3)
    assert truths.psnr(whole, whole[rows, columns].astype(np.float32)) > 100


def test_what_a_part_of_a_picture_shows_is_not_left_out() -> None:
    """Splats beside a wide camera reach farther in its picture than in one of the part alone."""
    splats, crop = generate(3000, seed=3), (920, 520, 1000, 560)
    pose = look_at((2.0, 1.0, 0.7), (0.0, 0.0, 0.5))
    camera = Camera(0, 1920, 1080, 300.0, 300.0, 960.0, 540.0, pose)
    some = truths.in_view(splats, camera, crop)
    assert len(some) < len(splats)
    np.testing.assert_array_equal(
        truths.exact(splats[some], camera, crop), truths.exact(splats, camera, crop)
    )


# --- Orders and maps ------------------------------------------------------------------------------


def test_keys_of_all_bits_are_the_exact_order(random_splats: Make) -> None:
    splats = random_splats(500)
    sorter = orders.Sorter(splats)
    exact = sorter.order(CAMERA)
    assert len(exact) > 100

    def keys(view: SortView, positions: NDArray[np.float32]) -> NDArray[np.uint32]:
        return depth.sort_keys(depth.transform(view, positions, 2))

    np.testing.assert_array_equal(sorter.keyed(CAMERA, keys), exact)


def test_coarse_keys_never_turn_depths_round_and_use_their_bits() -> None:
    positions = np.random.default_rng(0).normal(size=(5000, 3)).astype(np.float32)
    view = view_of(CAMERA, generate(10))
    by_depth = np.argsort(depth.transform(view, positions, 2))
    for bits in (4, 8, 12, 16):
        keys = orders.linear(bits)(view, positions)[by_depth]
        assert keys.dtype == np.uint32
        assert (np.diff(keys.astype(np.int64)) >= 0).all()
        assert keys.max() == 2**bits - 1


def test_a_turn_leaves_an_order_by_distance_alone(random_splats: Make) -> None:
    splats = random_splats(500)
    sorter = orders.Sorter(splats)
    by_distance = [
        sorter.keyed(camera, orders.by_distance) for camera in (CAMERA, turned(CAMERA, 0.1))
    ]
    both = np.intersect1d(*by_distance)
    assert len(both) > 100
    kept = [order[np.isin(order, both)] for order in by_distance]
    np.testing.assert_array_equal(*kept)


def test_cameras_turn_to_their_right_and_move() -> None:
    right = turned(AHEAD, 0.1)
    assert right.camera_to_world[:3, 2] == pytest.approx([np.sin(0.1), 0, np.cos(0.1)])
    assert right.position == pytest.approx([0, 0, 0])
    assert placed(right, (1, 2, 3)).position == pytest.approx([1, 2, 3])


def test_a_map_is_quantised_as_publishers_send_it() -> None:
    splats = generate(2000)
    sent = ways.quantised(splats)
    off = np.abs(sent.positions - splats.positions).max()
    assert 0 < off < 1e-3
    stray = replace(splats[:1], positions=np.full((1, 3), 1e5, np.float32))
    whole = ways.quantised(concatenate([splats, stray]))  # too coarse: sent as arrays
    np.testing.assert_array_equal(whole.positions[:2000], splats.positions)


@pytest.mark.parametrize(
    ("splats", "text"),
    [(1, "1"), (500, "500"), (1000, "1k"), (250_000, "250k"), (1_500_000, "1.5M")],
)
def test_a_number_of_splats_in_few_signs(splats: int, text: str) -> None:
    assert ways.counted(splats) == text


@pytest.mark.usefixtures("few_views")
def test_every_way_has_a_name_and_a_map_of_its_own() -> None:
    splats = generate(2000)
    made = dict(ways.maps(splats, True))
    assert len(made["1/4"]) <= 500 and len(made["1/2 refitted"]) == len(made["1/2"])
    for card in (False, True):
        found = list(ways.ways(splats, card, True))
        assert len({way.setting for way in found}) == len(found)
        assert {way.map for way in found} <= made.keys()
        assert found[0].setting == ways.DEFAULT


# --- What comes of it -----------------------------------------------------------------------------


def point(setting: str, ms: float | None, psnr: float, **changes: object) -> Point:
    """A point without noise, with nothing special about the rest."""
    fields = {
        "setting": setting, "family": "Detail", "aside": "", "scene": "s", "splats": 1, "ms": ms,
        "ms_noise": 0.0, "psnr": psnr, "psnr_noise": 0.0, "worst_view": psnr, "worst_pixel": 0.1,
        "drawn": 1,
    }  # fmt: skip
    return Point(**(fields | changes))  # type: ignore[arg-type]


def names(found: list[Point]) -> list[str]:
    return [p.setting for p in found]


def test_the_frontier_by_hand() -> None:
    """b is beaten in both, d has no time, e is as good as c but slower, g is seen aside."""
    found = [
        point("a", 10, 40), point("b", 12, 39), point("c", 20, 60), point("d", None, 99),
        point("e", 21, 60), point("f", 5, 20), point("g", 1, 90, aside="a model"),
    ]  # fmt: skip
    assert names(frontier(found)) == ["f", "a", "c"]
    equal = [point("first", 10, 60), point("faster by chance", 9.9, 60.1)]
    assert names(frontier(equal)) == ["first"]


def test_what_gains_no_more_than_noise_is_not_on_the_frontier() -> None:
    """Neither decibels that passes differ by, nor time."""
    found = [point("fast", 11, 93.7), point("slow", 42, 93.9), point("exact", 50, 99)]
    assert names(frontier(found)) == ["fast", "exact"]
    found = [point("fast", 11, 60, psnr_noise=5), point("slow", 42, 64), point("exact", 50, 99)]
    assert names(frontier(found)) == ["fast", "exact"]
    found = [point("coarse", 10, 40, ms_noise=2), point("fine", 11, 60), point("slow", 20, 80)]
    assert names(frontier(found)) == ["fine", "slow"]


def test_settings_for_an_error() -> None:
    found = [point("a", 10, 40), point("b", 20, 60), point("c", 5, 20)]
    best = for_decibels(found, 45)
    assert best and best.setting == "b"
    assert for_decibels(found, 70) is None


def test_the_default_is_justified_by_the_frontier_or_said_to_be_beaten() -> None:
    default = point(ways.DEFAULT, 20, 80)
    assert "nothing is more exact" in verdict([default, point("a", 10, 40)])
    assert "slow has 90.0 dB in 40 ms" in verdict([default, point("slow", 40, 90)])
    assert verdict([default, point("fast", 10, 81)]).startswith("beaten (20 ms, 80.0 dB) by fast")
    assert "within the noise" in verdict([default, point("fast", 19.9, 81)])


def records(gpu: str = "CPU, avx2") -> list[Record]:
    """A run of three settings on one scene."""
    here = {
        "machine": "EPYC, 2 cores, 24 GiB", "gpu": "", "driver": "", "commit": "abc1234",
        "command": "lab s.ply", "time": "2026-01-02T", "load": 0.1,
    }  # fmt: skip
    found = []
    settings = ((ways.DEFAULT, 20.0, 80.0, ""), ("Detail: 4 px", 10.0, 45.0, ""),
                ("RVizSplat", None, 28.0, ways.MODEL))  # fmt: skip
    for setting, ms, psnr, aside in settings:
        labels = {"setting": setting, "family": "Detail", "aside": aside}
        where = ("s.ply", 1000, gpu)
        if ms:
            times = [ms - 0.1, ms, ms + 0.1]
            found.append(Measurement("frame", "ms", times, *where, **labels))
        facts = {"worst_view": psnr - 3, "worst_pixel": 0.5, "drawn": 900}
        found.append(Measurement("PSNR", "dB", psnr, *where, **labels, **facts))
    return [Record.of("lab", measured, here) for measured in found]


def test_points_are_what_records_say() -> None:
    default, detail, model = points(records())
    assert (default.setting, default.scene, default.splats) == (ways.DEFAULT, "s", 1000)
    assert (default.ms, default.psnr, default.worst_view) == (20, 80, 77)
    assert default.ms_noise == pytest.approx(0.1)
    assert detail.family == "Detail" and model.ms is None and model.aside == ways.MODEL


def test_a_run_is_of_a_card_or_of_a_processor() -> None:
    assert kind_of(records()) == kind_of(records("llvmpipe (LLVM 15), OpenGL 4.5")) == "processor"
    assert kind_of(records("NVIDIA H100/PCIe, OpenGL 4.6")) == "card"


def test_a_page_keeps_what_is_written_by_hand_and_names_the_commit(tmp_path: Path) -> None:
    page = tmp_path / "accuracy.md"
    page.write_text(f"# By hand\n\n{pages.MADE}of before\n")
    assert pages.write(tmp_path, {"processor": records()}, {}) == [page]
    text = page.read_text()
    assert text.startswith("# By hand\n") and "of before" not in text
    assert "commit abc1234" in text and "EPYC, 2 cores" in text
    assert "| **Detail: 4 px** | 10 | 45.0 | 42.0 |" in text
    assert f"{ways.DEFAULT}, 20 ms" in text  # for 60 dB
    assert "RVizSplat (model) 28.0 dB" in text


def test_the_picture_has_a_panel_for_each_kind_of_machine(tmp_path: Path) -> None:
    kept = {"card": records("NVIDIA H100/PCIe, OpenGL 4.6"), "processor": records()}
    path = picture.write(tmp_path, kept)
    assert 10_000 < path.stat().st_size < 300_000
    assert picture.where(kept["card"]) == "NVIDIA H100"
    assert picture.where(kept["processor"]) == "EPYC, 2 cores, no graphics card"


def test_names_in_a_chart_lie_on_no_other_name_or_dot() -> None:
    figure, axes = plt.subplots(figsize=(4.3, 4.1), dpi=100)
    crowded = [point(f"setting {n}", 5 + 0.02 * n, 80 + 0.3 * n) for n in range(6)]
    axes.set(xlim=(1, 100), ylim=(10, 95), xscale="log")
    figure.canvas.draw()
    picture.name(axes, crowded, crowded)
    figure.canvas.draw()
    assert {text.get_text() for text in axes.texts} == set(names(crowded))
    boxes = [Text.get_window_extent(text) for text in axes.texts]
    for box in boxes:
        assert box.count_overlaps(boxes) == 1  # itself
        assert axes.bbox.fully_containsx(box.x0) and axes.bbox.fully_containsx(box.x1)
        for p in crowded:
            assert not box.contains(*axes.transData.transform((p.ms, p.psnr)))
    plt.close(figure)
