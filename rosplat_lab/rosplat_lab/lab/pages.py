"""The generated parts of docs/accuracy.md and docs/stability.md, below what is written by hand."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from PIL import Image

from rosplat_core.program.files import write_below
from rosplat_lab.bench.records import Record
from rosplat_lab.lab.atlas import CASES
from rosplat_lab.lab.picture import STYLE, charted, named, where
from rosplat_lab.lab.points import Point, by_scene, for_decibels, frontier, points, verdict
from rosplat_lab.lab.stage import PROCESSOR, SHADERS

MADE = "<!-- Made by `make lab DOCS=docs`, from here to the end. -->\n\n"
ACCURACY, STABILITY = "# Error against time\n\n", "# Where methods fail\n\n"
TARGETS = (60, 50, 40, 30)  # [dB]
SOLVED = 65.0  # beyond it nobody sees errors; packed attributes allow it [dB]
COLUMNS = 4  # of stability.png

KEPT = "results/lab"  # of the folder of documents: KIND.json and KIND-atlas.json

Kept = Mapping[str, Sequence[Record]]


def write(docs: Path, lab: Kept, atlas: Kept) -> list[Path]:
    """Writes the pages that there are records for; returns their paths."""
    written = []
    if lab:
        written.append(docs / "accuracy.md")
        write_below(written[-1], ACCURACY, MADE, "\n".join(_accuracy(lab)) + "\n")
    if atlas:
        written += [docs / "stability.md", docs / "stability.png"]
        write_below(written[-2], STABILITY, MADE, "\n".join(_stability(atlas)) + "\n")
        chart(written[-1], curves_of(next(iter(atlas.values()))))
    return written


def _accuracy(lab: Kept) -> list[str]:
    lines = []
    for kind, records in lab.items():
        scenes = by_scene(points(records))
        title = "A graphics card" if kind == "card" else "Two cores"
        lines += [f"## {title}", "", _run(records, kind), ""]
        for here in charted(records):
            best = frontier(here)
            lines += [f"| {here[0].scene}, {here[0].splats:,} splats | ms | dB | worst view |",
                      "|---|---:|---:|---:|"]  # fmt: skip
            for p in sorted(named(here), key=lambda p: p.ms or 0):
                setting = f"**{p.setting}**" if p in best else p.setting
                lines += [f"| {setting} | {_ms(p)} | {p.psnr:.1f} | {p.worst_view:.1f} |"]
            lines += [""]
        lines += ["Bold is the frontier. The fastest setting by what is asked for:", ""]
        lines += ["| | " + " | ".join(f"{least} dB" for least in TARGETS) + " |"]
        lines += ["|---|" + "---|" * len(TARGETS)]
        for here in scenes:
            cells = [_answer(for_decibels(here, least)) for least in TARGETS]
            lines += [f"| {here[0].scene}, {here[0].splats:,} | {' | '.join(cells)} |"]
        lines += ["", *(f"- {h[0].scene}: the default is {verdict(h)}." for h in scenes)]
        aside = [p for p in scenes[0] if p.aside]
        lines += ["", "Not held against these: " + "; ".join(map(_aside, aside)) + ".", ""]
        moving = [p for here in scenes[1:] for p in here if p.family == "in motion"]
        if moving:
            of = f"{moving[0].scene}, {moving[0].splats:,} splats"
            lines += [f"While the camera turns, {of}: " + "; ".join(map(_aside, moving)) + ".", ""]
    return ["![Error against time](accuracy.png)", "", *lines[:-1]]


def _ms(point: Point) -> str:
    assert point.ms is not None
    return f"{point.ms:,.0f}" if point.ms >= 100 else f"{point.ms:.3g}"


def _answer(point: Point | None) -> str:
    return f"{point.setting}, {_ms(point)} ms" if point else "none"


def _aside(point: Point) -> str:
    """A model, a late order or a moving camera, in few words."""
    what = f"{point.setting} (model)" if point.aside == "a model" else point.setting
    return f"{what} {point.psnr:.1f} dB"


def _run(records: Sequence[Record], name: str) -> str:
    """Where and when, and the file of DOCS/results/lab."""
    first = records[0]
    load = max(record.load for record in records)
    commits = ", ".join(dict.fromkeys(record.commit for record in records))
    return (
        f"{where(records)} (`{first.command}`, commit {commits}, {first.time[:10]}, "
        f"load up to {load:.1f}, [record]({KEPT}/{name}.json))."
    )


# --- Stability ------------------------------------------------------------------------------------

Curves = dict[str, dict[str, tuple[list[float], list[float]]]]
"""By case and curve: difficulties and errors."""


def curves_of(records: Sequence[Record]) -> Curves:
    """What a run of the atlas found, of the cases that still exist."""
    found: Curves = {}
    for record in records:
        if record.name in CASES:
            curve = found.setdefault(record.name, {}).setdefault(
                str(record.parameters["curve"]), ([], [])
            )
            curve[0].append(float(record.parameters["difficulty"]))
            curve[1].append(record.p50)
    return found


def _stability(atlas: Kept) -> list[str]:
    lines = ["![All curves](stability.png)", ""]
    for kind, records in atlas.items():
        lines += [f"## Measured {'on a graphics card' if kind == 'card' else 'on two cores'}", ""]
        lines += [_run(records, f"{kind}-atlas"), ""]
        lines += ["| | difficulty | drawn by | dB, or what is named |", "|---|---|---|---|"]
        for name, curves in curves_of(records).items():
            case = CASES[name]
            difficulties = ", ".join(f"{x:g}" for x in next(iter(curves.values()))[0])
            title, axis = case.title, f"{case.axis}: {difficulties}"
            if case.unit != "dB":
                title += f": {case.unit}"
            both = [curves[by][1] for by in (PROCESSOR, SHADERS) if by in curves]
            least = min((min(errors) for errors in both), default=0.0)
            left = dict(curves)
            if case.unit == "dB" and least > SOLVED:
                lines += [f"| {title} | {axis} | both | {least:.0f} or more |"]
                left = {k: v for k, v in curves.items() if k not in (PROCESSOR, SHADERS)}
                title = axis = ""
            for way, (_, errors) in left.items():
                figures = ", ".join(f"{e:.0f}" if e >= 5 else f"{e:.2g}" for e in errors)
                lines += [f"| {title} | {axis} | {way} | {figures} |"]
                title = axis = ""
        lines += [""]
    return lines[:-1]


def chart(path: Path, found: Curves) -> None:
    """Draws the cases in which something fails."""
    failing = {
        name: curves
        for name, curves in found.items()
        if CASES[name].unit != "dB" or min(min(e) for _, e in curves.values()) < SOLVED
    }
    rows = -(-len(failing) // COLUMNS)
    with plt.rc_context(STYLE | {"font.size": 8}):
        figure, grid = plt.subplots(
            rows, COLUMNS, figsize=(3.1 * COLUMNS, 2.9 * rows), layout="constrained", squeeze=False
        )
        for axes in grid.flat[len(failing) :]:
            axes.axis("off")
        for axes, (name, curves) in zip(grid.flat, failing.items(), strict=False):
            case = CASES[name]
            for way, (xs, errors) in curves.items():
                axes.plot(xs, errors, "o-", markersize=3, linewidth=1, label=way)
                positive = [x for x in xs if x > 0]
                if max(positive) / min(positive) > 50:
                    axes.set_xscale("symlog", linthresh=min(positive))
                    powers = np.arange(*np.ceil(np.log10([min(positive), 1.01 * max(positive)])))
                    axes.set_xticks([0.0] * (min(xs) == 0) + (10.0**powers).tolist())
            axes.set_title(case.title, fontsize=9)
            axes.set_xlabel(case.axis)
            axes.set_ylabel("PSNR [dB]" if case.unit == "dB" else case.unit)
            axes.set_ylim(0, 100 if case.unit == "dB" else None)
            axes.legend(fontsize=7)
        figure.savefig(path, dpi=90)
        plt.close(figure)
    with Image.open(path) as drawn:  # few colours: a third of the size
        small = drawn.convert("RGB").quantize(256)
    small.save(path, optimize=True)
