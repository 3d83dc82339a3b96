"""Draws charts of records, from nothing but the records."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from rosplat_core.scenes import PROCEDURAL, is_generated
from rosplat_lab.arguments import make_folder
from rosplat_lab.bench.records import Record

Key = Callable[[Record], str]


def parameter(*names: str) -> Key:
    """A key of records: the values of these parameters, joined."""
    return lambda record: ", ".join(
        str(record.parameters[name]) for name in names if name in record.parameters
    )


def at_rate(record: Record) -> str:
    """How often the camera moves, and the backend."""
    return f"{record.parameters['rate']:g} Hz, {parameter('backend')(record)}"


def splats(record: Record) -> float:
    """How many splats the record was measured on."""
    return record.splats


@dataclass(frozen=True)
class Chart:
    """Records of one name as lines over the number of splats, or over another `over`.

    only: which of the records. series: the line of a record. panel: the panel of a record, one for
    all by default. band: shade from the line to the 95th percentile.
    """

    file: str
    subject: str
    name: str
    title: str
    y: str
    series: Key
    panel: Key = lambda _: ""
    x: str = "splats"
    over: Callable[[Record], float] = splats
    only: Callable[[Record], bool] = lambda _: True
    log: bool = True
    band: bool = True


CHARTS = (
    Chart(
        "sort-host", "sort", "order in host memory", "Depth order, in host memory", "time [ms]",
        parameter("method"), parameter("view"),
    ),
    Chart(
        "sort-pinned",
        "sort",
        "order in pinned memory",
        "Depth order, in pinned memory",
        "time [ms]",
        parameter("method"),
        parameter("view"),
    ),
    Chart(
        "frame-time", "frame", "frame", "Frame, until it is finished", "time [ms]",
        parameter("variant", "order"), parameter("view", "picture"),
    ),
    Chart(
        "frame-gpu-memory", "frame", "GPU memory", "GPU memory of the renderer", "[MB]",
        parameter("variant", "picture"), band=False,
    ),
    Chart(
        "simplify", "simplify", "PSNR", "With fewer splats, in views that nothing was fitted to",
        "PSNR against the whole map [dB]", parameter("method"), lambda r: Path(r.scene).stem,
        log=False, band=False,
    ),
    Chart(
        "levels-budget", "levels", "frame", "Frame of a million splats and nodes", "time [ms]",
        parameter("view", "kept"), only=lambda r: r.parameters["detail"] == "1000000",
    ),
    Chart(
        "align", "align", "success", "Poses found again, by how far off they began",
        "share of the starts", parameter("picture"), lambda r: Path(r.scene).stem,
        x="rotation [degrees]; 5/3 as many % of the scene's radius",
        over=lambda r: float(r.parameters["degrees"]), log=False, band=False,
    ),
    Chart(
        "simulate-steps", "simulate", "steps a second", "Steps of all environments together",
        "steps a second", parameter("pixels"), lambda r: Path(r.scene).stem,
        x="environments that share a map",
        over=lambda r: float(r.parameters["environments"]), log=False, band=False,
    ),
    Chart(
        "rviz-frame", "rviz", "frame", "Frame of rviz2", "time [ms]",
        parameter("display"), parameter("camera", "view"),
    ),
    Chart(
        "chain-latency", "chain", "pose to picture", "From pose to picture", "time [ms]",
        at_rate,
    ),
)  # fmt: skip


def of_chart(chart: Chart, records: Sequence[Record]) -> list[Record]:
    """The records that the chart shows."""
    mine = [r for r in records if (r.subject, r.name) == (chart.subject, chart.name)]
    return [record for record in mine if chart.only(record)]


def _family(record: Record) -> str:
    """Tells scenes of one size apart: none for the garden, a generated kind, or a file's name."""
    if record.scene.startswith(PROCEDURAL):
        return ""
    return record.scene.partition(":")[0] if is_generated(record.scene) else Path(record.scene).stem


