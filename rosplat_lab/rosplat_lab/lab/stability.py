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
    """What the figures of a case mean."""

    happens: str
    survives: str
    ours: str
    warns: str = ""
    """When the Display's Status does, where the failure stays."""


NOTES = {
    "wide_view": Note(
        "EWA replaces the projection by its tangent at each mean. Away from the picture's "
        "middle, and the larger a splat is in angle, the more of its true shape is lost.",
        "Evaluating each ray (3DGRT, 3DGUT). No EWA renderer does, ours included, nor should it "
        "for maps that were trained with EWA: they look right only as they were trained.",
        "Draws what EWA in float64 draws, at any angle. The "
        "tangent is clamped at 1.3 times the picture's edge, as in training.",
        warns="a view reaches more than 50 degrees to a side.",
    ),
    "near_plane": Note(
        "A splat is drawn until its mean crosses the near plane, then it is gone in one frame.",
        "Fading it out earlier: the more metres, the softer.",
        "*Near Fade*, off by default, because it changes pictures that were trained without. "
        "For flying through a map, a fifth of a metre will do.",
    ),
    "inside": Note(
        "Around the camera, splats cover the whole picture, and their ellipses leave every "
        "number format that was made for pixels.",
        "Float32 with the footprint bounded by the alpha cut.",
        "Stays with the reference; the depth of layers is what half floats feel, not the size.",
    ),
    "shapes": Note(
        "The area of a needle's ellipse is a difference of two nearly equal products: in "
        "float32 it turns negative, the needle vanishes or flashes.",
        "The determinant as the squared length of a cross product (Cauchy-Binet), and the low-pass"
        " filter's share added to it afterwards.",
        "That is what `splat_project.comp` does.",
    ),
    "zoomed_out": Note(
        "The +0.3 px² that training adds makes splats smaller than a pixel too large: seen from "
        "afar, a map grows fat and bright. Against the area average of a picture 8 times as "
        "fine.",
        "Opacity compensation (Mip-Splatting).",
        "*Antialiasing*: As Trained by default, since a map trained without compensation needs "
        "the fat near by. For overviews, set it to On.",
        warns="most splats in view have a standard deviation below half a pixel, uncompensated.",
    ),
    "huge": Note(
        "A splat of a kilometre's size, as sky or background, three of its sizes away.",
        "Float32 reaches to 1e8 px of standard deviation.",
        "As the reference, to ten thousand kilometres; what lies beyond the depth buffer's far "
        "plane is drawn as sky.",
    ),
    "orthographic": Note(
        "There is no centre of projection: a view direction taken from one is wrong everywhere.",
        "One direction for all splats.",
        "That. Culling and order know orthographic cameras as well.",
    ),
    "viewports": Note(
        "Buffers of the last size are drawn into, or read from, after a resize; tiles end where "
        "the picture doesn't; the order at hand was culled for the old size, here half as wide.",
        "Targets of the viewport's very size, and a new order.",
        "A new target with each new size; one pixel or a thousand, the picture is right. With the "
        "order of the narrower view it lacks what came in, until the next one is there: a graphics "
        "card has it in the same frame.",
    ),
    "off_centre": Note(
        "Stereo and walls of screens look beside the optical axis. There, the tangent at which the "
        "Jacobian stops to grow is not the same to both sides, and a cull that takes the picture "
        "to be centred loses its border.",
        "Clamp and cull by the picture's own edges.",
        "That, in pixels that aren't square, too.",
    ),
    "far_away": Note(
        "In UTM coordinates or a planet's, float32 keeps centimetres to metres: splats jump to "
        "a lattice.",
        "Rebasing in float64 before anything is float32.",
        "The map's origin and the camera's position stay float64, the GPU sees differences. A "
        "publisher that sends large float32 positions without an origin has lost them already. "
        "In rviz2, whose own cameras and frames are float32, choose a Fixed Frame near what you "
        "look at.",
        warns=(
            "most splats are smaller than eight steps of their positions' floats, or rviz2's own "
            "floats move what is in view by half a pixel."
        ),
    ),
    "scaled": Note(
        "The unit of a map without scale (monocular SLAM) is arbitrary, and a map may have to "
        "be mirrored to be right-handed.",
        "Everything relative: no metres in any threshold.",
        "The same picture over twelve decades, and mirrored by quaternions and harmonics.",
    ),
    "sheared": Note(
        "A shear is no motion: who applies one to a map must apply it to covariances as well. "
        "With the means alone the map tears.",
        "Singular values: M R S is another rotation times other scales. Harmonics can't follow, "
        "so the case is without.",
        "TF knows rigid transforms only and a batch holds quaternions and scales, so the Display "
        "never meets a shear; what a publisher shears by singular values is drawn as the reference "
        "draws it.",
    ),
    "outliers": Note(
        "Linear keys divide the depths from the nearest to the farthest splat: one stray far "
        "away takes all their steps.",
        "Float keys, whatever their width, and adaptive ones.",
        "All 32 bits of the float on every backend; the GPU's radix sort leaves out the bits "
        "that all keys have in common, which stays exact.",
    ),
    "depth_range": Note(
        "Depths over many decades, as from a cockpit to the horizon, starve linear keys likewise.",
        "Float keys: their steps are ratios.",
        "As above.",
    ),
    "ties": Note(
        "Splats of equal depth have no order; a sort that isn't stable, or culls in another "
        "order, draws them one way now and another way next, and a still picture flickers.",
        "A rule for ties.",
        "Of equal depths the higher slot is behind, on every backend and on the graphics card: "
        "orders are equal to the bit.",
    ),
    "stale_turning": Note(
        "An order by z depends on where the camera looks and on nothing else. Turning spoils it "
        "slowly; what spoils the picture first is that splats were culled for the old view and "
        "are missing at the border.",
        "Culling for a wider view: the order is then good for many degrees.",
        "On a graphics card that sorts for itself no order is old. Elsewhere the last one is "
        "drawn for a quarter of a second at most, and orders are culled for a view wider than the "
        "picture, at the price of some 3 % more splats.",
        warns="an order is older than a second, as of a sidecar that ended while *Order Source* "
        "waits for it.",
    ),
    "stale_orbit": Note(
        "Orbiting turns the camera as well, but what it looks at stays in the picture.",
        "As above; less is missing.",
        "As above.",
    ),
    "stale_dolly": Note(
        "Moving without turning leaves the order by z exact, however far. Going backwards lacks "
        "what was culled.",
        "A last order, culled for a wider view.",
        "As above.",
    ),
    "popping": Note(
        "Under rotation, splats of nearly the same z change places; where they overlap, pixels "
        "jump. A frame drawn with the last frame's order shows how much of the change is that.",
        "Orders by distance, which turning leaves alone, and sorting for each pixel. For a map "
        "trained by z both are other pictures: see the chart.",
        "By z, as maps are trained: what pops here popped in training.",
    ),
    "edits": Note(
        "Between the map's edit and the next order, moved splats are drawn at their old places "
        "in the order, new ones not at all.",
        "Merging what changed into the order that there is.",
        "The built-in sorter does, within a frame or two, from the edit's own slots.",
    ),
    "layers": Note(
        "Each blend rounds. Mesa's software renderer cuts half floats off instead of rounding "
        "them: there the error of thousands of layers adds up, and RGBA8 with rounding is "
        "better.",
        "Float32; half floats where the driver rounds (NVIDIA's does).",
        "32-bit floats wherever the processor draws, since they take no longer there; on a "
        "graphics card, tiles add in 32 bits whatever the target. *Float Blending* for its quads.",
    ),
    "faint": Note(
        "What is fainter than 1/255 isn't drawn. Fog of very faint splats thins out and "
        "vanishes; of stronger ones, the rims are cut.",
        "Nothing that is fast: the cut is what makes quads end. Maps are trained with it.",
        "As in training, so as the reference.",
        warns="most splats are below 1/255, by themselves or by *Alpha*.",
    ),
    "opaque": Note(
        "Alpha is capped at 0.99, so that training can see through: a lamp behind a wall shines "
        "through a layer, not through two.",
        "It is part of the model.",
        "As in training.",
    ),
    "overshoot": Note(
        "Harmonics go below 0 and above 1. Above 1 is light that the blend needs: clamped "
        "before blending, bright splats behind others darken.",
        "Clamping below, before blending, and above only when the picture is shown.",
        "That; half floats end at 65504.",
    ),
}


