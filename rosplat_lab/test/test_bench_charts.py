"""Charts from records: every series is a line at the numbers that were measured."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from rosplat_lab.bench import charts
from rosplat_lab.bench.command import main
from rosplat_lab.bench.records import Circumstances, Measurement, Record, save

HERE = Circumstances("a box", "a card", "1.2", "abc", "bench", "2026-01-01T00:00:00Z", 0.5)


def record(name: str, splats: int, value: float, **parameters: Any) -> Record:
    measured = Measurement.of(
        name, "ms", [value, value, 2 * value], f"procedural:{splats}", splats, **parameters
    )
    return Record.of(parameters.pop("subject", "sort"), measured, HERE)


@pytest.fixture
def orders() -> list[Record]:
    return [
        record("order in host memory", splats, splats * scale, method=method, view=view)
        for view in ("all", "inside")
        for method, scale in (("native", 1e-5), ("numpy", 3e-5))
        for splats in (1_000_000, 100_000)
    ]


CHART = next(chart for chart in charts.CHARTS if chart.file == "sort-host")


def test_every_series_is_a_line_in_the_panel_of_its_view(orders: list[Record]) -> None:
    figure = charts.figure(CHART, orders)
    assert [ax.get_title() for ax in figure.axes] == ["all", "inside"]
    for ax in figure.axes:
        lines = {line.get_label(): line for line in ax.get_lines()}
        assert lines.keys() == {"native", "numpy"}
        np.testing.assert_allclose(lines["native"].get_xdata(), [100_000, 1_000_000])
        np.testing.assert_allclose(lines["native"].get_ydata(), [1, 10])
        np.testing.assert_allclose(lines["numpy"].get_ydata(), [3, 30])
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == ["native", "numpy"]
    caption = figure.get_supxlabel()
    assert "a box · a card · 1.2 · abc" in caption


@pytest.mark.parametrize("chart", charts.CHARTS, ids=lambda chart: chart.file)
def test_the_title_is_beside_the_legend(chart: charts.Chart) -> None:
    """In a chart of one panel, which is the narrowest."""
    records = [
        record(chart.name, splats, 1.0, subject=chart.subject, method=method, rate=1)
        for splats in (1_000_000, 100_000)
        for method in ("simplify", "simplify, along the path")
    ]
    records = [replace(one, scene="field.ply") for one in records]
    chart = replace(chart, series=charts.parameter("method"), over=charts.splats)
    figure = charts.figure(chart, records)
    figure.draw_without_rendering()
    (legend,), title = figure.legends, figure._suptitle
    assert title.get_window_extent().x0 > 0
    assert title.get_window_extent().x1 < legend.get_window_extent().x0


def test_the_band_reaches_to_the_95th_percentile(orders: list[Record]) -> None:
    (band, _) = charts.figure(CHART, orders).axes[0].collections
    (path,) = band.get_paths()
    assert path.vertices[:, 1].min() == pytest.approx(1)
    assert path.vertices[:, 1].max() == pytest.approx(19)  # between 10, 10 and 20


def test_a_rate_says_its_unit() -> None:
    chain = next(chart for chart in charts.CHARTS if chart.file == "chain-latency")
    measured = Measurement.of("pose to picture", "ms", 1, "s", 10, rate=30.0, backend="native")
    (legend,) = charts.figure(chain, [Record.of("chain", measured, HERE)]).legends
    assert [text.get_text() for text in legend.get_texts()] == ["30 Hz, native"]


def test_the_command_draws_files_and_only_what_they_hold(
    orders: list[Record], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    save(tmp_path / "sort.json", orders)
    out = tmp_path / "charts"
    assert main(["charts", str(tmp_path / "sort.json"), "--out", str(out)]) == 0
    assert [path.name for path in out.iterdir()] == ["sort-host.png"]
    assert "sort-host.png" in capsys.readouterr().out
    with Image.open(out / "sort-host.png") as picture:
        pixels = np.asarray(picture.convert("RGB")).reshape(-1, 3)
    for color in charts.colors(2):  # of the two lines
        near = np.abs(pixels / 255 - color[:3]).max(axis=1) < 0.02
        assert near.sum() > 100


def test_scenes_of_one_size_have_lines_of_their_own() -> None:
    scenes = {"procedural:500000": 500_000, "a/robot.ply": 500_000, "wolf.spz": 90_586}
    records = [
        replace(record("frame", splats, float(n), backend="native"), scene=scene)
        for n, (scene, splats) in enumerate(scenes.items())
    ]
    chart = charts.Chart("f", "sort", "frame", "Frame", "ms", charts.parameter("backend"))
    ax = charts.figure(chart, records).axes[0]
    assert [len(line.get_xdata()) for line in ax.lines] == [1, 1, 1]  # and no upright line


@pytest.mark.parametrize("text", ["?", "[]"])
def test_a_file_without_records_is_named_in_a_line(
    text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "x.json").write_text(text)
    assert main(["charts", "--out", str(tmp_path), str(tmp_path / "x.json")]) == 1
    said = capsys.readouterr().err
    assert "x.json" in said
    assert len(said.splitlines()) == 1
