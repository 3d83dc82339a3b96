"""Charts the error of every way to draw a map against its time, and finds where pictures fail.

Every way draws each scene from several cameras, and is held against a float64 reference renderer.
With --docs, the command makes the documentation's chart and tables anew. Figures of the other kind
of machine, with or without a graphics card, come from the records that are kept there.
"""

from __future__ import annotations

import argparse
import os
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from rosplat_core.program.files import make_folder
from rosplat_core.program.output import say, told
from rosplat_core.scenes import NAMES, PROCEDURAL, check_scene
from rosplat_core.splats import InputError
from rosplat_lab.bench.command import Recorder, circumstances
from rosplat_lab.bench.plan import Plan
from rosplat_lab.bench.records import Record, load
from rosplat_lab.lab import atlas, measure, pages, picture, report

TRAINED = ("playbot", "wolf.spz")  # in $ROSPLAT_DATA
LARGE = f"{PROCEDURAL}2000000"
WITHOUT_DATA = f"{PROCEDURAL}500000"
QUICK = f"{PROCEDURAL}20000"
KINDS = {"card": "a graphics card", "processor": "two cores, without a graphics card"}


def usual_scenes(quick: bool) -> list[str]:
    """The trained scenes where there are any, and one that takes long to draw."""
    data = Path(os.environ.get("ROSPLAT_DATA", "../shared/data"))
    trained = [str(data / name) for name in TRAINED if (data / name).exists()]
    if quick:
        return trained[1:] or [QUICK]
    return [*(trained or [WITHOUT_DATA]), LARGE]


def main(arguments: list[str] | None = None) -> int:
    """Runs the command; 0 if everything was measured."""
    arguments = sys.argv[1:] if arguments is None else arguments
    options = _parser().parse_args(arguments)
    try:
        for name in options.scenes:
            check_scene(name)
        make_folder(options.out)
        console = Console()
        plan = Plan(out=options.out, quick=options.quick)
        here = circumstances("lab", arguments)
        if options.part in ("all", "chart"):
            names = options.scenes or usual_scenes(options.quick)
            events = measure.measure(plan, names, options.out / "strips")
            Recorder("lab", options.out / "lab.json", here).follow(events, console)
        if options.part in ("all", "atlas"):
            recorder = Recorder("atlas", options.out / "atlas.json", here)
            recorder.follow(atlas.measure(plan), console)
        _write(options.out, options.docs, keep=options.part != "pages")
    except (InputError, RuntimeError, OSError, MemoryError) as error:
        print(f"lab: {told(error)}", file=sys.stderr)
        return 1
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="lab", description=__doc__)
    parser.add_argument(
        "scenes", nargs="*", metavar="scene",
        help=f"scenes: {NAMES}; by default {', '.join(TRAINED)} of $ROSPLAT_DATA, and {LARGE}",
    )  # fmt: skip
    parser.add_argument("--out", type=Path, default=Path("out/lab"), help="folder for results")
    parser.add_argument(
        "--docs", type=Path, metavar="DOCS",
        help="also keep the records in DOCS/results/lab, and renew DOCS/accuracy.md and "
        "DOCS/stability.md with their pictures",
    )  # fmt: skip
    parser.add_argument("--quick", action="store_true", help="small pictures, few passes: minutes")
    parser.add_argument(
        "--part", choices=["all", "chart", "atlas", "pages"], default="all",
        help="what to measure; pages measures nothing and makes the documents from the records",
    )  # fmt: skip
    return parser


def _write(out: Path, docs: Path | None, keep: bool) -> None:
    """The report of what was measured here, and the pages of all that is kept."""
    written = []
    if docs and keep:
        _copy_records(out, docs / pages.KEPT)
    kept = _copied_records(docs / pages.KEPT if docs else None)
    if not docs and (out / "lab.json").exists():
        records = load([out / "lab.json"])
        kept["lab"] = {kind_of(records): records}
    if kept["lab"]:
        written.append(report.write(out, kept["lab"]))
        written.append(picture.write(docs or out, kept["lab"]))
    if docs:
        written += pages.write(docs, kept["lab"], kept["atlas"])
    if written:
        say(f"wrote {', '.join(map(str, written))}")
    elif not keep:
        raise InputError(f"{out / 'lab.json'}: no such file")


def kind_of(records: Sequence[Record]) -> str:
    """Which of KINDS a run's machine is."""
    return (
        "processor" if all(r.gpu.startswith(("CPU", "NumPy", "llvm")) for r in records) else "card"
    )


def _copy_records(out: Path, folder: Path) -> None:
    make_folder(folder)
    for name, suffix in (("lab", ""), ("atlas", "-atlas")):
        path = out / f"{name}.json"
        if path.exists():
            shutil.copyfile(path, folder / f"{kind_of(load([path]))}{suffix}.json")


def _copied_records(folder: Path | None) -> dict[str, dict[str, list[Record]]]:
    """Records by what was measured, and kind of machine."""
    kept: dict[str, dict[str, list[Record]]] = {"lab": {}, "atlas": {}}
    for kind in KINDS:
        for name, suffix in (("lab", ""), ("atlas", "-atlas")):
            if folder and (path := folder / f"{kind}{suffix}.json").exists():
                kept[name][kind] = load([path])
    return kept
