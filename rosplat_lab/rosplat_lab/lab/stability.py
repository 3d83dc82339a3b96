"""docs/stability.md: what the atlas found, and what it means."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from PIL import Image

from rosplat_core.program.files import write_below
from rosplat_lab.arguments import make_folder
from rosplat_lab.lab.atlas import Finding
from rosplat_lab.lab.charts import STYLE

COLUMNS = 3  # of the picture


@dataclass(frozen=True)
class Note:
    """What a case is, and what to do about it."""

    happens: str
    helps: str
    ours: str
    warns: str = ""
    """When the Display's Status does, where the failure stays."""


NOTES = {
    "wide_view": Note(
        "EWA replaces the projection by its tangent at each mean. Large splats away from the "
        "picture's middle lose their true shape.",
        "Evaluating each ray (3DGRT, 3DGUT), for maps that are trained so.",
        "Draws what EWA in float64 draws, at any angle, as maps are trained. The tangent is "
        "clamped at 1.3 times the picture's edge, as in training.",
        warns="a view reaches more than 50 degrees to a side.",
    ),
    "near_plane": Note(
        "A splat is drawn until its mean crosses the near plane, and is gone in the next frame.",
        "Fading splats out before the plane.",
        "*Near Fade*, off by default since it changes pictures. A fifth of a metre suits flights "
        "through a map.",
    ),
    "inside": Note(
        "Splats around the camera cover the whole picture. Their ellipses exceed number formats "
        "that are made for pixels.",
        "Float32, with the footprint bounded by the alpha cut.",
        "Stays with the reference. Half floats suffer from the number of layers, not the size.",
    ),
    "shapes": Note(
        "The area of a needle's ellipse is a difference of nearly equal products. In float32 it "
        "turns negative, and the needle vanishes or flashes.",
        "The determinant as the squared length of a cross product (Cauchy-Binet). The low-pass "
        "filter's share is added afterwards.",
        "Computes that in `splat_project.comp`.",
    ),
    "zoomed_out": Note(
        "The +0.3 px² of training makes splats smaller than a pixel too large. Seen from afar, a "
        "map grows fat and bright. The truth here is the area average of a picture 8 times as "
        "fine.",
        "Opacity compensation (Mip-Splatting).",
        "*Antialiasing* is As Trained by default, since such maps need the filter near by. Set it "
        "to On for overviews.",
        warns="most splats in view have a standard deviation below half a pixel, uncompensated.",
    ),
    "huge": Note(
        "Sky and background are splats of a kilometre's size, three of their sizes away.",
        "Float32, up to 1e8 px of standard deviation.",
        "Stays with the reference up to ten thousand kilometres. What lies beyond the far plane "
        "is drawn as sky.",
    ),
    "orthographic": Note(
        "There is no centre of projection, so a view direction from one is wrong everywhere.",
        "One direction for all splats.",
        "Uses one direction. Culling and order know orthographic cameras as well.",
    ),
    "viewports": Note(
        "After a resize, buffers have the last size, and the order at hand was culled for it: "
        "here, for half the width.",
        "Targets of the viewport's size, and a new order.",
        "Makes a new target for each size. With the order of the narrower view, the picture lacks "
        "what came in, until the next order. A graphics card has that in the same frame.",
    ),
    "off_centre": Note(
        "Stereo and walls of screens look beside the optical axis. The Jacobian's clamp is not "
        "the same to both sides there, and a cull for a centred picture loses its border.",
        "Clamping and culling by the picture's own edges.",
        "Does that, also for pixels that aren't square.",
    ),
    "far_away": Note(
        "In UTM or planetary coordinates, float32 keeps centimetres to metres: splats jump to a "
        "lattice.",
        "Rebasing in float64 before anything is float32.",
        "The map's origin, its place by TF and the camera's position stay float64. A publisher of "
        "large float32 positions without an origin has lost them already. rviz2's own cameras are "
        "float32: choose a Fixed Frame near what you look at.",
        warns=(
            "most splats are smaller than eight steps of their positions' floats, or rviz2's own "
            "floats move what is in view by half a pixel."
        ),
    ),
    "scaled": Note(
        "Monocular SLAM has an arbitrary unit, and a map may be mirrored to be right-handed.",
        "No threshold in metres.",
        "Draws the same picture over twelve decades, also mirrored.",
    ),
    "sheared": Note(
        "A shear must be applied to covariances as well as to means, or the map tears.",
        "Singular values: M R S is another rotation times other scales. Harmonics can't follow, "
        "so this case has none.",
        "Never meets a shear: TF is rigid, and a batch holds quaternions and scales. What a "
        "publisher shears by singular values is drawn as the reference draws it.",
    ),
    "outliers": Note(
        "Linear keys divide the depths from the nearest to the farthest splat. One far stray takes "
        "all their steps.",
        "Float keys of any width, and adaptive keys.",
        "Sorts all 32 bits of the float on every backend.",
    ),
    "depth_range": Note(
        "Depths over many decades starve linear keys likewise.",
        "Float keys: their steps are ratios.",
        "As above.",
    ),
    "ties": Note(
        "Splats of equal depth have no order. A sort that isn't stable draws them in another "
        "order each time, and a still picture flickers.",
        "A rule for ties.",
        "Of equal depths the higher slot is behind, on every backend and on the graphics card. "
        "Orders are equal to the bit.",
    ),
    "stale_turning": Note(
        "An order by z depends only on where the camera looks. Turning spoils it slowly. Splats "
        "that were culled for the old view are missing sooner.",
        "Culling for a wider view.",
        "No order is old on a graphics card that sorts for itself. Elsewhere the last order is "
        "drawn for a quarter of a second at most, and culled for a wider view, for some 3 % more "
        "splats.",
        warns="an order is older than a second, as of a sidecar that ended while *Order Source* "
        "waits for it.",
    ),
    "stale_orbit": Note(
        "Orbiting turns the camera as well, but what it looks at stays in the picture.",
        "As above.",
        "As above.",
    ),
    "stale_dolly": Note(
        "Moving without turning leaves the order by z exact. Going backwards lacks what was "
        "culled.",
        "As above.",
        "As above.",
    ),
    "popping": Note(
        "Under rotation, splats of nearly the same z change places, and pixels jump where they "
        "overlap. A frame with the last frame's order shows how much of the change that is.",
        "Orders by distance, and sorting for each pixel. Both are other pictures for a map that "
        "was trained by z.",
        "Sorts by z, as maps are trained.",
    ),
    "edits": Note(
        "Until the next order, moved splats are drawn at their old places in the order, and new "
        "splats not at all.",
        "Merging what changed into the order.",
        "The built-in sorter merges within a frame or two, from the edit's own slots.",
    ),
    "layers": Note(
        "Each blend rounds. Mesa's software renderer cuts half floats off instead, and the error "
        "of thousands of layers adds up.",
        "Float32, or half floats where the driver rounds (NVIDIA's does).",
        "Uses 32-bit floats wherever the processor draws, at no cost. On a graphics card tiles add "
        "in 32 bits; *Float Blending* is for quads.",
    ),
    "faint": Note(
        "What is fainter than 1/255 isn't drawn. Fog of very faint splats vanishes, and stronger "
        "fog loses its rims.",
        "Nothing fast: the cut is what makes splats end. Maps are trained with it.",
        "Cuts as in training.",
        warns="most splats are below 1/255, by themselves or by *Alpha*.",
    ),
    "opaque": Note(
        "Alpha is capped at 0.99, so that training can see through. A lamp shines through one "
        "layer, not through two.",
        "Nothing: it is part of the model.",
        "Caps as in training.",
    ),
    "overshoot": Note(
        "Harmonics go below 0 and above 1. Clamping light above 1 before blending darkens bright "
        "splats behind others.",
        "Clamping below 0 before blending, and above 1 only when the picture is shown.",
        "Does that. Half floats end at 65504.",
    ),
}


