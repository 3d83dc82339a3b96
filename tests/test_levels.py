"""The levels of detail that the plugin merges, against their float64 twin."""

from __future__ import annotations

import merged_levels as levels
import numpy as np
import pytest

from drawing import CAMERAS, decibels, draw
from rosplat_core.quaternions import to_matrices
from rosplat_core.rendering import CpuRenderer, insert_all
from rosplat_core.splats import Splats
from rosplat_lab import reference


@pytest.fixture(scope="module")
def splats() -> Splats:
    """Neighbours of all sizes and opacities, with harmonics of degree 2."""
    random = np.random.default_rng(7)
    count = 4000
    orientations = random.normal(size=(count, 4))
    scales = 0.05 * np.exp(random.uniform(-3, 0, size=(count, 3)))
    # None so near to where the next level begins that packing could put it there.
    octaves = np.log2(scales.max(axis=1))
    scales[np.abs(octaves - np.rint(octaves)) < 1e-3] *= 1.1
    positions = random.normal(scale=0.5, size=(count, 3))
    # One enters by its distance, at a level that reaches further than the level before.
    positions[0], scales[0] = (-1500, 40, -3), 0.001
    return Splats(
        positions=positions,
        orientations=orientations / np.linalg.norm(orientations, axis=1, keepdims=True),
        scales=scales,
        opacities=random.uniform(0, 1, count),
        sh=random.normal(scale=0.5, size=(count, 9, 3)),
    )


@pytest.fixture(scope="module")
def merged(splats: Splats) -> list[levels.Nodes]:
    return levels.merge(splats)


@pytest.fixture
def renderer(splats: Splats) -> CpuRenderer:
    renderer = CpuRenderer(threads=2)
    insert_all(renderer, splats)
    return renderer


def test_nodes_are_those_of_the_twin(renderer: CpuRenderer, merged: list[levels.Nodes]) -> None:
    assert renderer.merge() == sum(map(len, merged))
    for level, expected in enumerate(merged):
        nodes = renderer.nodes(level)
        assert nodes["size"] == expected.size
        cells = np.rint(nodes["corners"] / nodes["size"]).astype(np.int64)
        by_row = np.lexsort(cells.T[::-1])
        np.testing.assert_array_equal(cells[by_row], expected.cells)
        nodes = {name: values[by_row] for name, values in nodes.items() if name != "size"}
        # What packing rounds, level by level: scales by 3e-4, harmonics by 1e-3 of the largest.
        away = np.abs(nodes["positions"] - expected.means).max(axis=1)
        assert (away <= 2e-3 * expected.size).all()
        axes = to_matrices(nodes["orientations"])
        axes *= nodes["scales"][:, None, :]
        covariances = axes @ axes.transpose(0, 2, 1)
        widths = np.trace(expected.covariances, axis1=1, axis2=2)
        wrong = np.abs(covariances - expected.covariances).max(axis=(1, 2))
        assert (wrong <= 1e-2 * widths).all()
        most = np.minimum(expected.opacities, 16)
        assert (np.abs(nodes["opacities"] - most) <= 1e-2 * most + 1e-3).all()
        assert (np.abs(nodes["sh"] - expected.sh).max(axis=(1, 2)) <= 2e-2).all()
    assert len(renderer.nodes(len(merged))["positions"]) == 0
    assert len(merged[0]) < len(merged[8]) > len(merged[-1])  # there was something to merge


@pytest.mark.parametrize("error", [50.0, 80.0, 120.0])
@pytest.mark.parametrize("view", CAMERAS)
def test_a_cut_is_that_of_the_twin(
    renderer: CpuRenderer, splats: Splats, merged: list[levels.Nodes], view: str, error: float
) -> None:
    camera = CAMERAS[view]
    renderer.settings.detail = f"{error}px"
    drawn = draw(renderer, camera)
    some, shares = levels.cut(splats, merged, camera, error)
    expected = reference.render(some, camera, shares=shares)
    assert decibels(drawn["colour"], expected.rgba) >= 55
    full = reference.render(splats, camera)
    assert decibels(drawn["colour"], full.rgba) < 50  # nodes were drawn


@pytest.mark.parametrize("most", [700, 2500])
def test_a_budget_of_a_picture_that_is_waited_for_is_not_spent_on_blending(
    renderer: CpuRenderer, splats: Splats, merged: list[levels.Nodes], most: int
) -> None:
    camera = CAMERAS["outside"]
    renderer.settings.detail = str(most)
    drawn = draw(renderer, camera)
    some, shares = levels.cut(splats, merged, camera, drawn["error"], blends=False)
    assert (shares == 1).all()
    expected = reference.render(some, camera, shares=shares)
    assert decibels(drawn["colour"], expected.rgba) >= 55


@pytest.mark.parametrize("most", [50, 700, 2500])
def test_a_budget_is_kept(renderer: CpuRenderer, most: int) -> None:
    renderer.settings.detail = str(most)
    drawn = draw(renderer, CAMERAS["outside"])
    assert 0.9 * most - 8 <= drawn["splats"] <= most  # a cell's splats come and go together
    assert drawn["error"] > 0
    renderer.settings.detail = "full"
    assert draw(renderer, CAMERAS["outside"])["error"] == 0


def test_a_budget_that_is_less_than_the_coarsest_is_said(renderer: CpuRenderer) -> None:
    renderer.settings.detail = "1"
    drawn = draw(renderer, CAMERAS["outside"])
    assert drawn["detail_error"] == f"no fewer than {drawn['splats']} splats can be drawn"
    renderer.settings.detail = "50"
    assert draw(renderer, CAMERAS["outside"])["detail_error"] == ""


@pytest.mark.parametrize("error", [0.3, 1.0, 3.0, 10.0, 30.0])
@pytest.mark.parametrize("view", CAMERAS)
def test_no_error_draws_more_than_there_is(renderer: CpuRenderer, view: str, error: float) -> None:
    full = draw(renderer, CAMERAS[view])
    renderer.settings.detail = f"{error}px"
    assert draw(renderer, CAMERAS[view])["splats"] <= full["splats"]


def test_a_detail_that_is_none_is_refused(renderer: CpuRenderer) -> None:
    with pytest.raises(ValueError, match="detail '3 furlongs' is none"):
        renderer.settings.detail = "3 furlongs"
