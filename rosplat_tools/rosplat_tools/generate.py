"""Writes a procedural scene, the same for the same arguments: a garden, or a flat of rooms."""

from __future__ import annotations

import argparse
import sys

from rosplat_core.formats import SUFFIXES, InputError, check_output, save
from rosplat_core.generated import SCENES, generate
from rosplat_core.log_text import shown
from rosplat_core.program.output import say, told
from rosplat_core.program.progress import watched
from rosplat_core.program.typed_numbers import whole_number
from rosplat_core.splats import LONGEST_ERROR


def main(arguments: list[str] | None = None) -> int:
    """Writes a generated scene."""
    parser = argparse.ArgumentParser(prog="generate", description=__doc__)
    parser.add_argument("output", help=f"scene to write ({SUFFIXES})")
    parser.add_argument("--scene", choices=SCENES, default="garden", help="default: %(default)s")
    parser.add_argument(
        "--count",
        type=whole_number,
        default=500_000,
        help="splats, as 20k or 5M (default: %(default)s)",
    )
    parser.add_argument(
        "--seed", type=int, default=0, help="seed of the random numbers (default: %(default)s)"
    )
    parser.add_argument(
        "--sh-degree",
        type=int,
        default=3,
        choices=range(4),
        help="highest band of spherical harmonics (default: %(default)s)",
    )
    parser.add_argument("--overwrite", action="store_true", help="replace an output that exists")
    options = parser.parse_args(arguments)
    try:
        check_output(options.output, options.overwrite)
        with watched("generating") as progress:
            splats = generate(
                options.count, options.seed, options.sh_degree, progress, options.scene
            )
        save(options.output, splats, overwrite=options.overwrite)
    except (InputError, MemoryError) as error:
        print(f"generate: {told(error)}", file=sys.stderr)
        return 1
    say(f"{shown(options.output, LONGEST_ERROR)}: {options.count:,} splats")
    return 0
