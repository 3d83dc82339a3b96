"""What docs/stability.md claims, on the quick version of its cases."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

from rosplat_lab.lab.atlas import CASES
from rosplat_lab.lab.stability import NOTES

Curves = dict[str, list[float]]


@pytest.fixture(scope="module")
def curves(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Curves]:
    """Of each case by name."""
    folder = tmp_path_factory.mktemp("atlas")
    run = subprocess.run(
        [sys.executable, "-m", "rosplat_lab.lab", "--part", "atlas", "--quick",
         "--threads", "1", "--repeats", "1", "--out", str(folder)],
        capture_output=True, text=True, timeout=600, check=False,
    )  # fmt: skip
    assert run.returncode == 0, run.stderr
    text = (folder / "stability.md").read_text()
    findings = json.loads((folder / "stability.json").read_text())
    assert all(f"## {finding['title']}" in text for finding in findings)
    assert (folder / "stability.png").stat().st_size < 300_000
    return {finding["name"]: finding["curves"] for finding in findings}


def test_every_case_is_explained() -> None:
    assert list(CASES) and set(CASES) == set(NOTES)


@pytest.mark.parametrize(
    ("case", "curve"),
    [
        ("wide_view", "ours against EWA in float64"),
        ("inside", "ours, 32F"),
        ("shapes", "needles"),
        ("shapes", "discs"),
        ("huge", "one behind a cloud"),
        ("orthographic", "ours"),
        ("viewports", "ours, resized each time"),
        ("off_centre", "ours"),
        ("off_centre", "ours in squashed pixels, 1:4"),
        ("far_away", "rebased in float64 (ours)"),
        ("scaled", "scaled"),
        ("scaled", "scaled and mirrored"),
        ("sheared", "axes found anew"),
        ("outliers", "float32 (ours)"),
        ("depth_range", "float32 (ours)"),
        ("edits", "moved, merged (ours)"),
        ("layers", "RGBA32F"),
        ("faint", "ours against the reference"),
        ("overshoot", "clamped at 0 (ours)"),
    ],
)
def test_the_renderer_stays_with_the_reference(
    curves: dict[str, Curves], case: str, curve: str
) -> None:
    """65 dB is a mean error of a seventh of an 8-bit grey level, mostly of packed attributes."""
    assert min(curves[case][curve]) > 65


def test_what_is_known_to_fail_does(curves: dict[str, Curves]) -> None:
    """Else a case is no longer difficult, and its survivors prove nothing."""
    for case, curve in [
        ("wide_view", "EWA against exact rays"),
        ("zoomed_out", "as trained, +0.3 px²"),
        ("far_away", "float32 without an origin"),
        ("sheared", "means alone sheared"),
        ("outliers", "linear 16 bit"),
        ("depth_range", "linear 16 bit"),
        ("stale_turning", "culled for its view"),
        ("edits", "moved, old order"),
        ("overshoot", "clamped at 0 and 1 (model)"),
    ]:
        assert min(curves[case][curve]) < 30, f"{case}, {curve}"


def test_a_resized_picture_is_right_with_its_own_order(curves: dict[str, Curves]) -> None:
    """And lacks what the narrower view had culled with the order of that one."""
    own, other = curves["viewports"].values()
    assert min(own) > 65 and min(other) < 50


def test_ties_never_flicker_on_any_backend(curves: dict[str, Curves]) -> None:
    assert {"native", "numpy", "sorted by the renderer"} <= set(curves["ties"])
    assert all(differing == [0.0] for differing in curves["ties"].values())


def test_what_helps_helps(curves: dict[str, Curves]) -> None:
    assert min(curves["zoomed_out"]["Antialiasing on"]) > max(
        curves["zoomed_out"]["as trained, +0.3 px²"]
    )
    fading = curves["near_plane"]["flying through splats"]
    assert fading[0] > 2 * fading[-1]
    assert min(curves["outliers"]["adaptive 16 bit"]) > min(curves["outliers"]["linear 16 bit"])
    for case in ("stale_turning", "stale_orbit", "stale_dolly"):
        narrow, wide = (curves[case][name] for name in ("culled for its view", WIDEST))
        assert all(w >= n for n, w in zip(narrow, wide, strict=True))
        assert min(wide) > min(narrow) + 5


WIDEST = "for a view 2 times as wide"


def test_moving_without_turning_keeps_an_order_exact(curves: dict[str, Curves]) -> None:
    """As long as nothing that comes into view was culled: the last figure is of coming nearer."""
    still, *_, nearer = curves["stale_dolly"]["culled for its view"][1:]
    assert nearer == pytest.approx(still, abs=0.1)


def test_turning_leaves_orders_by_distance_alone(curves: dict[str, Curves]) -> None:
    assert max(curves["popping"]["by distance, by the order alone"]) == 0
    assert max(curves["popping"]["by z (ours), by the order alone"]) > 0.005


def test_opaque_layers_leak_a_hundredth_each(curves: dict[str, Curves]) -> None:
    ours, expected = curves["opaque"].values()
    ends_below = 1e-5  # what still shines through a pixel when tiles stop drawing it
    assert ours == pytest.approx(expected, rel=0.02, abs=ends_below)
