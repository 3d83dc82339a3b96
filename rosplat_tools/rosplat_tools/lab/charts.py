"""The same charts as pictures, for the documentation."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.colors import to_rgb
from matplotlib.lines import Line2D
from matplotlib.ticker import LogFormatter

from rosplat_tools.lab.pareto import TIMES, Summary, front, summarise
from rosplat_tools.lab.points import Point

STYLE: Any = {"font.size": 9, "axes.grid": True, "grid.alpha": 0.3, "axes.spines.top": False,
         "axes.spines.right": False, "legend.frameon": False}  # fmt: skip
# What the families of a colour have in common.
GROUPS = {
    "exact order": ("sorter",),
    "keys": ("keys",),
    "old order": ("age",),
    "blending": ("blend", "order", "stochastic"),
    "what a splat holds": ("SH degree", "precision", "packed"),
    "fewer or smaller splats": ("budget", "least", "cut-off"),
    "other viewers": ("other",),
    "Quality": ("quality",),
}
COLORS = ["#222222", "#1f77b4", "#9467bd", "#2ca02c", "#ff7f0e", "#8c564b", "#d62728", "#e6b800"]
NAMED = ("quality", "other viewers")  # besides those that nothing beats
# Which number in a method's name its family varies.
CURVES = {
    "sort keys": (["keys linear", "keys adaptive", "keys float"], "bits", False),
    "age of the order, 60 Hz": (
        ["age rotation, 0.3/s", "age rotation, 1/s", "age rotation, 3/s",
         "age rotation, 1/s, culled 1x", "age orbit, 1/s", "age dolly, 1/s"], "frames", False,
    ),
    "stochastic transparency": (["stochastic"], "samples", True),
    "splats left out": (["least worth"], "alphas that add up to less than [px]", True),
}  # fmt: skip


def write(folder: Path, points: Sequence[Point]) -> list[Path]:
    """Writes accuracy.png and accuracy-curves.png."""
    summaries = summarise(points)
    folder.mkdir(parents=True, exist_ok=True)
    with plt.rc_context(STYLE):
        return [
            _scatter(folder / "accuracy.png", summaries, points),
            _curves(folder / "accuracy-curves.png", summaries),
        ]


def _scatter(path: Path, summaries: list[Summary], points: Sequence[Point]) -> Path:
    figure, (frame, pose, models) = plt.subplots(
        1, 3, figsize=(12, 6), sharey=True, width_ratios=(4, 3, 2.2), constrained_layout=True
    )
    for axes, time in ((frame, "ms"), (pose, "pose_ms")):
        for summary in summaries:
            if spread := getattr(summary, time):
                _dot(axes, spread, summary, hollow=bool(summary.aside))
        best = front(summaries, time=time)
        axes.plot(
            [getattr(s, time)[1] for s in best], [s.values["psnr"][1] for s in best],
            "--", color="0.4", linewidth=1, zorder=1, label="not beaten in both",
        )  # fmt: skip
        axes.set(xscale="log", xlabel=f"{TIMES[time]} [ms]")
        axes.xaxis.set_major_formatter("{x:g}")
        axes.xaxis.set_minor_formatter(LogFormatter(minor_thresholds=(2, 0.6)))
        _name(axes, [s for s in summaries if s in best or s.family in NAMED], time)
    untimed = sorted((s for s in summaries if not s.ms), key=lambda s: s.values["psnr"][1])
    for number, summary in enumerate(untimed):
        x = float(number % 2)
        _dot(models, (x, x, x), summary, hollow=True)
        models.annotate(
            summary.method, (x, summary.values["psnr"][1]), fontsize=6, va="center",
            xytext=(6, 0), textcoords="offset points",
        )  # fmt: skip
    models.set(xlabel="models, without a time", xticks=[], xlim=(-0.2, 2.3))
    frame.set_ylabel("PSNR [dB], more is better")
    handles = [
        Line2D([], [], marker="o", linestyle="", color=color, label=group)
        for group, color in zip(GROUPS, COLORS, strict=True)
    ]
    handles += [
        Line2D([], [], marker="o", linestyle="", markerfacecolor="white", color="0.4",
                   label="not held against others"),
        *frame.get_legend_handles_labels()[0],
    ]  # fmt: skip
    figure.legend(handles=handles, loc="outside lower center", ncols=5, fontsize=8)
    scenes = ", ".join(dict.fromkeys(point.scene for point in points))
    views = len({(point.scene, point.camera) for point in points})
    figure.suptitle(f"{views} views of {scenes}; {points[0].gpu.partition('/')[0]}", fontsize=9)
    figure.savefig(path, dpi=110)
    plt.close(figure)
    return path


def _dot(axes: Any, spread: tuple[float, float, float], summary: Summary, hollow: bool) -> None:
    """A median with its 10 % and 90 % quantiles both ways."""
    low, middle, high = summary.values["psnr"]
    left, x, right = spread
    color = COLORS[_group(summary)]
    axes.errorbar(
        x, middle, yerr=[[middle - low], [high - middle]], xerr=[[x - left], [right - x]],
        fmt="*" if summary.family == "quality" else "o", color=color,
        markerfacecolor="white" if hollow else color, elinewidth=0.5, ecolor=(*to_rgb(color), 0.35),
        markersize=12 if summary.family == "quality" else 4.5,
        zorder=4 if summary.family == "quality" else 2,
    )  # fmt: skip


def _group(summary: Summary) -> int:
    return next(
        number for number, families in enumerate(GROUPS.values())
        if summary.family.startswith(families)
    )  # fmt: skip


def _name(axes: Any, summaries: Sequence[Summary], time: str) -> None:
    """Names dots, as far as names don't lie on each other."""
    axes.figure.canvas.draw()  # which settles the scales
    taken: list[Any] = []
    for summary in summaries:
        if not (spread := getattr(summary, time)):
            continue
        for offset in ((6, 3), (6, -9), (6, 14), (6, -20)):
            text = axes.annotate(
                summary.method, (spread[1], summary.values["psnr"][1]), xytext=offset,
                textcoords="offset points", fontsize=7,
            )  # fmt: skip
            box = text.get_window_extent()
            if not any(box.overlaps(other) for other in taken):
                taken.append(box)
                break
            text.remove()


def _curves(path: Path, summaries: list[Summary]) -> Path:
    figure, grid = plt.subplots(1, len(CURVES), figsize=(12, 3.2), constrained_layout=True)
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
            axes.legend(fontsize=7)
    grid[0].set_ylabel("PSNR [dB]")
    figure.savefig(path, dpi=110)
    plt.close(figure)
    return path


def _knob(method: str) -> float:
    """The number in a method's name."""
    found = re.search(r"\d+(\.\d+)?", method)
    return float(found.group()) if found else 0.0
