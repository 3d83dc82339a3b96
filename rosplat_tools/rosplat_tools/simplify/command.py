"""Writes a scene with fewer splats that looks the same, from the scene alone.

Synthetic views measure what each splat contributes. Splats that are missed least are left out, or
merged with a neighbour. Other views check the PSNR against the whole scene, where that shows; those
that miss the bound are learnt from, until 95 % of new views keep it, three times at most. With a
path of cameras, all of these views are along the path.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import shlex
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass
from functools import cached_property, partial
from pathlib import Path

from rosplat_core.formats import SUFFIXES, check_output, load, save
from rosplat_core.models import Model
from rosplat_core.program.files import write_text
from rosplat_core.program.machine import commit, machine, peak_bytes
from rosplat_core.program.output import say, told
from rosplat_core.program.progress import watched, watched_tasks
from rosplat_core.program.typed_numbers import number, sized, whole
from rosplat_core.rendering import MOST_PSNR
from rosplat_core.scenes import NAMES, load_scene
from rosplat_core.simplification.judging import SHARE, Quality, Trial
from rosplat_core.simplification.search import FRESH, LEARNT, Simplification
from rosplat_core.simplification.views import CHECKED, HEIGHT, MARGIN, WIDTH, whereabouts
from rosplat_core.slot_order import put_in_slot_order
from rosplat_core.splats import InputError, Splats
from rosplat_tools.simplify import worst_view
from rosplat_tools.simplify.path import along

TRIES = 8  # to come below a number of bytes, or to make up for what a format loses
EXCESS = 0.05  # margin over what a format loses [dB]
GAINS = (2.5, 1.2)  # of refitting, that are tried in turn [dB]
SPARE = 0.01  # part of the splats left out beyond what a number of bytes seems to need


@dataclass(frozen=True)
class Written:
    """What a file of some splats holds."""

    splats: Splats
    bytes: int


@dataclass(frozen=True)
class Output:
    """A file that appears when all is done; until then it is a draft beside it."""

    path: Path
    drafts: ExitStack

    @cached_property
    def draft(self) -> Path:
        """Its folder is made late: a program killed while it searches leaves nothing behind."""
        return self.drafts.enter_context(_folder_beside(self.path)) / self.path.name

    def write(self, splats: Splats) -> Written:
        """Writes a draft, in place of the one before, and reads it back."""
        save(self.draft, splats, overwrite=True)
        return Written(load(self.draft, warn=lambda _: None), self.draft.stat().st_size)


def main(arguments: list[str] | None = None) -> int:
    """Runs the command; 0 if the simpler scene was written."""
    arguments = sys.argv[1:] if arguments is None else arguments
    options = _parser().parse_args(arguments)
    try:
        _simplify(options, shlex.join(["simplify", *arguments]))
    except (InputError, OSError, MemoryError) as error:
        print(f"simplify: {told(error)}", file=sys.stderr)
        return 1
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="simplify", description=__doc__,
        epilog=f"Contributions are measured in {LEARNT} or more views. {CHECKED} other views of "
        f"{WIDTH}x{HEIGHT} pixels, and {FRESH} new ones after each search, check the PSNR. The "
        "mean and the worst view are printed, too. If a bound can't be met, nothing is written, "
        "and the error says what is possible.",
    )  # fmt: skip
    parser.add_argument("input", metavar="IN", help=f"scene: {NAMES}")
    parser.add_argument("output", metavar="OUT", help=f"scene to write ({SUFFIXES})")
    parser.add_argument(
        "--psnr", type=_decibels, metavar="DB",
        help=f"keep the fewest splats of whose file {100 * SHARE:g} %% of the views reach this "
        "PSNR; at 50 a difference is hardly visible",
    )  # fmt: skip
    parser.add_argument(
        "--max-splats", type=whole(1), metavar="N", help="keep at most so many splats"
    )
    parser.add_argument(
        "--max-bytes",
        type=sized("number of bytes"),
        metavar="SIZE",
        help="keep what fits into a file of this size: 20000000, or 20M",
    )
    parser.add_argument(
        "--cameras", type=Path, metavar="FILE",
        help="only views along a path matter: a camera file (JSON); with --trajectory its first "
        "camera's intrinsics, or those of a camera_info file (YAML)",
    )  # fmt: skip
    parser.add_argument(
        "--trajectory", type=Path, metavar="FILE",
        help="poses of the optical frame along the path, each a line of time x y z qx qy qz qw; or "
        "a bag, as BAG:TOPIC if it has several topics of PoseStamped, PoseArray or Odometry",
    )  # fmt: skip
    parser.add_argument(
        "--margin", type=number("distance in metres"), metavar="METRES",
        help="how far views may be from the path (default: "
        f"{MARGIN:g} of the way to what is nearest to it), at most half the way to anything",
    )  # fmt: skip
    parser.add_argument(
        "--refine", type=number("time in minutes"), default=0.0, metavar="MINUTES",
        help="then fit the remaining splats to pictures of the scene for this long: a higher PSNR "
        "with as many splats",
    )  # fmt: skip
    parser.add_argument(
        "--report",
        type=Path,
        metavar="FILE",
        help="write the figures of all maps that were tried, as JSON",
    )
    parser.add_argument(
        "--picture", type=Path, metavar="FILE",
        help="write the view that differs most: of the scene, of what is left, and "
        f"{worst_view.TIMES} times the difference ({' or '.join(worst_view.ENDINGS)})",
    )  # fmt: skip
    parser.add_argument(
        "--overwrite",
        action="store_true",
        help="replace an output, a report or a picture that exists",
    )
    return parser


def _decibels(text: str) -> float:
    value = number("PSNR in dB")(text)
    if not 0 < value < MOST_PSNR:
        raise argparse.ArgumentTypeError(f"'{text}' is no PSNR, 0 to {MOST_PSNR:g} dB")
    return value


def _simplify(options: argparse.Namespace, command: str) -> None:
    bounds = (options.psnr, options.max_splats, options.max_bytes)
    if bounds == (None, None, None):
        raise InputError("what for? Give --psnr, --max-splats or --max-bytes")
    out = Path(options.output)
    check_output(out, options.overwrite)
    if out.exists() and _same(out, Path(options.input)):
        raise InputError(f"{out}: is the scene itself")
    for file in filter(None, (options.report, options.picture)):
        _check_beside(file, options)
    if options.picture and options.picture.suffix not in worst_view.ENDINGS:
        endings = " or ".join(worst_view.ENDINGS)
        raise InputError(f"{options.picture}: a picture ends in {endings}")
    with _folder_beside(out):
        pass  # refuses now, not after all the work
    path = along(options.cameras, options.trajectory)
    if path is None and options.margin is not None:
        raise InputError("--margin is of a path: give --cameras")
    began = time.monotonic()
    with watched("reading") as progress:
        splats = load_scene(options.input, progress, _warn)
        put_in_slot_order(splats)
    if options.refine > 0 and splats.model not in (Model.EWA, Model.EWA_ANTIALIASED):
        raise InputError(f"--refine: only EWA can be refitted; {options.input} is {splats.model}")
    try:
        whereabouts(splats)
    except InputError as error:
        raise InputError(f"{options.input}: {error}") from error
    read, processor = time.monotonic(), time.process_time()
    with ExitStack() as drafts, watched_tasks() as tell:
        output = Output(out, drafts)
        work = Simplification(splats, tell, path, options.margin)
        written = _within(work, output, *bounds, 60 * options.refine)
        work.splats = written.splats  # frees the memory of those that were written
        new = work.look_anew()
        errors = work.judge.errors(
            Trial(written.splats), progress=partial(tell, "checking the file")
        )
        quality = Quality.of(errors)
        output.draft.replace(out)
    seconds = time.monotonic() - read
    if work.steps:
        reach = f"{100 * SHARE:g} % reach"
        say(f"{'splats':>12} {'of all':>7} {reach:>10} {'mean':>6} {'worst':>6}")
    for step in sorted(work.steps, key=lambda step: -step.splats):
        say(_row(step.splats, len(splats), step.quality))
    learnt, checked = work.learnt.drawn + work.learnt.missed, len(work.judge)
    margin = work.views.margin
    within = "" if margin is None else f", all within {margin:.2g} m of the path"
    say(f"learnt from {learnt} views, checked in {checked}{within}")
    reached = int((errors[-new:] <= 10 ** (-options.psnr / 10)).sum()) if options.psnr else None
    if options.psnr:
        say(
            f"{reached} of {new} new views, which nothing was learnt from, reach "
            f"{options.psnr:g} dB"
        )
    say(
        f"{out}: {len(work.splats):,} of {len(splats):,} splats, {written.bytes:,} bytes, "
        f"{quality.psnr:.1f} dB in {100 * SHARE:g} % of the views, mean {quality.mean:.1f}, "
        f"worst {quality.worst:.1f}; {seconds:.1f} s"
    )
    if options.picture:
        worst_view.write(options.picture, *work.judge.worst(written.splats))
        say(f"wrote {options.picture}")
    if options.report:
        report = {
            "scene": options.input,
            "out": str(out),
            "splats": len(work.splats),
            "of": len(splats),
            "bytes": written.bytes,
            **asdict(quality),
            "views": {"learnt": learnt, "checked": checked, "new": new, "new_that_reach": reached}
            | ({} if margin is None else {"margin_m": margin}),
            "steps": [{"splats": s.splats, **asdict(s.quality)} for s in work.steps],
            "reading_s": read - began,
            "seconds": seconds,
            "processor_seconds": time.process_time() - processor,
            "peak_bytes": peak_bytes(os.getpid()),
            "machine": machine(),
            "commit": commit(),
            "command": command,
        }
        write_text(options.report, json.dumps(report, indent=1, allow_nan=False) + "\n")
        say(f"wrote {options.report}")


def _check_beside(report: Path, options: argparse.Namespace) -> None:
    """Raises InputError, before any work, where a file can't be written, or would be a loss."""
    if not report.parent.is_dir():
        raise InputError(f"{report}: {report.parent} is no folder")
    if report.exists() and not report.is_file():
        raise InputError(f"{report}: is no file that could be replaced")
    bag = str(options.trajectory or "").partition(":")[0]  # of BAG:TOPIC
    for file in (options.input, options.output, options.cameras, options.trajectory, bag):
        inside = report.exists() and Path(file or report).resolve() in report.resolve().parents
        if file and (inside or _same(report, Path(file))):
            raise InputError(f"{report}: is an input, or the output")
    if report.exists() and not options.overwrite:
        raise InputError(f"{report}: exists already (--overwrite replaces it)")