TITLE = "# Where methods fail\n\n"
MADE = "<!-- Made by `make lab`, from here to the end. -->\n\n"

READING = """\
## How it is measured

`make lab` makes this part of the page. Each table grows a difficulty and says how far pictures are
from the float64 reference renderer, in dB of PSNR unless it says otherwise. Above 60 dB nobody sees
a difference; 150 stands for equal. *Ours* is the real renderer with a real sorter's order, blended
in 32-bit floats unless it says otherwise. Its packed attributes hold it to some 80 dB.
`tests/test_stability.py` holds the claims on every `make test`. Where a failure stays and something
helps, the Display's Status warns, under *Accuracy* or *Order*.
"""


def write(folder: Path, findings: Sequence[Finding], facts: str) -> Path:
    """Writes stability.md and stability.png into a folder."""
    make_folder(folder)
    _chart(folder / "stability.png", findings)
    lines = [READING, f"Measured on {facts}.", "", "![All curves](stability.png)"]
    for finding in findings:
        note = NOTES[finding.name]
        lines += ["", f"## {finding.title}", "", note.happens, ""]
        lines += [f"- *What helps*: {note.helps}", f"- *ROSplat*: {note.ours}"]
        lines += [f"- *The Status warns* when {note.warns}"] if note.warns else []
        lines += [""]
        lines += _table(finding)
    path = folder / "stability.md"
    write_below(path, TITLE, MADE, "\n".join(lines) + "\n")
    return path


