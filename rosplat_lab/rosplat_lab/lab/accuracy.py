"""docs/accuracy.md: what each method costs in error, and what follows for the defaults."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path

from rosplat_core.program.files import write_below
from rosplat_lab.lab.methods import MODEL
from rosplat_lab.lab.pareto import Summary, summarise
from rosplat_lab.lab.points import Point

TOPICS: dict[str, tuple[tuple[str, ...], str]] = {
    "Sorters": (("sorter",), "All backends, and the renderer, find the same order."),
    "Keys": (
        ("keys",),
        "20 bits cost next to nothing. 16 bits cost little in a compact scene, and a far outlier "
        "takes all steps of linear keys ([stability](stability.md)). 12 bits and fewer are "
        "visible. Adaptive keys spend steps where splats are many, not where they overlap: they "
        "help against outliers alone. Float keys are the float's own upper bits: as good as "
        "linear keys, and safe from outliers. *Radial* keys sort by distance. A map that was "
        "trained by z needs z.",
    ),
    "Old orders": (
        ("age",),
        "An order that is as many frames old, at 60 frames a second, while the camera turns, "
        "orbits the scene or approaches it, by so many rad/s or distances to the scene a second. "
        "One frame of turning costs more than 16-bit keys. Approaching without a turn costs "
        "nothing. Orders are culled for a view 1.25 times as wide as the picture: with 1x, "
        "splats missing at the border cost more than the order does. 1.5x is no better at these "
        "angles.",
    ),
    "Blending": (
        ("blend", "order of pixels", "order-free", "stochastic", "cut-off"),
        "The error of half floats is invisible where the driver rounds. Mesa's software renderer "
        "cuts them off, so the Display blends in 32 bits there. Tiles add in 32-bit floats "
        "whatever the target. Eight bits show in gradients. Multisampling changes only the rims "
        "of quads. Sorting for each pixel doesn't pop, but maps aren't trained for it. Stochastic "
        "transparency gains 6 dB for four times the samples. Quads must reach the 1/255 ellipse, "
        "3.33 sigma.",
    ),
    "Less of the map": (
        ("SH degree", "precision", "packed", "budget", "least size"),
        "Dropping a band of harmonics costs most and saves no time. Half floats suffice for all "
        "attributes but positions, which need a near origin. 8 bits for harmonics suffice for "
        "sending; 4 don't. A budget drops the least visible splats, by opacity times area. "
        "Leaving out what is smaller than half a pixel costs one scene nothing and the other 26 "
        "dB.",
    ),
    "Other viewers": (
        ("other viewers",),
        "RVizSplat and the system of the ROSplat paper, modelled after their public sources "
        "(`lab/viewers.py`). [Performance](performance.md) has RVizSplat's own frames and "
        "pictures. The paper's system raises colours to 1/2.2 before it blends, which these maps "
        "were not trained for.",
    ),
}
"""The families of each, by how their names begin, and what the figures mean."""

TITLE = "# Error against time\n\n"
MADE = "<!-- Made by `make lab`, from here to the end. -->\n\n"

READING = """\
## How to read the tables

