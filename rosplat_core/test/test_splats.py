"""The in-memory map: its checks, its cuts and joins, and the origin that keeps it precise."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rosplat_core
from rosplat_core.models import Model
from rosplat_core.quaternions import to_matrices
from rosplat_core.splats import Splats, concatenate, rebase
from rosplat_core.view import frame_at

Make = Callable[..., Splats]


def splats(n: int, degree: int = 1, **changes: Any) -> Splats:
    rng = np.random.default_rng(n)
    arrays: dict[str, Any] = {
        "positions": rng.normal(size=(n, 3)),
        "orientations": np.tile([0.0, 0.0, 0.0, 1.0], (n, 1)),
        "scales": rng.uniform(0.01, 0.1, (n, 3)),
        "opacities": rng.uniform(0, 1, n),
        "sh": rng.normal(size=(n, (degree + 1) ** 2, 3)),
    }
    return Splats(**(arrays | changes))


def test_arrays_become_contiguous_float32() -> None:
    some = splats(5)
    for array in (some.positions, some.orientations, some.scales, some.opacities, some.sh):
        assert array.dtype == np.float32
        assert array.flags.c_contiguous
    assert some.origin.dtype == np.float64


@pytest.mark.parametrize(
    ("name", "shape"),
    [("orientations", (5, 3)), ("scales", (4, 3)), ("opacities", (5, 1)), ("sh", (5, 2, 3))],
)
def test_a_wrong_shape_is_refused_by_name(name: str, shape: tuple[int, ...]) -> None:
    wrong: dict[str, Any] = {name: np.zeros(shape)}
    with pytest.raises(ValueError, match=name):
        splats(5, **wrong)


@pytest.mark.parametrize("wrong", [np.nan, np.inf])
def test_an_origin_that_is_not_finite_is_refused(wrong: float) -> None:
    """Receivers refuse a batch with one: the publisher's map would be nowhere."""
    with pytest.raises(ValueError, match="origin: not finite"):
        splats(5, origin=np.array([0, wrong, 0]))
    pose = np.eye(4)
    pose[0, 3] = wrong
    with pytest.raises(ValueError, match="pose: expected 4x4 finite numbers"):
        splats(5).moved(pose)


@pytest.mark.filterwarnings("error")
def test_positions_at_the_end_of_float64_have_an_origin() -> None:
    positions = np.array([[1.7e308, 0, 0], [-1.7e308, 0, 0], [1.7e308, 1, 1], [5e6, 0, 0]])
    some = splats(4, positions=positions)
    np.testing.assert_array_equal(some.origin, [5e6, 0, 0])
    assert not np.isfinite(some.positions[:3]).all(axis=1).any()


def test_slices_masks_and_indices_pick_the_same_splats() -> None:
    some = splats(10)
    mask = np.zeros(10, bool)
    mask[3:6] = True
    for picked in (some[3:6], some[np.array([3, 4, 5])], some[mask]):
        np.testing.assert_array_equal(picked.sh, some.sh[3:6])
        np.testing.assert_array_equal(picked.positions, some.positions[3:6])


@pytest.mark.parametrize("used", [0, 1, 2, 3])
def test_only_empty_top_bands_go(used: int) -> None:
    some = splats(4, used).with_sh_degree(3)
    assert some.sh_degree == 3
    slim = some.without_empty_bands()
    assert slim.sh_degree == used
    np.testing.assert_array_equal(slim.with_sh_degree(3).sh, some.sh)


def test_far_positions_keep_their_millimetres() -> None:
    positions = np.array([4.5e6, 5e5, 100.0]) + np.random.default_rng(0).uniform(-50, 50, (100, 3))
    near, origin = rebase(positions)
    np.testing.assert_allclose(near + origin, positions, atol=1e-5, rtol=0)
    np.testing.assert_array_equal(origin, np.round(origin))


def test_a_stray_position_costs_the_others_nothing() -> None:
    positions = np.random.default_rng(0).uniform(-5, 5, (100, 3))
    positions[7] = 1e30
    near, origin = rebase(positions)
    np.testing.assert_allclose((near + origin)[:7], positions[:7], atol=1e-6, rtol=0)


def test_positions_that_are_none_cost_the_others_nothing() -> None:
    positions = np.array([4.5e6, 5e5, 100.0]) + np.random.default_rng(0).uniform(-50, 50, (100, 3))
    positions[7, 1], positions[8, 0] = np.nan, -np.inf
    near, origin = rebase(positions)
    np.testing.assert_allclose((near + origin)[9:], positions[9:], atol=1e-5, rtol=0)


def test_a_far_map_that_grows_keeps_its_origin() -> None:
    positions = np.array([4.5e6, 5e5, 100.0]) + np.random.default_rng(0).uniform(-9, 9, (100, 3))
    grown = np.concatenate([positions, positions[:30] + np.array([20, 0, 0])])
    np.testing.assert_array_equal(rebase(positions)[1], rebase(grown)[1])


