"""Measures ROSplat on this machine, subject by subject; some need ROS."""

from __future__ import annotations

import argparse
import importlib
import os
import shlex
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.table import Table

from rosplat_core.program import machine
from rosplat_core.program.files import make_folder
from rosplat_core.program.output import told, unheard
from rosplat_core.program.typed_numbers import number, sized
from rosplat_core.scenes import NAMES, check_scene
from rosplat_core.splats import InputError
from rosplat_lab.bench.plan import GPU, PROCESSOR, Plan
from rosplat_lab.bench.records import Doing, Event, Record, Skipped, save
from rosplat_lab.bench.renderers import RENDERERS
from rosplat_lab.bench.scenes import THIN
from rosplat_ros.program.processes import ProcessError
from rosplat_sorter.backends import BACKENDS

WIDTH = 150  # of tables that go to a file
STATISTICS = ("least", "p50", "p95", "p99", "most", "n")


SUBJECTS = {  # each has a module with measure(plan), which yields Events
    "sort": "depth orders by every backend, each first held against the reference order",
    "frame": "frames, their error and stages, beside other renderers; memory",
    "levels": "time, memory and popping of levels of detail",
    "simplify": "error of simplified maps, and the processor time of making them",
    "bound": "what simplify promises, and what views have that it never saw",
    "occupancy": "precision, recall and time of obstacles in a map",
    "simulate":
        "a robot that MuJoCo moves: pictures with physics between them, a lidar's time and errors",
    "align": "poses refined by pictures: how many starts end well, and how long that takes",
    "camera":
        "from a pose to the picture of a camera in the map; what the warp of lenses costs",
    "rviz":
        "rviz2's own frames and pictures, of this display and others; under a mouse with xdotool",
    "stream": "a scene larger than memory, with a camera that flies, rests and jumps",
    "chain": "from pose to picture through publisher, sorter and viewer",
}  # fmt: skip
NEED_ROS = ("camera", "rviz", "stream", "chain")


def main(arguments: list[str] | None = None) -> int:
    """Runs the command; 0 where all was measured that this machine can."""
    arguments = sys.argv[1:] if arguments is None else arguments
    console = Console()
    if not console.is_terminal:
        console = Console(width=WIDTH)
    try:
        return _measure(arguments, console)
    except BrokenPipeError as error:  # of rich before 13.8
        unheard(error)
    except (InputError, OSError) as error:
        print(f"bench: {told(error)}", file=sys.stderr)
        return 1


def _measure(arguments: list[str], console: Console) -> int:
    options = vars(_parser().parse_args(arguments))
    subjects = options.pop("subjects") or SUBJECTS
    plan = Plan(**options)
    for name in plan.scenes:
        if name not in THIN:
            check_scene(name)
    make_folder(plan.out)
    here = circumstances("bench", arguments)
    console.print(
        f"{here['machine']}; GPU: {here['gpu'] or 'no NVIDIA'}; load {here['load']:.1f}",
        markup=False,
        soft_wrap=True,
    )
    failed = False
    for name in subjects:
        if name in NEED_ROS and not has_ros():
            console.print(f"[yellow]{name} skipped: no ROS 2, or no rosplat_msgs, is sourced")
            continue
        events = importlib.import_module(f"rosplat_lab.bench.{name}").measure(plan)
        recorder = Recorder(name, plan.out / f"{name}.json", here)
        try:
            recorder.follow(events, console)
        except (InputError, ProcessError, RuntimeError, AssertionError, OSError) as error:
            console.print(f"[red]{name} ended early: {escape(str(error))}", soft_wrap=True)
            failed = True
        finally:
            if recorder.records:
                console.print(*tables(recorder.records))
                console.print(f"wrote {recorder.path}", markup=False, soft_wrap=True)
    return int(failed)


def has_ros() -> bool:
    """Whether ROS 2 and this workspace's messages can be imported."""
    try:
        importlib.import_module("rclpy")
        importlib.import_module("rosplat_msgs.msg")
    except ImportError:
        return False
    return True


def circumstances(program: str, arguments: list[str]) -> dict[str, Any]:
    """The circumstances of a program's run with these arguments, for Record.of."""
    gpu, driver = machine.nvidia_gpu()
    return {
        "machine": machine.machine(), "gpu": gpu, "driver": driver, "commit": machine.commit(),
        "command": shlex.join([program, *arguments]),
        "time": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()), "load": os.getloadavg()[0],
    }  # fmt: skip


