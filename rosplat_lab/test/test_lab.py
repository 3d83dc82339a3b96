"""The laboratory's maths: blending models against closed forms, orders, the front."""

import time
from argparse import Namespace
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from multiprocessing import active_children

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.text import Text

from rosplat_core import depth, rendering
from rosplat_core.cameras import Camera, look_at
from rosplat_core.posed_camera import PosedCamera
from rosplat_core.splats import SceneError, Splats, concatenate
from rosplat_core.view import SortView
from rosplat_lab import reference
from rosplat_lab.lab import charts, command, fragments, motion, orders, rays, viewers
from rosplat_lab.lab.fragments import Fragments
from rosplat_lab.lab.pareto import front, summarise
from rosplat_lab.lab.points import Point, Store, load, save, scene_key
from rosplat_lab.lab.workers import Workers
from rosplat_sorter.map import SplatMap

Make = Callable[..., Splats]

CAMERA = Camera(0, 64, 48, 60, 60, 32, 24, look_at((3, 2, 1), (0, 0, 0)))


def pixel(*layers: tuple[float, float, float]) -> Fragments:
    """Fragments of one pixel, nearest first: alpha, grey level and depth of each."""
    alphas, greys, depths = np.array(layers, np.float64).reshape(-1, 3).T
    return Fragments(
        np.zeros(len(layers), np.intp), alphas, np.repeat(greys[:, None], 3, axis=1), depths, 2
    )


def view_and_map(splats: Splats, camera: Camera) -> tuple[SortView, SplatMap]:
    """What sorters get."""
    x, y, z = camera.position
    seen = PosedCamera(
        (x, y, z), tuple(camera.orientation), camera.fx, camera.fy, camera.cx, camera.cy,
        camera.width, camera.height, camera.near, camera.far,
    )  # fmt: skip
    known = SplatMap()
    rendering.insert(known, splats, slice(0, len(splats)), 1)
    return SortView.of(seen, known.frames), known


# --- Blending -------------------------------------------------------------------------------------