def _same(one: Path, other: Path) -> bool:
    """Whether two paths are of one file, which need not be there yet."""
    if one.exists() and other.exists():
        return one.samefile(other)
    return one.resolve() == other.resolve()


def _row(count: int, of: int, quality: Quality) -> str:
    share = 100 * count / of
    return (
        f"{count:12,} {share:6.1f}% {quality.psnr:10.1f} {quality.mean:6.1f} {quality.worst:6.1f}"
    )


def _within(
    work: Simplification,
    output: Output,
    psnr: float | None,
    max_splats: int | None,
    max_bytes: int | None,
    refine: float,
) -> Written:
    """Brings a map within its bounds; returns what its file will hold. Raises InputError."""
    every = work.splats
    splats, size = max_splats or len(every), max_bytes or sys.maxsize
    if psnr is None:
        written = _as_small_as(work, output, splats, size)
        if refine > 0:
            work.refine(refine)
            written = _as_small_as(work, output, splats, size)
        return written
    refitted = _refitted(work, output, psnr, refine) if refine > 0 else None
    written = refitted or _as_good_as(work, every, output, psnr)
    if len(written.splats) <= splats and written.bytes <= size:
        return written
    needed = f"{psnr:g} dB take {len(written.splats):,} splats in {written.bytes:,} bytes"
    written = _as_small_as(work, output, splats, size)
    less = work.judge(written.splats).psnr
    raise InputError(f"{output.path}: {needed}; {len(written.splats):,} splats have {less:.1f} dB")