def _parser() -> argparse.ArgumentParser:
    subjects = "\n".join(f"  {name:10} {about}" for name, about in SUBJECTS.items())
    parser = argparse.ArgumentParser(
        prog="bench",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog=f"subjects:\n{subjects}\n\nCtrl-C ends a run and keeps what was measured.",
    )
    parser.add_argument(
        "subjects", nargs="*", metavar="SUBJECT", type=_subject,
        help="what to measure, all by default; see below",
    )  # fmt: skip
    parser.add_argument(
        "--quick", action="store_true", help="small maps, few repetitions: 2 minutes"
    )
    parser.add_argument(
        "--out", type=Path, default=Path("out/bench"), help="folder for JSON and logs"
    )
    parser.add_argument(
        "--sizes", type=sized("number of splats"), nargs="+", default=[], metavar="N",
        help="splats of the procedural scenes: 500000, 500k, 5M",
    )  # fmt: skip
    parser.add_argument(
        "--scenes", nargs="+", default=[], metavar="SCENE", help=f"other scenes: {NAMES}"
    )
    parser.add_argument(
        "--backends", nargs="+", default=[], metavar="NAME",
        help=f"of the sorter: {', '.join(BACKENDS)}; or the viewer itself: {GPU} (chain, frame), "
        f"{PROCESSOR} (chain); default all",
    )  # fmt: skip
    parser.add_argument(
        "--variants", nargs="+", default=[], metavar="NAME",
        help="of what frame draws: default, tiles, processor, 'four maps', ewa, ray, disc, or "
        f"another renderer: {', '.join(RENDERERS)}; of levels: card, processor",
    )  # fmt: skip
    parser.add_argument(
        "--displays", type=Path, nargs="+", default=[], metavar="FILE",
        help="rviz: YAML lists of displays to measure as well, as `Displays` of an .rviz file; "
        "{ply}, {topic} and {sh_degree} stand for what is measured",
    )  # fmt: skip
    parser.add_argument(
        "--cameras", type=Path, metavar="FILE",
        help="a path: simplify also simplifies for its views, and judges all ways by them; "
        "bound simplifies for every other of its cameras, and judges by the rest",
    )  # fmt: skip
    parser.add_argument(
        "--seconds",
        type=number("time in seconds"),
        metavar="S",
        help="how long to repeat each measurement",
    )
    return parser


def _subject(text: str) -> str:
    if text not in SUBJECTS:
        raise argparse.ArgumentTypeError(
            f"unknown subject '{text}', known are {', '.join(SUBJECTS)}"
        )
    return text


class Recorder:
    """Keeps records, on disk from the moment each is measured."""

    def __init__(self, subject: str, path: Path, circumstances: dict[str, Any]) -> None:
        self.path = path
        self.records: list[Record] = []
        self._subject, self._circumstances = subject, circumstances

    def follow(self, events: Iterator[Event], console: Console) -> None:
        """Records the measurements of events, and shows what is being done."""
        columns = (
            SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(),
        )  # fmt: skip
        with Progress(*columns, console=console, transient=True) as progress:
            task = progress.add_task(self._subject, total=1.0)
            for event in events:
                if isinstance(event, Doing):
                    doing = escape(f"{self._subject}: {event.text}")
                    progress.update(task, completed=event.part, description=doing)
                elif isinstance(event, Skipped):
                    skipped = escape(event.text)
                    progress.console.print(f"[yellow]skipped: {skipped}", soft_wrap=True)
                else:
                    now = self._circumstances | {"load": os.getloadavg()[0]}
                    self.records.append(Record.of(self._subject, event, now))
                    save(self.path, self.records)


def tables(records: list[Record]) -> Iterator[Table]:
    """A table for each quantity, with a column for each parameter."""
    for name in dict.fromkeys(record.name for record in records):
        mine = [record for record in records if record.name == name]
        keys = list(dict.fromkeys(key for record in mine for key in record.parameters))
        title = escape(f"{mine[0].subject}: {name} [{mine[0].unit}]")
        shown = Table(title=title, title_justify="left")
        for column in ("scene", *keys):
            shown.add_column(column)
        shown.add_column("splats", justify="right")
        for column in STATISTICS:
            shown.add_column(column, justify="right")
        for record in mine:
            shown.add_row(
                escape(record.scene),
                *(escape(_text(record.parameters.get(key, ""))) for key in keys),
                *(_text(getattr(record, key)) for key in ("splats", *STATISTICS)),
            )
        yield shown


def _text(value: object) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return f"{value:,}"
    if isinstance(value, float):
        return f"{value:,.4g}" if abs(value) < 1e4 else f"{value:,.0f}"
    return str(value)