def test_the_exact_model_is_the_reference_renderer(
    random_splats: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    splats = random_splats(300)
    expected = reference.render(splats, CAMERA).rgba[..., :3]
    assert expected.max() > 0.5
    np.testing.assert_allclose(
        fragments.picture(splats, CAMERA, fragments.over), expected, atol=1e-9
    )
    monkeypatch.setattr(fragments, "BAND_FRAGMENTS", 500)  # many bands
    np.testing.assert_allclose(
        fragments.picture(splats, CAMERA, fragments.over), expected, atol=1e-9
    )


def test_every_model_draws_one_layer_exactly() -> None:
    """Where there is nothing to sort, all must agree; stochastic transparency does on average."""
    layer = pixel((0.6, 0.5, 2.0))
    expected = fragments.over(layer)
    np.testing.assert_allclose(expected, [[0.3] * 3, [0] * 3])
    for blend in (fragments.over_by_pixel, fragments.weighted_oit):
        np.testing.assert_allclose(blend(layer), expected)
    np.testing.assert_allclose(fragments.rounded(255)(layer), expected, atol=0.5 / 255)
    np.testing.assert_allclose(fragments.stochastic(20_000)(layer), expected, atol=0.01)


def test_weighted_blending_ignores_the_order_that_fragments_come_in() -> None:
    layers = [(0.6, 0.9, 1.0), (0.3, 0.1, 2.0), (0.8, 0.5, 3.0)]
    forwards, backwards = pixel(*layers), pixel(*layers[::-1])
    np.testing.assert_allclose(
        fragments.weighted_oit(forwards), fragments.weighted_oit(backwards), rtol=1e-12
    )
    assert abs(fragments.over(forwards) - fragments.over(backwards)).max() > 0.05


def test_a_pixel_sorts_by_the_depths_of_its_fragments() -> None:
    shuffled = pixel((0.5, 0.2, 3.0), (0.5, 0.8, 1.0))
    np.testing.assert_allclose(fragments.over_by_pixel(shuffled)[0], 0.5 * 0.8 + 0.25 * 0.2)


def test_stochastic_transparency_keeps_the_nearest_winner() -> None:
    """Expected value and variance of three layers: Bernoulli samples of the exact weights."""
    layers = pixel((0.5, 1.0, 1.0), (0.5, 0.5, 2.0), (0.5, 0.0, 3.0))
    values = [fragments.stochastic(16, seed)(layers)[0, 0] for seed in range(4000)]
    exact = fragments.over(layers)[0, 0]
    assert np.mean(values) == pytest.approx(exact, abs=0.01)
    square = 0.5 * 1 + 0.25 * 0.25
    assert np.var(values) == pytest.approx((square - exact**2) / 16, rel=0.1)


def test_eight_bits_round_faint_layers_to_nothing() -> None:
    """A fog of a thousand layers that add less than half a level each, back to front or not."""
    fog = pixel(*[(1 / 255, 0.4, float(z)) for z in range(1000)])
    assert fragments.over(fog)[0, 0] == pytest.approx(0.4 * (1 - (254 / 255) ** 1000))
    for front_to_back in (False, True):
        assert fragments.rounded(255, front_to_back=front_to_back)(fog)[0, 0] == 0
    assert fragments.rounded(65535)(fog)[0, 0] == pytest.approx(0.4, abs=0.02)


def test_a_cut_off_ends_quads_early(random_splats: Make) -> None:
    splats = random_splats(100)
    whole = fragments.picture(splats, CAMERA, fragments.over)
    same = fragments.picture(splats, CAMERA, fragments.over, cutoff_sigmas=3.34)
    np.testing.assert_array_equal(whole, same)  # alpha is below 1/255 there
    cut = fragments.picture(splats, CAMERA, fragments.over, cutoff_sigmas=1.0)
    assert cut.sum() < 0.9 * whole.sum()


def test_samples_differ_only_where_quads_end(random_splats: Make) -> None:
    """There a fragment is as faint as 1/255, so a layer can't change by more than a quarter of it
    for each sample outside."""
    one = random_splats(1)
    one = replace(one, positions=np.zeros((1, 3), np.float32), scales=0.3 * one.scales**0)
    whole = fragments.picture(one, CAMERA, fragments.over)
    sampled = fragments.multisampled(one, CAMERA)
    assert 0 < np.abs(sampled - whole).max() <= whole.max() / 255 * 1.5


# --- Other viewers --------------------------------------------------------------------------------


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
    camera = replace(CAMERA, world_to_camera=np.eye(4))
    assert not viewers.rvizsplat(ball(opacities=np.full(1, 0.39, np.float32)), camera).any()
    seen = viewers.rvizsplat(ball(), camera)[24, :, 0]
    assert seen.max() == pytest.approx(0.9, abs=0.02)
    assert seen[seen > 0].min() >= 0.05 - 0.5 / 255


def test_shadygm_s_brightens_before_it_blends() -> None:
    camera = replace(CAMERA, world_to_camera=np.eye(4))
    grey = ball(sh=np.full((1, 1, 3), (0.25 - 0.5) / 0.28209479, np.float32))
    bright, plain = viewers.shadygm(grey, camera), viewers.shadygm(grey, camera, gamma=1.0)
    assert bright.max() / plain.max() == pytest.approx(0.25 ** (1 / 2.2) / 0.25, rel=0.02)


def test_rays_meet_round_splats_beside_their_middle() -> None:
    """Of a ball, a ray reaches most at the foot of the perpendicular from its centre."""
    ball = Splats(
        positions=np.array([[0.3, 0.0, 2.0]], np.float32),
        orientations=np.array([[0, 0, 0, 1]], np.float32),
        scales=np.full((1, 3), 0.2, np.float32),
        opacities=np.ones(1, np.float32),
        sh=np.zeros((1, 1, 3), np.float32),
    )
    camera = replace(CAMERA, world_to_camera=np.eye(4))
    found: list[Fragments] = []
    fragments.picture(
        ball, camera, lambda band: found.append(band) or fragments.over(band), ray_depths=True
    )
    [band] = found
    y, x = np.divmod(band.pixels, camera.width)
    rays = np.column_stack([(x + 0.5 - 32) / 60, (y + 0.5 - 24) / 60, np.ones(len(x))])
    feet = (rays @ [0.3, 0.0, 2.0]) / (rays**2).sum(axis=1)
    np.testing.assert_allclose(band.depths, feet, rtol=1e-6)


def test_rays_agree_with_ellipses_where_the_projection_is_all_but_linear(
    random_splats: Make,
) -> None:
    """Small in angle, large in pixels: what is left of the difference is the 0.3 px² low-pass."""
    splats = random_splats(40, 0)
    splats.scales[:] = np.clip(splats.scales, 0.2, 0.4)
    errors = []
    for distance in (4.0, 100.0):
        camera = replace(
            CAMERA,
            fx=60.0 * distance, fy=60.0 * distance, near=0.1,
            world_to_camera=look_at((distance, 0.1, 0.2), (0, 0, 0)),
        )  # fmt: skip
        expected = fragments.picture(splats, camera, fragments.over)
        errors.append(np.abs(rays.picture(splats, camera) - expected).mean())
    assert errors[1] < 0.1 * errors[0]
    assert errors[1] < 1e-3


def test_a_ray_meets_a_ball_in_closed_form() -> None:
    ball = Splats(
        positions=np.array([[0.0, 0.0, 2.0]], np.float32),
        orientations=np.array([[0, 0, 0, 1]], np.float32),
        scales=np.full((1, 3), 0.5, np.float32),
        opacities=np.array([0.8], np.float32),
        sh=np.zeros((1, 1, 3), np.float32),
    )
    camera = replace(CAMERA, world_to_camera=np.eye(4), fx=20.0, fy=20.0)
    tangent = (np.arange(64) + 0.5 - 32) / 20
    height = (24 + 0.5 - 24) / 20
    across = np.sin(np.arctan(np.hypot(tangent, height))) * 2.0  # from the centre to the ray [m]
    alpha = np.float32(0.8) * np.exp(-0.5 * (across / 0.5) ** 2)
    alpha[alpha < 1 / 255] = 0
    np.testing.assert_allclose(rays.picture(ball, camera)[24, :, 0], 0.5 * alpha, atol=1e-6)


# --- Orders ---------------------------------------------------------------------------------------


def test_keys_of_all_bits_are_the_exact_order(random_splats: Make) -> None:
    splats = random_splats(500)
    view, known = view_and_map(splats, CAMERA)
    expected = depth.order(view, known.positions, known.extents)
    assert len(expected) > 100
    np.testing.assert_array_equal(orders.keyed(view, known, orders.full), expected)


@pytest.mark.parametrize("kind", [orders.linear, orders.truncated, orders.equalised])
def test_coarse_keys_never_turn_depths_round_and_use_their_bits(kind: Callable) -> None:  # type: ignore[type-arg]
    depths = np.sort(np.random.default_rng(0).lognormal(sigma=1.5, size=5000)).astype(np.float32)
    fewer = 0
    for bits in (4, 8, 12, 16):
        keys = kind(bits)(depths)
        assert keys.dtype == np.uint32
        assert (np.diff(keys.astype(np.int64)) >= 0).all()
        assert keys.max() < 2**bits
        assert len(np.unique(keys)) > fewer
        fewer = len(np.unique(keys))


def test_adaptive_keys_survive_an_outlier_that_starves_linear_ones() -> None:
    depths = np.append(np.linspace(1, 2, 10_000), 1e6).astype(np.float32)
    assert len(np.unique(orders.linear(12)(depths))) == 2
    assert len(np.unique(orders.equalised(12)(depths))) > 2000


def test_the_radix_argsort_is_stable() -> None:
    rng = np.random.default_rng(0)
    for top in (7, 1 << 16, 1 << 20, 1 << 32):
        keys = rng.integers(0, top, 3000, dtype=np.uint64).astype(np.uint32)
        np.testing.assert_array_equal(orders.radix_argsort(keys), np.argsort(keys, kind="stable"))


def inversions(order: np.ndarray, exact: np.ndarray) -> float:  # type: ignore[type-arg]
    """Share of random pairs of the slots in both orders that one draws the other way round."""
    rank = np.full(int(max(order.max(), exact.max())) + 1, -1)
    rank[exact] = np.arange(len(exact))
    ranks = rank[order]
    ranks = ranks[ranks >= 0]
    first, second = np.random.default_rng(0).integers(0, len(ranks), (2, 1_000_000))
    swapped = (first < second) != (ranks[first] < ranks[second])
    return float(np.mean(swapped[first != second]))


def test_an_order_no_frames_old_is_the_fresh_one_and_turning_alone_changes_it(
    random_splats: Make,
) -> None:
    """The order by z depends on where the camera looks, not on where it is."""
    splats = random_splats(500)

    def exact(camera: Camera) -> np.ndarray:  # type: ignore[type-arg]
        view, known = view_and_map(splats, camera)
        return depth.order(view, known.positions, known.extents)

    fresh = exact(CAMERA)
    for kind in ("rotation", "orbit", "dolly"):
        now = motion.before(CAMERA, kind, 1.0, 0.0, (0, 0, 0))
        np.testing.assert_array_equal(exact(now), fresh)
    assert inversions(exact(motion.before(CAMERA, "dolly", 1, 0.1, (0, 0, 0))), fresh) == 0
    turned = [
        inversions(exact(motion.before(CAMERA, "orbit", 1, seconds, (0, 0, 0))), fresh)
        for seconds in (0.05, 0.1, 0.2)
    ]
    assert 0 < turned[0] < turned[1] < turned[2] < 0.5


def test_a_budget_keeps_the_worthiest_back_to_front() -> None:
    order = np.array([7, 3, 9, 1], np.uint32)
    worth = np.array([0.1, 5, 3, 0.2], np.float32)
    np.testing.assert_array_equal(orders.budget(order, worth, 0.5), [3, 9])
    np.testing.assert_array_equal(orders.budget(order, worth, 1.0), order)
    np.testing.assert_array_equal(orders.at_least(order, worth, 0.2), [3, 9, 1])


def test_cameras_turn_to_their_right_and_orbit_at_a_distance() -> None:
    eye = np.eye(4)
    straight = replace(CAMERA, world_to_camera=eye)
    right = motion.turned(straight, 0.1)
    assert right.camera_to_world[:3, 2] == pytest.approx([np.sin(0.1), 0, np.cos(0.1)])
    assert right.position == pytest.approx([0, 0, 0])
    target = np.array([0, 0, 5.0])
    around = motion.turned(straight, 0.1, target)
    assert np.linalg.norm(around.position - target) == pytest.approx(5)
    assert around.world_to_camera[:3, :3] @ target + around.world_to_camera[:3, 3] == pytest.approx(
        target
    )
    assert motion.before(straight, "dolly", 1.0, 0.5, target).position == pytest.approx(
        [0, 0, -2.5]
    )


@pytest.mark.parametrize("up", [(1e300, 1e300, 0), (1e-300, 1e-300, 0)])
def test_a_vertical_may_be_of_any_length(up: tuple[float, ...]) -> None:
    plain, long = (
        command.load("procedural:50", Namespace(up=one, cameras=2, width=64, height=48))
        for one in ((1, 1, 0), up)
    )
    for one, other in zip(plain.cameras, long.cameras, strict=True):
        np.testing.assert_allclose(one.world_to_camera, other.world_to_camera, atol=1e-12)


# --- What comes of it -----------------------------------------------------------------------------


def point(method: str, ms: float | None, psnr: float, **changes: object) -> Point:
    """A point with nothing special about the rest."""
    fields = {
        "key": f"{method} {ms} {psnr}", "method": method, "family": "f", "aside": "",
        "scene": "s", "camera": 0, "splats": 1, "sort_ms": None if ms is None else 0.25 * ms,
        "draw_ms": None if ms is None else 0.75 * ms,
        "pose_ms": None if ms is None else 3 * ms, "psnr": psnr, "ssim": 1.0, "flip": 1 / psnr,
        "worst": 0.1, "machine": "m", "gpu": "g", "commit": "c", "command": "lab",
    }  # fmt: skip
    return Point(**(fields | changes))  # type: ignore[arg-type]


def test_the_front_by_hand() -> None:
    """b is beaten by a in both, d has no time, e is as good as c but slower."""
    points = [
        point("a", 10, 40), point("b", 12, 39), point("c", 20, 60), point("d", None, 99),
        point("e", 21, 60), point("f", 5, 20),
    ]  # fmt: skip
    summaries = summarise(points)
    for metric in ("psnr", "flip"):
        assert [s.method for s in front(summaries, metric)] == ["f", "a", "c"]


def test_what_is_to_be_seen_aside_beats_nobody() -> None:
    points = [point("a", 10, 40), point("late", 1, 90, aside="under motion")]
    assert [s.method for s in front(summarise(points))] == ["a"]


def test_what_was_seen_in_fewer_views_beats_nobody() -> None:
    """A method that was measured in the easy scene alone is not the better one."""
    points = [point("a", 10, 40), point("a", 100, 30, scene="large"), point("easy", 9, 41)]
    assert [s.method for s in front(summarise(points))] == ["a"]


def test_a_front_may_be_of_the_time_from_pose_to_draw() -> None:
    points = [point("a", 10, 40), point("b", 5, 30, pose_ms=100.0), point("c", 20, 60)]
    summaries = summarise(points)
    assert [s.method for s in front(summaries)] == ["b", "a", "c"]
    assert [s.method for s in front(summaries, time="pose_ms")] == ["a", "c"]


def test_a_summary_is_the_median_over_cameras() -> None:
    points = [point("a", ms, psnr) for ms, psnr in ((1, 30), (3, 50), (100, 40))]
    [summary] = summarise(points)
    assert summary.count == 3
    assert summary.ms is not None and summary.ms[1] == pytest.approx(3)
    assert summary.values["psnr"][1] == 40


def test_names_in_a_chart_lie_on_no_other_name_or_dot() -> None:
    figure, axes = plt.subplots(figsize=(4.3, 4.1), dpi=100)
    crowded = summarise(
        point(f"method {n}", 5 + 0.02 * n, 80 + 0.3 * n, family="blend") for n in range(6)
    )
    axes.set(xlim=(1, 100), ylim=(10, 95), xscale="log")
    figure.canvas.draw()
    charts._name(axes, crowded, crowded)
    figure.canvas.draw()
    assert {text.get_text() for text in axes.texts} == {s.method for s in crowded}
    boxes = [Text.get_window_extent(text) for text in axes.texts]
    for box in boxes:
        assert box.count_overlaps(boxes) == 1  # itself
        assert axes.bbox.fully_containsx(box.x0) and axes.bbox.fully_containsx(box.x1)
        for summary in crowded:
            assert summary.ms
            dot = axes.transData.transform((summary.ms[1], summary.values["psnr"][1]))
            assert not box.contains(*dot)
    plt.close(figure)


def test_points_are_read_as_they_were_written(tmp_path) -> None:  # type: ignore[no-untyped-def]
    kept = [point("a", 1, 40), point("b", None, 30.25), point("a", 2, 50, machine="another")]
    save(tmp_path / "lab.json", kept)
    assert load(tmp_path / "lab.json") == [replace(p, flip=float(f"{p.flip:.5g}")) for p in kept]


def test_other_files_are_no_points(tmp_path) -> None:  # type: ignore[no-untyped-def]
    texts = {
        "": "Expecting value",
        "[1, 2]": "no object with runs",
        '{"runs": [], "points": []}': "no points",
        '{"runs": [], "points": [{"run": 3}]}': "out of range",
        '{"runs": [{}], "points": [{"run": 0, "psnr": 3}]}': "point 0 lacks, .* splats",
    }
    for text, why in texts.items():
        (tmp_path / "lab.json").write_text(text)
        with pytest.raises(SceneError, match=f"lab.json: not what lab writes: .*{why}"):
            load(tmp_path / "lab.json")


def test_workers_end_at_once_where_the_block_is_left_by_an_exception() -> None:
    with pytest.raises(KeyboardInterrupt), Workers() as workers:
        next(workers.run([partial(int, 1), partial(time.sleep, 1e6)]))
        raise KeyboardInterrupt
    assert not active_children()


def test_an_interrupted_run_is_taken_up(tmp_path) -> None:  # type: ignore[no-untyped-def]
    store = Store(tmp_path)
    store.add(point("a", 1, 40))
    with (tmp_path / "points.jsonl").open("a") as file:
        file.write('{"key": "cut off')
    again = Store(tmp_path)
    assert again.get(point("a", 1, 40).key) == point("a", 1, 40)
    assert again.get("cut off") is None
    again.add(point("b", 2, 50))
    assert Store(tmp_path).get(point("b", 2, 50).key) == point("b", 2, 50)


def test_results_are_kept_by_all_that_a_scene_holds(random_splats: Make) -> None:
    splats = random_splats(10)
    changed = [
        replace(splats, **{name: 1 - np.asarray(value)})
        for name, value in vars(splats).items()
        if name not in ("antialiased", "channels")
    ]
    changed.append(replace(splats, antialiased=True))
    labelled = replace(splats, channels={"label": np.zeros(10, np.float32)})
    assert scene_key(splats) == scene_key(random_splats(10)) == scene_key(labelled)
    assert len({scene_key(which) for which in (splats, *changed)}) == 1 + len(changed)


def test_splats_join_for_typical_bounds(random_splats: Make) -> None:
    """One stray splat doesn't move the cameras away."""
    splats = random_splats(300)
    stray = replace(splats[:1], positions=np.full((1, 3), 1e4, np.float32))
    np.testing.assert_allclose(
        motion.typical_bounds(concatenate([splats, stray])), motion.typical_bounds(splats), atol=0.1
    )
