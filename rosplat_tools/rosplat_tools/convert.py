"""Converts a scene to .ply in the INRIA layout, which other tools read."""

from __future__ import annotations

import argparse
import sys

from tqdm import tqdm

from rosplat_tools.formats import SceneError, check_output, save
from rosplat_tools.output import say
from rosplat_tools.progress import watched
from rosplat_tools.scenes import NAMES, load_scene


def main(arguments: list[str] | None = None) -> int:
    """Reads one scene and writes it as another; 1 when that failed."""
    parser = argparse.ArgumentParser(
        prog="convert", description=__doc__, epilog="Coordinates stay as they are in the input."
    )
    parser.add_argument("input", help=f"scene: {NAMES}")
    parser.add_argument("output", help="scene to write (.ply)")
    parser.add_argument(
        "--sh-degree",
        type=int,
        choices=range(4),
        help="cut off higher bands of spherical harmonics",
    )
    parser.add_argument("--overwrite", action="store_true", help="replace an output that exists")
    options = parser.parse_args(arguments)
    try:
        check_output(options.output, options.overwrite)
        with watched("reading") as progress:
            splats = load_scene(
                options.input,
                progress,
                warn=lambda text: tqdm.write(f"convert: {text}", file=sys.stderr),
            )
        if options.sh_degree is not None:
            splats = splats.with_sh_degree(min(options.sh_degree, splats.sh_degree))
        save(options.output, splats)
    except SceneError as error:
        print(f"convert: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130
    say(f"{options.output}: {len(splats):,} splats, SH degree {splats.sh_degree}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