Each method draws the same views. The reference renderer blends every splat of them in exact order.
A cell has the time of a frame in ms, sorting and drawing, then the PSNR in dB: the median of the
views, and in brackets the quantile that a tenth of them is below. FLIP and the worst pixel (1 is
white for black) are medians by scene, from the lowest to the highest. Orders are drawn in 32-bit
floats, so the error is that of the method alone. *Models* are NumPy models of what the renderer
doesn't do, and have no time. The records also have SSIM, and the time from a camera's pose to the
picture.
"""
AGED = re.compile(r"(.*), (\d+) frames old(.*)")

ByMethod = Mapping[str, Summary]


def write(folder: Path, points: Sequence[Point], remark: str = "") -> Path:
    """Writes accuracy.md into a folder; its pictures are those of `charts`."""
    scenes = list(dict.fromkeys(point.scene for point in points))
    by_scene = {
        scene: {s.method: s for s in summarise(p for p in points if p.scene == scene)}
        for scene in scenes
    }
    methods: dict[str, list[str]] = defaultdict(list)
    for point in points:
        topic = _topic(point.family)
        if point.method not in methods[topic]:
            methods[topic].append(point.method)
    lines = ["![Error against time](accuracy.png)", "", "![Curves](accuracy-curves.png)", ""]
    lines += [READING]
    for topic in sorted(methods, key=[*TOPICS, *methods].index):
        table = _ages if all(map(AGED.match, methods[topic])) else _table
        _, lesson = TOPICS.get(topic, ((), ""))
        lines += [f"## {topic}", "", lesson, "", *table(methods[topic], by_scene), ""]
    runs = dict.fromkeys((p.command, p.gpu, p.machine, p.commit) for p in points)
    lines += ["## Runs", "", *(f"- `{c}`: {g}, {m}, commit {v}" for c, g, m, v in runs)]
    lines += ["", remark] if remark else []
    path = folder / "accuracy.md"
    write_below(path, TITLE, MADE, "\n".join(lines) + "\n")
    return path


def _topic(family: str) -> str:
    known = (topic for topic, (names, _) in TOPICS.items() if family.startswith(names))
    return next(known, family[0].upper() + family[1:])


def _table(methods: Sequence[str], by_scene: Mapping[str, ByMethod]) -> list[str]:
    """A row for each method: time and error in each scene."""
    shown = [scene for scene, known in by_scene.items() if any(m in known for m in methods)]
    heads = ["method", *(scene.replace(", ", ",<br>") for scene in shown), "FLIP", "worst"]
    rows = [_row(heads), _row(["---"] * len(heads))]
    for method in methods:
        summaries = [by_scene[scene].get(method) for scene in shown]
        known = [summary for summary in summaries if summary]
        name = method + (" (model)" if known[0].aside == MODEL else "")
        rows.append(_row([name, *map(_cell, summaries), *_spans(known)]))
    return rows


def _ages(methods: Sequence[str], by_scene: Mapping[str, ByMethod]) -> list[str]:
    """A row for each motion: the error by the order's age, which no machine has a part in."""
    scenes: dict[str, ByMethod] = {}
    for scene, known in by_scene.items():
        scenes.setdefault(scene.split(",")[0], known)
    found = {method: match for method in methods if (match := AGED.match(method))}
    ages = list(dict.fromkeys(match[2] for match in found.values()))
    cells: dict[str, dict[str, str]] = defaultdict(dict)
    for method, match in found.items():
        spreads = [known[method].values["psnr"] for known in scenes.values() if method in known]
        cells[match[1] + match[3]][match[2]] = ", ".join(f"{psnr:.1f}" for _, psnr, _ in spreads)
    rows = [_row([f"PSNR [dB] of {', '.join(scenes)}, by age in frames", *ages])]
    rows += [_row(["---"] * (len(ages) + 1))]
    rows += [
        _row([motion, *(by_age.get(age, "") for age in ages)]) for motion, by_age in cells.items()
    ]
    return rows


DIGITS = {"flip": 4, "worst": 3}  # that are shown


def _spans(known: Sequence[Summary]) -> list[str]:
    low, high = (
        [round(f([s.values[k][1] for s in known]), n) for k, n in DIGITS.items()]
        for f in (min, max)
    )
    return [f"{a:g}" if a == b else f"{a:g} to {b:g}" for a, b in zip(low, high, strict=True)]


def _cell(summary: Summary | None) -> str:
    """Time and error of a method in a scene."""
    if not summary:
        return ""
    low, middle, _ = summary.values["psnr"]
    time = f"{summary.ms[1]:.3g}; " if summary.ms else ""
    return f"{time}**{middle:.1f}** ({low:.1f})"


def _row(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"