def _table(finding: Finding) -> list[str]:
    heads = [finding.axis, *(f"{x:g}" for x in finding.xs)]
    rows = [heads, ["---"] * len(heads)]
    rows += [[name, *(f"{y:.4g}" for y in ys)] for name, ys in finding.curves.items()]
    unit = [] if finding.unit.startswith("PSNR") else [f"Figures: {finding.unit}.", ""]
    return unit + ["| " + " | ".join(row) + " |" for row in rows]


def _chart(path: Path, findings: Sequence[Finding]) -> None:
    curves = [finding for finding in findings if len(finding.xs) > 1]
    rows = -(-len(curves) // COLUMNS)
    with plt.rc_context(STYLE | {"font.size": 8}):
        figure, grid = plt.subplots(
            rows, COLUMNS, figsize=(3.6 * COLUMNS, 3 * rows), layout="constrained", squeeze=False
        )
        for axes in grid.flat[len(curves) :]:
            axes.axis("off")
        for axes, finding in zip(grid.flat, curves, strict=False):
            for name, ys in finding.curves.items():
                axes.plot(finding.xs, ys, "o-", markersize=2.5, linewidth=1, label=name)
            positive = [x for x in finding.xs if x > 0]
            if min(finding.xs) >= 0 and positive and max(positive) / min(positive) > 50:
                if min(finding.xs) == 0:
                    axes.set_xscale("symlog", linthresh=min(positive))
                else:
                    axes.set_xscale("log")
            axes.set_title(finding.title, fontsize=9)
            axes.set_xlabel(finding.axis)
            axes.set_ylabel(textwrap.fill(finding.unit, 34))
            if finding.unit.startswith("PSNR"):  # the same everywhere: what stays, looks so
                most = max(y for ys in finding.curves.values() for y in ys)
                axes.set_ylim(0, 100 if most < 100 else 160)
            axes.legend(fontsize=7, loc="upper center", bbox_to_anchor=(0.5, -0.2))
        figure.savefig(path, dpi=100)
        plt.close(figure)
    with Image.open(path) as drawn:  # few colours: a third of the size
        small = drawn.convert("RGB").quantize(64)
    small.save(path, optimize=True)
