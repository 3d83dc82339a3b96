"""Converts a scene to a format that other tools read, and prints what the format lost.

To .xml, MJCF, it writes the scene's solid parts as boxes, for MuJoCo and what reads its models.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable
from dataclasses import replace

from tqdm import tqdm

from rosplat_core.first_look import cameras_beside, sample
from rosplat_core.formats import (
    SUFFIXES,
    SceneError,
    axes,
    check_new_file,
    check_output,
    load,
    save,
)  # fmt: skip
from rosplat_core.log_text import counted, shown
from rosplat_core.models import Model
from rosplat_core.program.output import say, told
from rosplat_core.program.progress import watched
from rosplat_core.round_trip import report
from rosplat_core.scenes import NAMES, load_scene
from rosplat_core.splats import LONGEST_ERROR
from rosplat_core.upright import find_up, standing_pose
from rosplat_tools.simulation.solids import RESOLUTION, save_solids, solids

MJCF = ".xml"


def main(arguments: list[str] | None = None) -> int:
    """Reads one scene and writes it as another; 1 when that failed."""
    parser = argparse.ArgumentParser(
        prog="convert",
        description=__doc__,
        epilog="Coordinates stay as they are in the input. In MJCF the scene stands upright, its "
        "ground at z = 0; the site named map has the pose of the input's coordinates.",
    )
    parser.add_argument("input", help=f"scene: {NAMES}")
    parser.add_argument("output", help=f"file to write ({SUFFIXES}, {MJCF})")
    parser.add_argument(
        "--sh-degree",
        type=int,
        choices=range(4),
        help="cut off higher bands of spherical harmonics",
    )
    parser.add_argument(
        "--model",
        choices=list(map(str, Model)),
        help="how the splats were trained to become pixels, where the input doesn't say",
    )
    parser.add_argument(
        "--resolution",
        type=_edge,
        default=RESOLUTION,
        help=f"of {MJCF}: edge of a voxel [m] (%(default)s)",
    )
    parser.add_argument(
        "--filled", action="store_true", help=f"of {MJCF}: hollows closed on all sides are solid"
    )
    parser.add_argument("--overwrite", action="store_true", help="replace an output that exists")
    options = parser.parse_args(arguments)

    def warn(text: str) -> None:
        tqdm.write(f"convert: {text}", file=sys.stderr)

    try:
        if options.output.lower().endswith(MJCF):
            say(_write_solids(options, warn))
            return 0
        check_output(options.output, options.overwrite)
        with watched("reading") as progress:
            splats = load_scene(options.input, progress, warn)
        if options.sh_degree is not None:
            splats = splats.with_sh_degree(min(options.sh_degree, splats.sh_degree))
        if options.model:
            splats = replace(splats, model=Model.of(options.model))
        written = save(options.output, splats, overwrite=options.overwrite)
        with watched("reading back") as progress:
            back = load(options.output, progress, warn)
        read_as = axes(options.output)
        errors = report(written, back)
    except (SceneError, MemoryError) as error:
        print(f"convert: {told(error)}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130
    output = shown(options.output, LONGEST_ERROR)
    say(f"{output}: {len(back):,} splats, SH degree {back.sh_degree}, model {back.model}")
    say(errors)
    if read_as.up not in (None, splats.up):
        warn(f"programs that read {output} take its axes for {read_as.text}")
    return 0


def _write_solids(options: argparse.Namespace, warn: Callable[[str], None]) -> str:
    """Writes MJCF; returns what was written. Raises SceneError."""
    check_new_file(options.output, options.overwrite)
    with watched("reading") as progress:
        splats = load_scene(options.input, progress, warn)
    some = sample(splats)
    up = some.up if some.up is not None else find_up(some, cameras_beside(options.input))
    pose = standing_pose(some, up)
    boxes = solids(splats, pose, options.resolution, filled=options.filled)
    save_solids(options.output, boxes, pose, shown(options.input))
    return (
        f"{shown(options.output, LONGEST_ERROR)}: {counted(len(boxes), 'box', 'boxes')} of voxels "
        f"of {options.resolution:g} m, up is {' '.join(f'{part:.2f}' for part in up)}"
    )


def _edge(text: str) -> float:
    """A voxel's edge. Raises argparse's error."""
    try:
        edge = float(text)
    except ValueError:
        edge = math.nan
    if not 0.005 <= edge <= 10:
        raise argparse.ArgumentTypeError(f"expected 0.005 to 10 m, got '{shown(text)}'")
    return edge


if __name__ == "__main__":
    sys.exit(main())
