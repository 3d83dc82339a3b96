"""accuracy.png: what pays on a graphics card, and on two cores, for two scenes each."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.text import Text
from matplotlib.ticker import LogFormatter, NullFormatter
from matplotlib.transforms import Bbox

from rosplat_core.program.files import make_folder
from rosplat_lab.bench.records import Record
from rosplat_lab.lab.points import Point, by_scene, frontier, points
from rosplat_lab.lab.ways import DEFAULT

STYLE: Any = {"font.size": 9, "axes.grid": True, "grid.alpha": 0.3, "axes.spines.top": False,
         "axes.spines.right": False, "legend.frameon": False}  # fmt: skip
COLOURS = {
    "rasteriser": "#222222", "order": "#9467bd", "Detail": "#1f77b4",
    "simplify": "#2ca02c", "numbers of a splat": "#ff7f0e", "other renderers": "#d62728",
    "Model": "#e377c2",
}  # fmt: skip
CHARTED = 2  # the first scenes of a record
MOST_NAMES = 12
TOP = 95.0  # of the axis [dB]
DISTANCES = (10, 20, 32, 46, 64, 86, 110)  # of a name from its dot [points]
ANGLES = sorted(range(-165, 195, 15), key=abs)  # directions from the dot, right first [degrees]


def write(folder: Path, kept: Mapping[str, Sequence[Record]]) -> Path:
    """Writes accuracy.png of the records of each kind of machine, a row for each."""
    make_folder(folder)
    path = folder / "accuracy.png"
    rows = [[(where(records), here) for here in charted(records)] for records in kept.values()]
    across = max(map(len, rows))
    with plt.rc_context(STYLE):
        figure, grid = plt.subplots(
            len(rows), across, figsize=(6.2 * across, 5.2 * len(rows)), layout="constrained",
            sharey=True, squeeze=False, dpi=100,
        )  # fmt: skip
        panels = []
        for row, row_of_axes in zip(rows, grid, strict=True):
            row_of_axes[0].set_ylabel("PSNR against the float64 reference [dB]")
            for axes in row_of_axes[len(row) :]:
                axes.axis("off")
            for axes, (machine, here) in zip(row_of_axes, row, strict=False):
                _dots(axes, here, machine)
                panels.append((axes, here))
        handles = {
            label: handle
            for axes, _ in panels
            for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)
        }
        figure.legend(
            handles.values(), handles.keys(), loc="outside lower center", ncols=4 * across,
            fontsize=8,
        )  # fmt: skip
        figure.canvas.draw()  # settles the layout; then the dots stay
        figure.set_layout_engine("none")
        for axes, here in panels:
            name(axes, here, named(here))
        figure.savefig(path)
        plt.close(figure)
    return path


def charted(records: Sequence[Record]) -> list[list[Point]]:
    """The points of each charted scene that are held against each other."""
    return by_scene(p for p in points(records) if p.ms is not None and not p.aside)[:CHARTED]


def named(here: Sequence[Point]) -> list[Point]:
    """A dozen at most: the frontier, the defaults, the slowest, each other family's most exact."""
    best = frontier(here)
    others: dict[str, Point] = {}
    for point in sorted(here, key=lambda p: -p.psnr):
        if point not in best:
            others.setdefault(point.family, point)
    default = [p for p in here if p.setting == DEFAULT]
    slowest = max(here, key=lambda p: p.ms or 0)
    rest = [p for p in dict.fromkeys([*default, slowest, *others.values()]) if p not in best]
    return [*best, *rest][:MOST_NAMES]


def where(records: Sequence[Record]) -> str:
    """The machine of records, in few words."""
    first = records[0]
    drawing = next((r.gpu for r in records if not r.gpu.startswith(("CPU", "NumPy"))), "")
    card = drawing.partition("/")[0] if drawing and "llvmpipe" not in drawing else ""
    cores = ", ".join(first.machine.split(", ")[:2])
    return card or f"{cores}, no graphics card"


def _dots(axes: Any, here: Sequence[Point], machine: str) -> None:
    for family, colour in COLOURS.items():
        members = [p for p in here if p.family == family]
        if members:
            axes.errorbar(
                [p.ms for p in members], [min(p.psnr, TOP) for p in members],
                xerr=[p.ms_noise / 2 for p in members], fmt="o", color=colour, markersize=5,
                elinewidth=0.6, label=family, zorder=3,
            )  # fmt: skip
    best = frontier(here)
    axes.plot(
        [p.ms for p in best], [min(p.psnr, TOP) for p in best], "--", color="0.4", linewidth=1,
        zorder=1, label="the frontier",
    )  # fmt: skip
    axes.set_xscale("log")
    times = [p.ms or 1 for p in here]
    axes.set_xlim(min(times) / 1.6, max(times) * 1.6)
    axes.xaxis.set_major_formatter("{x:g}")
    decades = math.log10(max(times) / min(times))
    axes.xaxis.set_minor_formatter(
        LogFormatter(minor_thresholds=(2, 0.6)) if decades < 1.5 else NullFormatter()
    )
    axes.set_xlabel("a picture, sorted and drawn [ms]")
    axes.set_title(f"{machine}\n{here[0].scene}, {here[0].splats:,} splats, 1280x720", fontsize=9)


def name(axes: Any, here: Sequence[Point], chosen: Sequence[Point]) -> None:
    """Names the chosen dots, each name beside its dot, and on no other dot or name."""
    places = {p.setting: (p.ms, min(p.psnr, TOP)) for p in here}
    dots = [
        Bbox.from_extents(x - 6, y - 6, x + 6, y + 6)
        for x, y in axes.transData.transform(list(places.values()))
    ]
    names: list[Bbox] = []
    for point in sorted(chosen, key=lambda p: -p.psnr):  # lines cross less
        for distance, angle in product(DISTANCES, ANGLES):
            right = distance * math.cos(math.radians(angle))
            up = distance * math.sin(math.radians(angle))
            side = 1 if right < -1 else 0  # of the name, to which its line leads
            text = axes.annotate(
                point.setting, places[point.setting], xytext=(right, up),
                textcoords="offset points", fontsize=8, va="center", ha=("left", "right")[side],
                zorder=5, bbox={"color": "white", "alpha": 0.8, "pad": 0.5, "linewidth": 0},
                arrowprops={"arrowstyle": "-", "linewidth": 0.6, "color": "0.4", "shrinkA": 0,
                            "relpos": (side, 0.5)},
            )  # fmt: skip
            text.update_positions(axes.figure.canvas.get_renderer())
            box = Text.get_window_extent(text).padded(2)  # without the line to the dot
            inside = all(axes.bbox.contains(*corner) for corner in box.corners())
            line = text.arrow_patch.get_path()
            crossed = any(line.intersects_bbox(other) for other in names)
            if inside and not crossed and not box.count_overlaps(dots + names):
                names.append(box)
                break
            text.remove()
