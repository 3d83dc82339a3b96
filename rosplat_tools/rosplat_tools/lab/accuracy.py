"""docs/accuracy.md: what each method costs in error, and what follows for the defaults."""

from __future__ import annotations

import os
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path

from rosplat_tools.lab.methods import MODEL
from rosplat_tools.lab.pareto import Summary, front, summarise
from rosplat_tools.lab.points import Point

LESSONS = {
    "sorter": "All backends find the same order to the bit: they differ in time alone.",
    "keys": "Sorting by distance is as wrong for a map trained by z as an order many frames old.",
    "keys linear": (
        "20 bits cost nothing, 16 little where a scene is compact; a far outlier starves them "
        "([stability](stability.md)). 12 and fewer are seen."
    ),
    "keys float": (
        "The float's own upper bits: as good as linear ones, and no outlier starves them."
    ),
    "keys adaptive": (
        "Equal counts a step spend steps where splats are many, not where they overlap: worse "
        "than linear keys, but for outliers."
    ),
    "age rotation": (
        "A frame's turn costs more than 16-bit keys. Orders are culled for a view 1.25 times as "
        "wide as the picture."
    ),
    "age orbit": "The same order as under rotation: it depends on where the camera looks alone.",
    "age dolly": "Moving without turning costs nothing.",
    "age rotation, culled 1x": (
        "The same orders, culled for the picture alone: past a few frames it is what came in at "
        "the border that hurts, not the order."
    ),
    "age rotation, culled 1.5x": "Wider still: worth it past ten degrees only.",
    "blend": (
        "Half floats are below what is seen, as long as the driver rounds them (Mesa's "
        "software renderer cuts them off). Eight bits are seen in gradients, front to back "
        "all over."
    ),
    "tiles": "Compute shaders blend front to back in 32-bit floats, whatever the target.",
    "order of pixels": "Without popping, but not what maps are trained for.",
    "order-free": "No sort at all: another picture.",
    "stochastic": "6 dB for four times the samples: noise that only hundreds of them hide.",
    "cut-off": (
        "Quads must reach the 1/255 ellipse, 3.33 sigma; the customary sqrt 8 is not enough."
    ),
    "SH degree": "The dearest of all savings: cut no band that was trained.",
    "precision": "16-bit floats are free for all attributes; positions need a middle near by.",
    "packed": "8 bits for harmonics are fine for sending, 4 are not.",
    "budget": (
        "The least visible splats, by opacity times area: the only dial here that saves much "
        "time where drawing is the cost, and a steady one."
    ),
    "least size": "Below half a pixel nothing is lost; nothing much is saved either.",
    "least worth": (
        "Splats whose alphas add up to less than so many pixels: needs no sort to find them, "
        "and far views gain the most."
    ),
    "quality": (
        "The Display's *Quality*. Exact: a fresh order, kept in 32-bit floats. Balanced: 16-bit "
        "floats, and under motion (1 rad/s here) the last frame's order, culled for a picture a "
        "quarter wider; at rest it is as good as its blending. Fast: besides, nothing that adds up "
        "to less than a pixel. None cuts harmonics or bits of keys: they cost much and save little."
    ),
}

INTRODUCTION = """\
# Error against time

Made by `make lab`: each method draws the same views, the float64 reference renderer blends every
splat of them in exact order. Figures are medians over the views, in brackets the 10 % and 90 %
quantiles; PSNR in dB, the worst pixel in 8-bit grey levels. Orders are drawn in 32-bit floats, so
that only what a method varies makes its error. Models are NumPy models of what the renderer doesn't
do, and have no time. An age is under motion of 1 rad/s, or of the distance to the scene a second,
at 60 frames a second.
"""


def write(folder: Path, points: Sequence[Point]) -> Path:
    """Writes accuracy.md into a folder; its pictures are those of `charts`."""
    summaries = summarise(points)
    families: dict[str, list[Summary]] = defaultdict(list)
    for summary in summaries:
        families[summary.family].append(summary)
    scenes = ", ".join(dict.fromkeys(point.scene for point in points))
    views = len({(point.scene, point.camera) for point in points})
    facts = ", ".join(dict.fromkeys(f"{p.gpu}, {p.machine}, commit {p.commit}" for p in points))
    lines = [
        INTRODUCTION,
        f"{views} views of {scenes}; {facts}.",
        f"`{points[0].command}`",
        *_caution(),
        "",
        "![Error against time](accuracy.png)",
        "",
        "![Curves](accuracy-curves.png)",
        "",
        "Beaten by nobody in both time and PSNR, fastest first: "
        + ", ".join(summary.method for summary in front(summaries))
        + ".",
    ]
    for family, members in families.items():
        lines += ["", f"## {family[0].upper()}{family[1:]}", "", LESSONS.get(family, ""), ""]
        lines += [
            "| method | frame | pose to draw | PSNR | SSIM | FLIP | worst |",
            "| --- | --- | --- | --- | --- | --- | --- |",
        ]
        lines += [_row(summary) for summary in members]
    path = folder / "accuracy.md"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def _caution() -> list[str]:
    """What to say of the times where the machine has more to do than this."""
    load, cores = os.getloadavg()[0], len(os.sched_getaffinity(0))
    if load < 2 * cores:
        return []
    return ["", f"The machine was busy (load {load:.0f}, {cores} cores): errors hold, times don't."]


def _row(summary: Summary) -> str:
    low, middle, high = summary.values["psnr"]
    cells = [
        summary.method + (f" ({summary.aside})" if summary.aside == MODEL else ""),
        f"{summary.ms[1]:.3g}" if summary.ms else "",
        f"{summary.pose_ms[1]:.3g}" if summary.pose_ms else "",
        f"**{middle:.1f}** ({low:.1f}, {high:.1f})",
        f"{summary.values['ssim'][1]:.5f}",
        f"{summary.values['flip'][1]:.4f}",
        f"{255 * summary.values['worst'][1]:.0f}",
    ]
    return "| " + " | ".join(cells) + " |"
