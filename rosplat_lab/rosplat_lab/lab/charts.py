"""The same charts as pictures, for the documentation."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from itertools import product
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.colors import to_rgb
from matplotlib.lines import Line2D
from matplotlib.text import Text
from matplotlib.ticker import LogFormatter
from matplotlib.transforms import Bbox

from rosplat_lab.arguments import make_folder
from rosplat_lab.lab.methods import MODEL
from rosplat_lab.lab.pareto import Summary, front, summarise
from rosplat_lab.lab.points import Point

STYLE: Any = {"font.size": 9, "axes.grid": True, "grid.alpha": 0.3, "axes.spines.top": False,
         "axes.spines.right": False, "legend.frameon": False}  # fmt: skip
# What the families of a colour have in common.
GROUPS = {
    "exact order": ("sorter",),
    "keys": ("keys",),
    "old order": ("age",),
    "blending": ("blend", "order", "stochastic"),
    "what a splat holds": ("SH degree", "precision", "packed"),
    "fewer splats or pixels": ("budget", "least", "cut-off"),
    "other viewers": ("other",),
}
COLORS = ["#222222", "#1f77b4", "#9467bd", "#2ca02c", "#ff7f0e", "#8c564b", "#d62728"]
DISTANCES = (9, 18, 28, 40, 54, 70, 90)  # of a name from its dot [points]
ANGLES = sorted(range(-165, 195, 15), key=abs)  # and where, from its right on [degrees]
BELOW = (0.5, -0.18)  # an axis and its label, in its height
MOST_COLUMNS = 3  # of panels
NAMED = ("other viewers",)  # besides those that nothing beats
# Which number in a method's name its family varies.
CURVES = {
    "sort keys": (["keys linear", "keys adaptive", "keys float"], "bits", False),
    "age of the order, 60 Hz": (
        ["age rotation, 0.3/s", "age rotation, 1/s", "age rotation, 3/s",
         "age rotation, 1/s, culled 1x", "age orbit, 1/s", "age dolly, 1/s"], "frames", False,
    ),
    "stochastic transparency": (["stochastic"], "samples", True),
    "splats left out": (["budget"], "% of them kept", False),
}  # fmt: skip


def write(folder: Path, points: Sequence[Point]) -> list[Path]:
    """Writes accuracy.png and accuracy-curves.png."""
    summaries = summarise(points)
    make_folder(folder)
    with plt.rc_context(STYLE):
        return [
            _scatter(folder / "accuracy.png", summaries, points),
            _curves(folder / "accuracy-curves.png", summaries),
        ]


def _scatter(path: Path, summaries: list[Summary], points: Sequence[Point]) -> Path:
    """A panel for each scene that has times, one below them for what has none."""
    timed = list(dict.fromkeys(point.scene for point in points if point.ms is not None))
    models = sorted((s for s in summaries if s.aside == MODEL), key=lambda s: s.values["psnr"][1])
    rows = -(-len(timed) // MOST_COLUMNS)
    columns = -(-len(timed) // max(rows, 1)) or 1
    heights = [4.1] * rows + [3.1] * bool(models)
    figure = plt.figure(
        figsize=(4.3 * max(columns, 2) + 0.4, sum(heights) + 1.2), layout="constrained", dpi=100
    )
    grid = figure.add_gridspec(len(heights), columns, height_ratios=heights)
    panels: list[Any] = []
    for number in range(len(timed)):
        place = divmod(number, columns)
        panels.append(figure.add_subplot(grid[place], sharey=panels[0] if panels else None))
    named = []
    for axes, scene in zip(panels, timed, strict=True):
        here = summarise(point for point in points if point.scene == scene)
        _times(axes, here)
        best = front(here)
        axes.plot(
            [s.ms[1] for s in best if s.ms], [s.values["psnr"][1] for s in best],
            "--", color="0.4", linewidth=1, zorder=1, label="not beaten in both",
        )  # fmt: skip
        views = len({point.camera for point in points if point.scene == scene})
        axes.set_title(f"{scene}, {views} views", fontsize=9)
        named.append((axes, here, [s for s in here if s in best or s.family in NAMED]))
    if models:
        axes = figure.add_subplot(grid[-1, :], sharey=panels[0] if panels else None)
        for column, summary in enumerate(models):
            _dot(axes, column, summary)
        names = [summary.method for summary in models]
        axes.set_xticks(range(len(models)), names, fontsize=8, rotation=25, ha="right")
        axes.set_title("models, without a time", fontsize=9)
        panels.append(axes)
    for axes in panels:
        if axes.get_subplotspec().is_first_col():
            axes.set_ylabel("PSNR [dB], more is better")
        else:
            axes.tick_params(labelleft=False)
    handles = [
        Line2D([], [], marker="o", linestyle="", color=color, label=group)
        for group, color in zip(GROUPS, COLORS, strict=True)
    ]
    handles += [
        Line2D([], [], marker="o", linestyle="", markerfacecolor="white", color="0.4",
               label="not held against others"),
        *panels[0].get_legend_handles_labels()[0],
    ]  # fmt: skip
    figure.legend(handles=handles, loc="outside lower center", ncols=5, fontsize=8)
    figure.suptitle(", ".join(dict.fromkeys(p.gpu.partition("/")[0] for p in points)), fontsize=9)
    figure.canvas.draw()  # which settles where the dots are, and there they stay
    figure.set_layout_engine("none")
    for axes, here, chosen in named:
        _name(axes, here, chosen)
    figure.savefig(path)
    plt.close(figure)
    return path


def _times(axes: Any, summaries: Sequence[Summary]) -> None:
    """Dots of what has times, each with a line from a frame's time to that from pose to draw."""
    for summary in summaries:
        if summary.ms and summary.pose_ms:
            _dot(axes, summary.ms[1], summary)
            axes.plot(
                [summary.ms[1], summary.pose_ms[1]], [summary.values["psnr"][1]] * 2,
                color=COLORS[_group(summary)], linewidth=0.8, alpha=0.5, zorder=1,
            )  # fmt: skip
    axes.set(xscale="log", xlabel="sorting and drawing; a line to pose to draw [ms]")
    times = [spread[1] for s in summaries for spread in (s.ms, s.pose_ms) if spread]
    axes.set_xlim(min(times) / 1.3, max(times) * 1.6)  # or noise would fill the panel
    axes.xaxis.set_major_formatter("{x:g}")
    axes.xaxis.set_minor_formatter(LogFormatter(minor_thresholds=(2, 0.6)))


