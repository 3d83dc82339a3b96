"""The same charts as pictures, for the documentation."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

from rosplat_tools.lab.pareto import Summary, front, summarise
from rosplat_tools.lab.points import Point

STYLE: Any = {"font.size": 9, "axes.grid": True, "grid.alpha": 0.3, "axes.spines.top": False,
         "axes.spines.right": False, "legend.frameon": False}  # fmt: skip
# Which number in a method's name its family varies.
CURVES = {
    "sort keys": (["keys linear", "keys adaptive", "keys float"], "bits", False),
    "age of the order, 1 rad/s, 60 Hz": (
        ["age rotation", "age rotation, culled 1x", "age orbit", "age dolly"], "frames", False,
    ),
    "stochastic transparency": (["stochastic"], "samples", True),
    "splats that are drawn": (["budget"], "% of those visible", False),
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
    figure, (axes, models) = plt.subplots(
        1, 2, figsize=(9, 5), sharey=True, width_ratios=(4, 1), constrained_layout=True
    )
    families = list(dict.fromkeys(summary.family for summary in summaries))
    colors = {family: plt.get_cmap("tab20")(i % 20) for i, family in enumerate(families)}
    untimed = [summary for summary in summaries if not summary.ms]
    labelled: set[str] = set()
    for summary in summaries:
        low, middle, high = summary.values["psnr"]
        target, x = (axes, summary.ms[1]) if summary.ms else (models, float(untimed.index(summary)))
        target.errorbar(
            x, middle, yerr=[[middle - low], [high - middle]],
            xerr=[[x - summary.ms[0]], [summary.ms[2] - x]] if summary.ms else None,
            fmt="s" if summary.model else "o", color=colors[summary.family], markersize=5,
            elinewidth=0.6, alpha=0.9,
            label=None if summary.family in labelled else summary.family,
        )  # fmt: skip
        labelled.add(summary.family)
    best = front(summaries)
    if best:
        axes.plot(
            [s.ms[1] for s in best if s.ms], [s.values["psnr"][1] for s in best],
            "--", color="0.25", linewidth=1, label="beaten by nobody",
        )  # fmt: skip
    for summary in best:
        if summary.ms:
            axes.annotate(
                summary.method, (summary.ms[1], summary.values["psnr"][1]), fontsize=7,
                xytext=(4, 4), textcoords="offset points",
            )  # fmt: skip
    axes.set(xscale="log", xlabel="sorting and drawing [ms]", ylabel="PSNR [dB], more is better")
    models.set(xlabel="models,\nwithout a time", xticks=[])
    figure.legend(loc="outside lower center", ncols=6, fontsize=7)
    scenes = ", ".join(dict.fromkeys(point.scene for point in points))
    figure.suptitle(f"{scenes}; {points[0].gpu}, {points[0].machine}", fontsize=7)
    figure.savefig(path, dpi=130)
    plt.close(figure)
    return path


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