TITLE = "# Where methods fail\n\n"
MADE = "<!-- Made by `make lab`, from here to the end. -->\n\n"

READING = """\
## How it is measured

By `make lab`. Each table grows a difficulty and says how far pictures are from the float64
reference renderer, in dB of PSNR unless it says otherwise. Above 60 dB nobody sees a difference;
150 stands for equal. *Ours* is the real renderer with a real sorter's order, blended in 32-bit
floats unless it says otherwise. Its packed attributes (`packed_slot.hpp`) hold it to 80 dB or so;
unpacked ones reach 120 to 150. `tests/test_stability.py` holds the claims on every `make test`.
Where a failure stays and something helps, the Display's Status warns, under *Accuracy* or *Order*.
Where it is silent, the failure is gone, is part of what maps are trained with, or lasts a moment.
"""


def write(folder: Path, findings: Sequence[Finding], facts: str) -> Path:
    """Writes stability.md and stability.png into a folder."""
    make_folder(folder)
    _chart(folder / "stability.png", findings)
    lines = [READING, f"Measured on {facts}.", "", "![All curves](stability.png)"]
    for finding in findings:
        note = NOTES[finding.name]
        lines += ["", f"## {finding.title}", "", f"**What happens.** {note.happens}", ""]
        lines += [f"**What survives.** {note.survives}", "", f"**ROSplat.** {note.ours}", ""]
        lines += [f"**The Status warns** when {note.warns}", ""] if note.warns else []
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
