"""Charts the error of every method against its time, and the places where methods fail.

Each method draws each scene from several cameras; the float64 reference renderer draws the truth.
Results are kept in the folder, so a run that was interrupted goes on where it was.
"""

from __future__ import annotations

import argparse
import re
import shlex
import sys
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from tqdm import tqdm

from rosplat_core.cameras import Camera
from rosplat_core.program.output import say, told
from rosplat_core.rendering import MOST_PSNR
from rosplat_core.scenes import NAMES, PROCEDURAL, check_scene, is_generated, load_scene
from rosplat_core.splats import SceneError, Splats
from rosplat_lab.arguments import make_folder, whole
from rosplat_lab.lab import accuracy, atlas, charts, motion, points, report, stability
from rosplat_lab.lab.bench import Bench
from rosplat_lab.lab.methods import METHODS, Method
from rosplat_lab.lab.points import Point, Store
from rosplat_lab.lab.progress import progress
from rosplat_lab.lab.workers import Comparison, Image, Reference, Workers
from rosplat_lab.machine import commit, machine
from rviz_gaussian_plugin.offscreen import ensure_display

QUICK_CAMERAS = 3
LONGEST_SIDE, MOST_PIXELS = 16384, 1 << 25  # as the renderer has them (splat_camera.cpp)
HELD_FOR_EACH_CORE = 8  # pictures that wait to be compared


@dataclass(frozen=True)
class Scene:
    """What is looked at, and from where."""

    path: str
    name: str
    splats: Splats
    cameras: list[Camera]


@dataclass(frozen=True)
class Job:
    """A point to be measured: what it will be but its figures."""

    method: Method
    camera: Camera
    truth: Path
    point: Point


def load(path: str, options: argparse.Namespace) -> Scene:
    """A scene and the cameras around it. Raises SceneError."""
    generated = is_generated(path)
    splats = load_scene(path, lambda done: None, lambda text: print(text, file=sys.stderr))
    up = np.array(options.up or ((0, 0, 1) if generated else (0, -1, 0)), float)
    up /= np.abs(up).max()  # its square may be no number
    cameras = motion.around(splats, options.cameras, up, options.width, options.height)
    name = path if generated else Path(path).stem
    return Scene(path, f"{name}, {options.width}x{options.height}", splats, cameras)


def measure(
    scene: Scene, methods: Sequence[Method], bench: Bench, workers: Workers, store: Store,
    command: str,
) -> list[Point]:  # fmt: skip
    """A point for each method and camera; those that the store has are not measured again."""
    jobs = list(_jobs(scene, methods, bench, store, command))
    missing = [job for job in jobs if not store.get(job.point.key)]
    undrawn = {
        job.truth: Reference(scene.path, job.camera, job.truth)
        for job in missing
        if not job.truth.exists()
    }
    if undrawn:
        with progress(f"{scene.name}: reference", len(undrawn), "picture") as drawn:
            for _ in workers.run(undrawn.values()):
                drawn.update()
    with progress(scene.name, len(jobs), "picture", len(jobs) - len(missing)) as measured:

        def compare(part: Sequence[tuple[Job, Image | None]]) -> None:
            tasks = [_comparison(job, picture, scene, store) for job, picture in part]
            for number, values in workers.run(tasks):
                values["psnr"] = min(values["psnr"], MOST_PSNR)
                store.add(replace(part[number][0].point, **values))
                measured.update()

        compare([(job, None) for job in missing if not job.method.shoot])
        shot: list[tuple[Job, Image | None]] = []
        for job, picture in _shots([job for job in missing if job.method.shoot], scene, bench):
            shot.append((job, picture))
            if len(shot) == HELD_FOR_EACH_CORE * workers.count:
                compare(shot)
                shot.clear()
        compare(shot)
    return [point for job in jobs if (point := store.get(job.point.key))]


def _jobs(
    scene: Scene, methods: Sequence[Method], bench: Bench, store: Store, command: str
) -> Iterator[Job]:
    version, content = points.code_version(), points.scene_key(scene.splats)
    unmeasured = Point(
        key="", method="", family="", aside="", scene=scene.name, camera=0, splats=None,
        sort_ms=None, draw_ms=None, pose_ms=None, psnr=0, ssim=0, flip=0, worst=0,
        machine=machine(), gpu=bench.graphics, commit=commit(), command=command,
    )  # fmt: skip
    for method in methods:
        for camera in scene.cameras:
            place = (content, points.camera_key(camera), version)
            key = points.key(method.name, *place, unmeasured.machine, unmeasured.gpu)
            point = replace(
                unmeasured, key=key, method=method.name, family=method.family, aside=method.aside,
                camera=camera.id,
            )  # fmt: skip
            yield Job(method, camera, store.truth(points.key("truth", *place)), point)


def _shots(jobs: Sequence[Job], scene: Scene, bench: Bench) -> Iterator[tuple[Job, Image | None]]:
    """The jobs with their times, and their pictures where these are not a model's."""
    method: Method | None = None
    for job in jobs:
        if job.method is not method:
            method, failed = job.method, False
            changed = method.change(scene.splats) if method.change else scene.splats
        if failed:
            continue
        bench.show(changed)
        assert method.shoot
        try:
            shot = method.shoot(bench, job.camera)
        except RuntimeError as error:  # what the graphics here can't do
            tqdm.write(f"without {method.name}: {error}", file=sys.stderr)
            failed = True
            continue
        point = replace(
            job.point, splats=shot.splats, sort_ms=shot.sort_ms, draw_ms=shot.draw_ms,
            pose_ms=shot.pose_ms,
        )  # fmt: skip
        yield replace(job, point=point), None if method.model else shot.picture.astype("f4")