def test_far_positions_need_nobody_to_rebase_them() -> None:
    some = splats(4, 0)
    far = np.array([4.5e6, 5e5, 100.0])
    at = some.positions.astype(np.float64) + far
    moved = replace(some, positions=at)
    np.testing.assert_allclose(moved.positions + moved.origin, at, atol=1e-5, rtol=0)
    whole = np.round(at).astype(np.int64)
    moved = replace(some, positions=whole)
    np.testing.assert_allclose(moved.positions + moved.origin, whole, atol=1e-5, rtol=0)
    # Those that are relative to an origin stay so.
    again = replace(some, positions=at, origin=far)
    np.testing.assert_allclose(again.positions + again.origin, at + far, atol=1e-5, rtol=0)


def test_near_positions_need_no_origin() -> None:
    assert not rebase(np.full((3, 3), 20.0))[1].any()


def test_concatenate_keeps_world_positions_and_bands() -> None:
    a, b = splats(3, 0, origin=np.array([1e6, 0, 0])), splats(4, 2, origin=np.array([1e6, 5, 0]))
    both = concatenate([a, b])
    assert (len(both), both.sh_degree) == (7, 2)
    np.testing.assert_allclose(
        both.positions[3:] + both.origin, b.positions + b.origin, atol=1e-6, rtol=0
    )
    assert not both.sh[:3, 1:].any()


def test_concatenate_loses_nothing_of_a_far_part_behind_a_near_one() -> None:
    far = splats(9, positions=np.random.default_rng(0).random((9, 3)), origin=[1e6, 0, 0])
    both = concatenate([splats(1), far])
    np.testing.assert_allclose(
        both.positions[1:] + both.origin, far.positions + far.origin, atol=1e-6, rtol=0
    )
    np.testing.assert_array_equal(concatenate([far, far]).positions[9:], far.positions)


def test_concatenate_refuses_mixed_filters() -> None:
    with pytest.raises(ValueError, match="ewa and ray"):
        concatenate([splats(1), splats(1, model=Model.RAY)])


def test_channels_go_along_and_are_checked() -> None:
    some = splats(4, channels={"label": [1, 2, 3, 4], "seen": np.arange(4) / 2})
    np.testing.assert_array_equal(some[[3, 1]].channels["label"], [4, 2])
    both = concatenate([some, splats(2, channels={"keyframe": [7, 8]})])
    assert list(both.channels) == ["label", "seen", "keyframe"]
    np.testing.assert_array_equal(both.channels["keyframe"], [np.nan] * 4 + [7, 8])
    np.testing.assert_array_equal(both.channels["seen"][3:], [1.5, np.nan, np.nan])
    assert some.nbytes == splats(4).nbytes + 4 * 4 * 2
    for wrong, reason in (
        ({"label": [1, 2, 3]}, "channels"),
        ({"a b": [0] * 4}, "'a b'"),
        ({str(i): [0] * 4 for i in range(9)}, "at most 8"),
    ):
        with pytest.raises(ValueError, match=reason):
            splats(4, channels=wrong)


def test_what_trainers_optimise_becomes_what_is_drawn() -> None:
    some = splats(7, 2)
    with np.errstate(divide="ignore"):
        trained = Splats.from_trained(
            some.positions,
            3 * some.orientations[:, [3, 0, 1, 2]],
            np.log(some.scales),
            np.log(some.opacities / (1 - some.opacities))[:, None],
            some.sh[:, :1],
            some.sh[:, 1:],
        )
    for name in ("positions", "orientations", "scales", "opacities", "sh"):
        np.testing.assert_allclose(getattr(trained, name), getattr(some, name), rtol=1e-5)


def test_spheres_without_harmonics_and_far_away() -> None:
    n = 4
    trained = Splats.from_trained(
        np.full((n, 3), 4.5e6) + np.arange(n)[:, None] * 1e-3,
        np.eye(4)[0] * np.ones((n, 1)),
        np.full((n, 1), np.log(0.02)),
        np.zeros(n),
        np.zeros((n, 1, 3)),
    )
    np.testing.assert_allclose(trained.scales, np.full((n, 3), 0.02), rtol=1e-6)
    np.testing.assert_array_equal(trained.orientations, np.tile([0, 0, 0, 1], (n, 1)))
    np.testing.assert_allclose(np.diff(trained.positions[:, 0]), 1e-3, rtol=1e-3)


def test_tensors_are_taken_as_they_are() -> None:
    torch = pytest.importorskip("torch")
    n = 3
    trained = Splats.from_trained(
        means := torch.rand((n, 3), requires_grad=True),
        torch.tensor([[1.0, 0, 0, 0]] * n, requires_grad=True),
        torch.zeros((n, 3), requires_grad=True),
        torch.zeros(n, requires_grad=True),
        torch.zeros((n, 1, 3), requires_grad=True),
    )
    np.testing.assert_array_equal(trained.positions, means.detach().numpy())
    np.testing.assert_array_equal(trained.opacities, np.full(n, 0.5, np.float32))


