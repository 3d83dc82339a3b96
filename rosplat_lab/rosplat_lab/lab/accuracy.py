"""docs/accuracy.md: what each method costs in error, and what follows for the defaults."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path

from rosplat_core.program.files import write_below
from rosplat_lab.lab.methods import MODEL
from rosplat_lab.lab.pareto import Summary, front, summarise
from rosplat_lab.lab.points import Point

LESSONS = {
    "sorter": "All backends, and the renderer, find the same order: they differ in time alone.",
    "keys": "For a map trained by z, sorting by distance is as wrong as an order many frames old.",
    "keys linear": (
        "20 bits cost next to nothing, 16 little where a scene is compact; a far outlier starves "
        "them ([stability](stability.md)). 12 and fewer are seen."
    ),
    "keys float": (
        "The float's own upper bits: as good as linear ones, and no outlier starves them."
    ),
    "keys adaptive": (
        "Equal counts a step spend steps where splats are many, not where they overlap: worse "
        "than linear keys, except with outliers."
    ),
    "age rotation, 1/s": (
        "A frame's turn costs more than 16-bit keys. Orders are culled for a view 1.25 times as "
        "wide as the picture."
    ),
    "age orbit, 1/s": (
        "Almost the same as under rotation: the order depends only on where the camera looks."
    ),
    "age dolly, 1/s": "Moving towards the scene without turning costs nothing.",
    "age rotation, 1/s, culled 1x": (
        "The same orders, culled for the picture alone: splats missing at the border hurt more "
        "than the order does (see the lowest tenth)."
    ),
    "age rotation, 1/s, culled 1.5x": "Wider still: no better than 1.25 at these angles.",
    "blend": (
        "Half floats are below what is seen, more so where the driver rounds them (Mesa's software "
        "renderer cuts them off: so there the Display blends in 32 bits, which takes the processor "
        "no longer). Tiles add in 32-bit floats whatever the target. Eight bits show in gradients, "
        "front to back everywhere. Multisampling only changes quads' rims."
    ),
    "order of pixels": "No popping, but not what maps are trained for.",
    "order-free": "No sort at all: another picture.",
    "stochastic": "6 dB for four times the samples: noise that only hundreds of them hide.",
    "cut-off": (
        "Quads must reach the 1/255 ellipse, 3.33 sigma; the customary sqrt 8 is not enough."
    ),
    "SH degree": "The costliest way to save, and it saves no time: cut no band that was trained.",
    "precision": (
        "16-bit floats will do for all attributes but positions, which need a centre near by."
    ),
    "packed": "8 bits for harmonics are fine for sending, 4 are not.",
    "budget": "The least visible splats, by opacity times area: a steep price.",
    "least size": (
        "Leaving out what is smaller than half a pixel costs one scene nothing, the other 26 dB."
    ),
    "other viewers": (
        "RVizSplat and the system of the ROSplat paper, modelled after their public sources "
        "(`lab/viewers.py` says what is and what isn't). RVizSplat's model is within 0.1 dB of the "
        "error, and 51 to 57 dB of the very pixels, of its pictures in rviz2 on an H200, of four "
        "views of two scenes (no command of this repository repeats that); its frames are timed in "
        "[performance](performance.md). The paper's system raises colours to 1/2.2 before it "
        "blends, which the maps were not trained for; without that it is as good as RGBA8 is."
    ),
}

TITLE = "# Error against time\n\n"
MADE = "<!-- Made by `make lab`, from here to the end. -->\n\n"

READING = """\
## How to read the tables

Each method draws the same views; the reference renderer blends every splat of them in exact order.
A cell holds two times in ms, of a frame (sorting and drawing) and from a camera's pose to the
finished picture drawn with its order; then the PSNR in dB. These are medians over the views, with
the 10 % and 90 % quantiles in brackets. SSIM, FLIP and the worst pixel (1 is white for black) are
medians by scene, from the lowest to the highest. Orders are drawn in 32-bit floats, so that the
error is that of the method alone. *Models* are NumPy models of what the renderer doesn't do, and
have no time. An age is under motion of so many rad/s, or distances to the scene a second, at 60
frames a second; its order is on its way for as many frames longer.
"""


def write(folder: Path, points: Sequence[Point], remark: str = "") -> Path:
    """Writes accuracy.md into a folder; its pictures are those of `charts`."""
    scenes = list(dict.fromkeys(point.scene for point in points))
    by_scene = {
        scene: {s.method: s for s in summarise(p for p in points if p.scene == scene)}
        for scene in scenes
    }
    families: dict[str, list[str]] = defaultdict(list)
    for point in points:
        if point.method not in families[point.family]:
            families[point.family].append(point.method)
    lines = ["![Error against time](accuracy.png)", "", "![Curves](accuracy-curves.png)", ""]
    lines += ["Methods that none beats in both time and PSNR:", ""]
    for scene in scenes:
        best = [s.method for s in front(by_scene[scene].values())]
        lines += [f"- {scene}: {'; '.join(best)}"] if best else []
    lines += ["", READING]
    for family, methods in families.items():
        shown = [scene for scene in scenes if any(m in by_scene[scene] for m in methods)]
        heads = ["method", *(scene.replace(", ", ",<br>") for scene in shown)]
        lines += [f"## {family[0].upper()}{family[1:]}", "", LESSONS.get(family, ""), ""]
        lines += _row([*heads, "SSIM", "FLIP", "worst"]), _row(["---"] * (len(heads) + 3))
        for method in methods:
            summaries = [by_scene[scene].get(method) for scene in shown]
            known = [summary for summary in summaries if summary]
            name = method + (" (model)" if known[0].aside == MODEL else "")
            low, high = (
                [round(f([s.values[k][1] for s in known]), n) for k, n in DIGITS.items()]
                for f in (min, max)
            )
            rest = [
                f"{a:g}" if a == b else f"{a:g} to {b:g}" for a, b in zip(low, high, strict=True)
            ]
            lines.append(_row([name, *map(_cell, summaries), *rest]))
        lines.append("")
    runs = dict.fromkeys((p.command, p.gpu, p.machine, p.commit) for p in points)
    lines += ["## Runs", "", *(f"- `{c}`: {g}, {m}, commit {v}" for c, g, m, v in runs)]
    lines += ["", remark] if remark else []
    path = folder / "accuracy.md"
    write_below(path, TITLE, MADE, "\n".join(lines) + "\n")
    return path


DIGITS = {"ssim": 5, "flip": 4, "worst": 3}  # that are shown


def _cell(summary: Summary | None) -> str:
    """Times and error of a method in a scene."""
    if not summary:
        return ""
    low, middle, high = summary.values["psnr"]
    times = ""
    if summary.ms and summary.pose_ms:
        times = f"{summary.ms[1]:.3g}, {summary.pose_ms[1]:.3g}; "
    return f"{times}**{middle:.1f}** ({low:.1f}, {high:.1f})"


def _row(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"