def _comparison(job: Job, picture: Image | None, scene: Scene, store: Store) -> Comparison:
    first = job.camera is scene.cameras[0]
    strip = report.strip(store.folder, job.point.key) if first else None
    return Comparison(scene.path, job.camera, job.method.name, job.truth, picture, strip)


def main(arguments: list[str] | None = None) -> int:
    """Runs the command; 0 if everything was measured."""
    parser = argparse.ArgumentParser(prog="lab", description=__doc__)
    parser.add_argument("scenes", nargs="*", metavar="scene", help=f"scenes: {NAMES}")
    parser.add_argument("--out", type=Path, default=Path("out/lab"), help="folder for results")
    parser.add_argument(
        "--docs", type=Path, help="folder for accuracy.md, stability.md and their pictures (--out)"
    )
    parser.add_argument("--quick", action="store_true", help="few cameras, small atlas: minutes")
    parser.add_argument("--cameras", type=whole(1), help="for each scene (8; quick: 3)")
    side = whole(1, LONGEST_SIDE)
    parser.add_argument("--width", type=side, default=640, help="of the pictures [px]")
    parser.add_argument("--height", type=side, default=360, help="of the pictures [px]")
    parser.add_argument(
        "--up", type=float, nargs=3, metavar=("X", "Y", "Z"),
        help="the scenes' vertical; files have 0 -1 0, generated scenes 0 0 1",
    )  # fmt: skip
    parser.add_argument(
        "--only", nargs="+", default=[""], help="methods whose name or family holds one of these"
    )
    parser.add_argument(
        "--threads",
        type=whole(0),
        default=0,
        help="of sorters on the CPU (0: as many as there are)",
    )
    parser.add_argument(
        "--repeats", type=whole(1), default=3, help="times are the fastest of so many"
    )
    parser.add_argument(
        "--points", type=Path, nargs="+", metavar="lab.json",
        help="draw report and charts again from what earlier runs measured, instead of measuring",
    )  # fmt: skip
    parser.add_argument("--remark", default="", help="a line for accuracy.md")
    parser.add_argument(
        "--part", choices=["all", "chart", "atlas"], default="all", help="what to measure"
    )
    options = parser.parse_args(arguments)
    if options.width * options.height > MOST_PIXELS:
        parser.error("arguments --width, --height: 2^25 pixels at most")
    if options.up and not (np.isfinite(options.up).all() and any(options.up)):
        parser.error("argument --up: expected a direction, finite and not 0 0 0")
    options.cameras = options.cameras or (QUICK_CAMERAS if options.quick else 8)
    command = shlex.join(["lab", *(sys.argv[1:] if arguments is None else arguments)])
    try:
        if options.points:
            families = {method.family for method in METHODS}  # of others, records outlive them
            read = (point for path in options.points for point in points.load(path))
            kept = [point for point in read if point.family in families]
            write(Store(options.out).folder, kept, options)
            return 0
        names = [] if options.part == "atlas" else options.scenes or [f"{PROCEDURAL}100000"]
        for name in names:
            check_scene(name)
        scenes = [load(name, options) for name in names]
        store = Store(options.out)
        with (
            ensure_display(),
            closing(Bench(options.threads, options.repeats)) as bench,
        ):
            run(bench, scenes, store, options, command)
    except (SceneError, RuntimeError, OSError, MemoryError) as error:
        print(f"lab: {told(error)}", file=sys.stderr)
        return 1
    return 0


def run(
    bench: Bench, scenes: list[Scene], store: Store, options: argparse.Namespace, command: str
) -> None:
    """Measures, and writes all there is to see into the store's folder."""
    for name, reason in bench.unavailable.items():
        print(f"without the sorter {name}: {reason}", file=sys.stderr)
    wanted = [
        method
        for method in METHODS
        if any(text in f"{method.name} {method.family}" for text in options.only)
        and method.available(bench)
    ]
    if options.part != "atlas":
        with Workers() as workers:
            measured = [
                point
                for scene in scenes
                for point in measure(scene, wanted, bench, workers, store, command)
            ]
        if not measured:
            raise SceneError(f"no method's name or family holds {options.only!r}")
        points.save(store.folder / "lab.json", measured)
        write(store.folder, measured, options)
    if options.part != "chart":
        findings = atlas.explore(bench, options.quick)
        atlas.save(store.folder / "stability.json", findings)
        facts = f"{bench.graphics}, {machine()}, commit {commit()}"
        say(f"wrote {stability.write(options.docs or store.folder, findings, facts)}")


def write(folder: Path, measured: list[Point], options: argparse.Namespace) -> None:
    """Writes the report, tables and charts of points."""
    graphics = {" ".join(re.split(r"/| \(", point.gpu)[0].split()[:2]) for point in measured}
    if len(graphics) > 1:  # each machine's scenes are scenes of their own
        measured = [
            replace(point, scene=f"{point.scene}, {name}")
            for point in measured
            for name in graphics
            if point.gpu.startswith(name)
        ]
    docs = options.docs or folder
    make_folder(docs)
    written = [
        report.write(folder, measured),
        accuracy.write(docs, measured, options.remark),
        *charts.write(docs, measured),
    ]
    say(f"wrote {', '.join(map(str, written))}")


if __name__ == "__main__":
    sys.exit(main())