def test_what_a_trainer_drives_to_the_ends_is_taken_without_a_warning() -> None:
    ends = np.array([-1000, 1000], np.float32)
    trained = Splats.from_trained(
        np.zeros((2, 3)), np.eye(4)[[0, 0]], np.tile(ends[:, None], 3), ends, np.zeros((2, 1, 3))
    )
    np.testing.assert_array_equal(trained.opacities, [0, 1])
    np.testing.assert_array_equal(trained.scales[:, 0], [0, np.inf])


@pytest.mark.parametrize(
    ("name", "shape"),
    [
        ("means", (2, 4)),
        ("quaternions_wxyz", (2, 3)),
        ("log_scales", (2, 2)),
        ("logits", (3,)),
        ("sh0", (2, 3)),
        ("shN", (2, 45)),
        ("shN", (2, 5, 3)),
    ],
)
def test_another_shape_of_a_trainer_s_array_is_refused_by_name(
    name: str, shape: tuple[int, ...]
) -> None:
    shapes = {
        "means": (2, 3), "quaternions_wxyz": (2, 4), "log_scales": (2, 3), "logits": (2,),
        "sh0": (2, 1, 3), "shN": (2, 15, 3),
    }  # fmt: skip
    arrays = {key: np.ones(value) for key, value in (shapes | {name: shape}).items()}
    with pytest.raises(ValueError, match=rf"^{name}: expected shape .*, got"):
        Splats.from_trained(**arrays)


def test_splats_move_with_all_that_is_seen_of_them() -> None:
    random = np.random.default_rng(3)
    some = Splats(**(vars(splats(20, 3)) | {"origin": np.array([1e6, 2.0, 3.0])}))
    pose = frame_at(random.normal(size=3) * 10, random.normal(size=4))
    moved = some.moved(pose)
    rotation = pose[:3, :3]
    np.testing.assert_allclose(
        moved.positions + moved.origin,
        (some.positions + some.origin) @ rotation.T + pose[:3, 3],
        rtol=0,
        atol=1e-6,
    )
    for old, new in zip(some.orientations, moved.orientations, strict=True):
        np.testing.assert_allclose(to_matrices(new), rotation @ to_matrices(old), atol=1e-6)
    np.testing.assert_array_equal(moved.scales, some.scales)
    back = moved.moved(np.linalg.inv(pose))
    for name in ("positions", "sh", "origin"):
        np.testing.assert_allclose(getattr(back, name), getattr(some, name), atol=1e-5)


def test_a_map_is_told_in_a_line(random_splats: Make) -> None:
    splats = replace(
        random_splats(1200, 2, model=Model.RAY), origin=np.array([1e5, 0, 0]), up=(0, 0, 2.0),
        channels={"label": np.zeros(1200)},
    )  # fmt: skip
    splats.positions[3] = np.nan
    told = repr(splats)
    assert told.startswith("Splats(1,200 splats, SH degree 2, up 0 0 1, from 1e+05 -")
    assert told.endswith("m, model ray, channels label)")
    assert "nan" not in told
    assert repr(random_splats(0)) == "Splats(0 splats, SH degree 3)"


@pytest.mark.parametrize("up", [(0, 0, 0), (1, 2), (np.nan, 0, 1)])
def test_a_vertical_has_a_direction(random_splats: Make, up: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match=r"up: expected three numbers"):
        replace(random_splats(1), up=up)


def test_a_vertical_turns_with_the_splats(random_splats: Make) -> None:
    splats = replace(random_splats(3), up=(0, 0, 1))
    pose = np.eye(4)
    pose[:3, :3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]
    assert splats.moved(pose).up == (0, -1, 0)
    assert concatenate([splats, splats]).up == (0, 0, 1)
    assert concatenate([splats, splats.moved(pose)]).up is None


def test_a_trainer_s_parameters_are_named_once_each(
    random_splats: Make, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rosplat_core.splats, "_said", set())
    splats = random_splats(100)
    replace(splats, scales=np.where(np.arange(300).reshape(100, 3) < 50, -1, splats.scales))
    assert not caplog.records  # a few are no such thing
    for _ in range(2):
        replace(splats, scales=np.log(splats.scales))
        replace(splats, opacities=10 * splats.opacities - 5)
    assert [record.getMessage().split(";")[0] for record in caplog.records] == [
        "Splats: scales are negative: logarithms?",
        "Splats: opacities are not from 0 to 1: logits?",
    ]


def test_what_is_no_splats_is_told(tmp_path: Path) -> None:
    array, camera = np.zeros((3, 3)), rosplat_core.orbit(np.array([[0, 0, 0], [1, 1, 1]]), 1)[0]
    for call in (
        lambda: rosplat_core.render(array, camera),
        lambda: rosplat_core.CpuRenderer(array),
        lambda: rosplat_core.save(tmp_path / "a.ply", array),
        lambda: rosplat_core.simplify(array, max_splats=3),
    ):
        with pytest.raises(TypeError, match="splats: expected Splats, got ndarray"):
            call()
    with pytest.raises(TypeError, match="camera: expected Camera, got ndarray"):
        rosplat_core.CpuRenderer().render(array)