def _as_good_as(work: Simplification, every: Splats, output: Output, psnr: float) -> Written:
    """Few splats of a PSNR. Raises InputError if the format can't have it, or all are needed."""
    bound = psnr
    of_all: float | None = None  # PSNR of the whole map in this format [dB]
    for _ in range(TRIES):
        work.shrink(bound)
        short = 0.0
        if len(work.splats) < len(every):
            written = output.write(work.splats)
            reached = work.deciding(written.splats)
            if reached >= min(psnr, work.deciding(work.splats) - EXCESS):
                return written
            short = psnr - reached
        if of_all is None:
            of_all = work.judge(output.write(every).splats).psnr
        if of_all < psnr:
            raise InputError(
                f"{output.path}: {psnr:g} dB can't be had: "
                f"its format keeps {of_all:.1f} dB of the whole map"
            )
        if len(work.splats) == len(every):
            break
        # Errors of merging and of the format add up, about.
        left = max(10 ** (-psnr / 10) - 10 ** (-of_all / 10), 1e-15)
        bound = max(bound + short + EXCESS, -10 * math.log10(left))
    could = ""
    if len(every) > 1:
        work.reduce(len(every) - 1)
        could = f": {len(work.splats):,} have {work.judge(work.splats).psnr:.1f} dB"
    raise InputError(
        f"{output.path}: none of {len(every):,} splats can be spared at {psnr:g} dB{could}"
    )


def _refitted(work: Simplification, output: Output, psnr: float, seconds: float) -> Written | None:
    """Fewer splats, refitted until they have a PSNR; None where time or Ctrl-C ends that first."""
    for gain in GAINS:
        if psnr <= gain:
            continue
        work.shrink(psnr - gain)
        undisturbed = work.refine(seconds / len(GAINS), psnr + EXCESS)
        written = output.write(work.splats)
        quality = work.judge(written.splats)
        if quality.psnr >= psnr:
            return written
        if not undisturbed:
            break
    return None


def _as_small_as(work: Simplification, output: Output, splats: int, size: int) -> Written:
    """At most so many splats, whose file is of at most so many bytes. Raises InputError."""
    work.reduce(splats)
    for _ in range(TRIES):
        written = output.write(work.splats)
        if written.bytes <= size:
            return written
        if len(work.splats) == 1:
            break
        work.reduce(max(1, int((1 - SPARE) * len(work.splats) * size / written.bytes)))
    raise InputError(
        f"{output.path}: {len(work.splats):,} splats take {written.bytes:,} bytes, "
        f"more than {size:,}"
    )


@contextmanager
def _folder_beside(out: Path) -> Iterator[Path]:
    """A folder for a draft, as long as it is needed. Raises InputError where there is none."""
    try:
        folder = tempfile.TemporaryDirectory(prefix=".simplify-", dir=out.parent)
    except OSError as error:
        raise InputError(
            f"{out}: nothing can be written to {out.parent}: {error.strerror}"
        ) from error
    with folder as name:
        yield Path(name)


def _warn(text: str) -> None:
    print(f"simplify: {text}", file=sys.stderr)