def draw(records: Sequence[Record], folder: Path, statistic: str = "p50") -> list[Path]:
    """Draws every chart that the records have something for; returns the pictures' paths.

    statistic: the field of Record that is drawn.
    """
    make_folder(folder)
    drawn = []
    for chart in CHARTS:
        mine = of_chart(chart, records)
        if mine:
            path = folder / f"{chart.file}.png"
            figure(chart, mine, statistic).savefig(path, dpi=110)
            drawn.append(path)
    return drawn


def figure(chart: Chart, records: Sequence[Record], statistic: str = "p50") -> Figure:
    """One chart; its caption names the machine."""
    panels = list(dict.fromkeys(chart.panel(record) for record in records))
    labels = list(dict.fromkeys(chart.series(record) for record in records))
    color_of = dict(zip(labels, colors(len(labels)), strict=True))
    legend_width = 0.9 + 0.075 * max(map(len, labels))
    width = max(6.5, 0.6 + 4.2 * len(panels) + legend_width)
    drawn = Figure(figsize=(width, 4.6), layout="constrained")
    axes = np.atleast_1d(drawn.subplots(1, len(panels), sharey=True))
    for panel, ax in zip(panels, axes, strict=True):
        for label in labels:
            points = [r for r in records if (chart.panel(r), chart.series(r)) == (panel, label)]
            points.sort(key=chart.over)
            for family in dict.fromkeys(map(_family, points)):
                line = [point for point in points if _family(point) == family]
                _line(ax, chart, line, statistic, label, color_of[label])
        ax.set_title(panel, fontsize=10)
        ax.set_xlabel(chart.x)
        ax.grid(True, which="both", alpha=0.25, linewidth=0.5)
        if chart.log:
            ax.set_xscale("log")
            ax.set_yscale("log")
        if chart.over is splats:
            ax.xaxis.set_major_formatter(mpl.ticker.EngFormatter(sep=""))
            ax.xaxis.set_minor_formatter(mpl.ticker.NullFormatter())
    if not chart.log:
        axes[0].set_ylim(0)  # after all is drawn: the panels share it
    axes[0].set_ylabel(chart.y)
    handles = {
        label: handle
        for ax in axes
        for handle, label in zip(*ax.get_legend_handles_labels(), strict=True)
    }
    drawn.legend(
        handles.values(), handles.keys(), loc="outside right upper", fontsize=8, frameon=False
    )
    # From the left edge: in the middle, a long title would reach into the legend.
    drawn.suptitle(f"{chart.title} ({statistic})", x=0.01, ha="left", fontsize=12)
    drawn.supxlabel(_caption(records, int(17 * width)), fontsize=7, color="0.35")
    return drawn


def _line(
    ax: Axes, chart: Chart, points: Sequence[Record], statistic: str, label: str,
    color: tuple[float, ...],
) -> None:  # fmt: skip
    x, y = [chart.over(point) for point in points], [getattr(point, statistic) for point in points]
    marker = "o" if len(points) < 30 else None
    ax.plot(x, y, label=label, color=color, marker=marker, markersize=3.5, linewidth=1.4)
    if chart.band:
        high = [point.p95 for point in points]
        ax.fill_between(x, y, high, color=color, alpha=0.15, linewidth=0)


def colors(count: int) -> list[tuple[float, ...]]:
    """Colours of so many lines."""
    if count <= 10:
        return [mpl.colormaps["tab10"](index) for index in range(count)]
    return [mpl.colormaps["turbo"](place) for place in np.linspace(0.05, 0.95, count)]


def _caption(records: Sequence[Record], width: int) -> str:
    """Where it was measured, in lines of so many characters."""
    wheres = dict.fromkeys(
        " · ".join(part for part in (r.machine, r.gpu, r.driver, r.commit) if part) for r in records
    )
    return "\n".join(line for where in wheres for line in textwrap.wrap(where, width))
