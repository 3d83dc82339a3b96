"""Converts a scene to a format that other tools read, and prints what the format lost.

To .xml, MJCF, it writes the scene's solid parts as boxes, for MuJoCo and what reads its models. To
.npz it writes distances to the scene's surfaces, for planners (see DistanceField).
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from tqdm import tqdm

from rosplat_core.distances import DistanceField
from rosplat_core.first_look import cameras_beside, sample
from rosplat_core.formats import (
    SUFFIXES,
    InputError,
    axes,
    check_new_file,
    check_output,
    load,
    save,
)  # fmt: skip
from rosplat_core.log_text import counted, shown
from rosplat_core.models import Model
from rosplat_core.occupancy import RESOLUTION
from rosplat_core.program.output import say, told
from rosplat_core.program.progress import watched
from rosplat_core.program.typed_numbers import number
from rosplat_core.round_trip import report
from rosplat_core.scenes import NAMES, load_scene
from rosplat_core.splats import LONGEST_ERROR, Splats
from rosplat_core.upright import find_up, standing_pose
from rosplat_tools.simulation.solids import save_solids, solids

MJCF, FIELD = ".xml", ".npz"


def main(arguments: list[str] | None = None) -> int:
    """Reads one scene and writes it as another; 1 when that failed."""
    parser = argparse.ArgumentParser(
        prog="convert",
        description=__doc__,
        epilog="Coordinates stay as they are in the input. In MJCF and fields of distances, the "
        "scene stands upright, its ground at z = 0. The site named map of MJCF, and map_pose of a "
        "field, have the pose of the input's coordinates.",
    )
    parser.add_argument("input", help=f"scene: {NAMES}")
    parser.add_argument("output", help=f"file to write ({SUFFIXES}, {MJCF}, {FIELD})")
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
        "--box",
        nargs=6,
        type=float,
        metavar=("X", "Y", "Z", "X", "Y", "Z"),
        help="keep the splats whose centres are between these two corners, of coordinates of the "
        "input [m]",
    )
    parser.add_argument(
        "--where",
        metavar="CHANNEL=VALUE",
        help="keep the splats with this value of a channel, such as label=3",
    )
    parser.add_argument(
        "--rest", action="store_true", help="keep all others of --box and --where instead"
    )
    parser.add_argument(
        "--resolution",
        type=number("voxel's edge in metres", 0.005, 10.0),
        default=RESOLUTION,
        help=f"of {MJCF} and {FIELD}: edge of a voxel [m] (%(default)s)",
    )
    parser.add_argument(
        "--filled",
        action="store_true",
        help=f"of {MJCF} and {FIELD}: hollows closed on all sides are solid",
    )
    parser.add_argument("--overwrite", action="store_true", help="replace an output that exists")
    options = parser.parse_args(arguments)

    def warn(text: str) -> None:
        tqdm.write(f"convert: {text}", file=sys.stderr)

    try:
        if options.output.lower().endswith((MJCF, FIELD)):
            say(_write_shape(options, warn))
            return 0
        check_output(options.output, options.overwrite)
        with watched("reading") as progress:
            splats = _cut(load_scene(options.input, progress, warn), options)
        if options.sh_degree is not None:
            splats = splats.with_sh_degree(min(options.sh_degree, splats.sh_degree))
        if options.model:
            splats = replace(splats, model=Model.of(options.model))
        written = save(options.output, splats, overwrite=options.overwrite)
        with watched("reading back") as progress:
            back = load(options.output, progress, warn)
        read_as = axes(options.output)
        errors = report(written, back)
    except (InputError, MemoryError) as error:
        print(f"convert: {told(error)}", file=sys.stderr)
        return 1
    output = shown(options.output, LONGEST_ERROR)
    say(f"{output}: {len(back):,} splats, SH degree {back.sh_degree}, model {back.model}")
    say(errors)
    if read_as.up not in (None, splats.up):
        warn(f"programs that read {output} take its axes for {read_as.text}")
    return 0


def _write_shape(options: argparse.Namespace, warn: Callable[[str], None]) -> str:
    """Writes the shape of the upright scene; returns what was written. Raises InputError."""
    check_new_file(options.output, options.overwrite)
    with watched("reading") as progress:
        splats = _cut(load_scene(options.input, progress, warn), options)
    some = sample(splats)
    up = some.up if some.up is not None else find_up(some, cameras_beside(options.input))
    pose = standing_pose(some, up)
    if options.output.lower().endswith(FIELD):
        field = DistanceField.of(splats, pose, resolution=options.resolution, filled=options.filled)
        field.save(options.output)
        written = f"distances of {' x '.join(map(str, field.distances.shape))} voxels"
    else:
        boxes = solids(splats, pose, options.resolution, filled=options.filled)
        save_solids(options.output, boxes, pose, shown(options.input))
        written = f"{counted(len(boxes), 'box', 'boxes')} of voxels"
    return (
        f"{shown(options.output, LONGEST_ERROR)}: {written} of {options.resolution:g} m, up is "
        f"{' '.join(f'{part:.2f}' for part in up)}"
    )


def _cut(splats: Splats, options: argparse.Namespace) -> Splats:
    """The splats that --box and --where ask for. Raises InputError."""
    kept = np.ones(len(splats), bool)
    if options.box:
        corners = np.reshape(options.box, (2, 3))
        if not np.isfinite(corners).all():
            raise InputError("--box: expected finite numbers")
        places = splats.positions.astype(np.float64) + splats.origin
        kept &= ((places >= corners.min(axis=0)) & (places <= corners.max(axis=0))).all(axis=1)
    if options.where:
        name, _, value = options.where.partition("=")
        if name not in splats.channels:
            known = ", ".join(splats.channels) or "none"
            raise InputError(
                f"--where: {shown(options.input)} has no channel {shown(name)}: {known}"
            )
        try:
            kept &= splats.channels[name] == np.float32(float(value))
        except ValueError as error:
            raise InputError(f"--where: expected {shown(name)}=NUMBER") from error
    if options.rest:
        if not (options.box or options.where):
            raise InputError("--rest: of what? It needs --box or --where")
        kept = ~kept
    if not kept.any():
        raise InputError(f"{shown(options.input)}: no splat is left")
    return splats if kept.all() else splats[kept]