def _dot(axes: Any, x: float, summary: Summary) -> None:
    """A median with the 10 % and 90 % quantiles of its error."""
    low, middle, high = summary.values["psnr"]
    color = COLORS[_group(summary)]
    axes.errorbar(
        x, middle, yerr=[[middle - low], [high - middle]], fmt="o", color=color,
        markerfacecolor="white" if summary.aside else color, markersize=4.5,
        elinewidth=0.5, ecolor=(*to_rgb(color), 0.35), zorder=2,
    )  # fmt: skip


def _group(summary: Summary) -> int:
    return next(
        number for number, families in enumerate(GROUPS.values())
        if summary.family.startswith(families)
    )  # fmt: skip


def _name(axes: Any, summaries: Sequence[Summary], chosen: Sequence[Summary]) -> None:
    """Names the chosen dots, each beside its own, but on no other dot or name."""
    places = {s.method: (s.ms[1], s.values["psnr"][1]) for s in summaries if s.ms}
    dots = [
        Bbox.from_extents(x - 6, y - 6, x + 6, y + 6)
        for x, y in axes.transData.transform(list(places.values()))
    ]
    names: list[Bbox] = []
    for summary in sorted(chosen, key=lambda s: -s.values["psnr"][1]):  # lines cross less
        if summary.method not in places:
            continue
        for distance, angle in product(DISTANCES, ANGLES):
            right = distance * math.cos(math.radians(angle))
            up = distance * math.sin(math.radians(angle))
            side = 1 if right < -1 else 0  # of the name, to which its line leads
            text = axes.annotate(
                summary.method, places[summary.method], xytext=(right, up),
                textcoords="offset points", fontsize=7.5, va="center",
                ha=("left", "right")[side],
                zorder=5, bbox={"color": "white", "alpha": 0.8, "pad": 0.5, "linewidth": 0},
                arrowprops={"arrowstyle": "-", "linewidth": 0.6, "color": "0.4", "shrinkA": 0,
                            "relpos": (side, 0.5)},
            )  # fmt: skip
            text.update_positions(axes.figure.canvas.get_renderer())
            box = Text.get_window_extent(text).padded(2)  # without the line to the dot
            inside = all(axes.bbox.contains(*corner) for corner in box.corners())
            line = text.arrow_patch.get_path()
            crossed = any(line.intersects_bbox(name) for name in names)
            if inside and not crossed and not box.count_overlaps(dots + names):
                names.append(box)
                break
            text.remove()


def _curves(path: Path, summaries: list[Summary]) -> Path:
    figure, grid = plt.subplots(1, len(CURVES), figsize=(12, 4), constrained_layout=True)
    for axes, (title, (families, label, logarithmic)) in zip(grid, CURVES.items(), strict=True):
        for family in families:
            members = [summary for summary in summaries if summary.family == family]
            if not members:
                continue
            knobs = [_knob(summary.method) for summary in members]
            low, middle, high = zip(*(summary.values["psnr"] for summary in members), strict=True)
            (line,) = axes.plot(knobs, middle, "o-", markersize=4, label=family)
            axes.fill_between(knobs, low, high, color=line.get_color(), alpha=0.15, linewidth=0)
        axes.set(title=title, xlabel=label)
        if logarithmic:
            axes.set_xscale("log", base=2)
        if axes.get_legend_handles_labels()[0]:
            axes.legend(fontsize=7, loc="upper center", bbox_to_anchor=BELOW)
    grid[0].set_ylabel("PSNR [dB]")
    figure.savefig(path, dpi=110)
    plt.close(figure)
    return path


def _knob(method: str) -> float:
    """The number in a method's name; of an old order, its frames."""
    found = re.search(r"\d+(?= frames)", method) or re.search(r"\d+(\.\d+)?", method)
    return float(found.group()) if found else 0.0
