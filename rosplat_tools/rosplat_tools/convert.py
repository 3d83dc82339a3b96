"""Converts a scene to a format that other tools read, and prints what the format lost."""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace

from tqdm import tqdm

from rosplat_core.formats import SUFFIXES, SceneError, axes, check_output, load, save
from rosplat_core.log_text import shown
from rosplat_core.models import Model
from rosplat_core.program.output import say, told
from rosplat_core.program.progress import watched
from rosplat_core.round_trip import report
from rosplat_core.scenes import NAMES, load_scene
from rosplat_core.splats import LONGEST_ERROR


def main(arguments: list[str] | None = None) -> int:
    """Reads one scene and writes it as another; 1 when that failed."""
    parser = argparse.ArgumentParser(
        prog="convert", description=__doc__, epilog="Coordinates stay as they are in the input."
    )
    parser.add_argument("input", help=f"scene: {NAMES}")
    parser.add_argument("output", help=f"scene to write ({SUFFIXES})")
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
    parser.add_argument("--overwrite", action="store_true", help="replace an output that exists")
    options = parser.parse_args(arguments)

    def warn(text: str) -> None:
        tqdm.write(f"convert: {text}", file=sys.stderr)

    try:
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


if __name__ == "__main__":
    sys.exit(main())
