"""Charts the error of every method against its time, and the places where methods fail.

Each method draws each scene from several cameras; the float64 reference renderer draws the truth.
Results are kept in the folder, so a run that was interrupted goes on where it was.
"""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tqdm import tqdm

from rosplat_tools import reference
from rosplat_tools.bench.machine import commit, machine
from rosplat_tools.cameras import Camera
from rosplat_tools.lab import accuracy, atlas, charts, motion, points, report, stability
from rosplat_tools.lab.bench import Bench, Image
from rosplat_tools.lab.methods import METHODS, Method
from rosplat_tools.lab.points import MOST_PSNR, Point, Store
from rosplat_tools.metrics import compare
from rosplat_tools.processes import interrupt_by_signals
from rosplat_tools.scenes import NAMES, PROCEDURAL, load_scene
from rosplat_tools.splats import SceneError, Splats
from rviz_gaussian_plugin.offscreen import ensure_display

QUICK_CAMERAS = 3


@dataclass(frozen=True)
class Scene:
    """What is looked at, and from where."""

    name: str
    splats: Splats
    cameras: list[Camera]


def load(name: str, options: argparse.Namespace) -> Scene:
    """A scene and the cameras around it. Raises SceneError."""
    if not name.startswith(PROCEDURAL) and not Path(name).exists():
        raise SceneError(f"{name}: no such file")
    splats = load_scene(name, lambda done: None, lambda text: print(text, file=sys.stderr))
    if len(splats) == 0:
        raise SceneError(f"{name}: holds no splats")
    up = options.up or ((0, 0, 1) if name.startswith(PROCEDURAL) else (0, -1, 0))
    cameras = motion.around(splats, options.cameras, up, options.width, options.height)
    return Scene(name if name.startswith(PROCEDURAL) else Path(name).stem, splats, cameras)


def truths(scene: Scene, store: Store, version: str) -> list[Image]:
    """(height, width, 3) RGB over black for each camera, by the reference renderer."""
    pictures = []
    content = points.scene_key(scene.splats)
    for camera in tqdm(scene.cameras, f"{scene.name}: reference", unit="picture", disable=None):
        key = points.key("truth", content, points.camera_key(camera), version)
        picture = store.picture(key)
        if picture is None:
            picture = reference.render(scene.splats, camera).rgba[..., :3]
            store.add_picture(key, picture)
        pictures.append(picture)
    return pictures


def measure(
    scene: Scene, methods: Sequence[Method], bench: Bench, store: Store, command: str
) -> Iterator[Point]:
    """A point for each method and camera; those that the store has are not measured again."""
    version = points.code_version()
    origin: dict[str, Any] = {
        "machine": machine(),
        "gpu": bench.graphics,
        "commit": commit(),
    }
    content = points.scene_key(scene.splats)
    expected = truths(scene, store, version)
    progress = tqdm(
        total=len(methods) * len(scene.cameras), desc=scene.name, unit="picture", disable=None
    )
    for method in methods:
        shown: Splats | None = None
        for camera, truth in zip(scene.cameras, expected, strict=True):
            key = points.key(
                method.name,
                content,
                points.camera_key(camera),
                version,
                origin["machine"],
                origin["gpu"],
            )
            point = store.get(key)
            if point is None:
                if shown is None:
                    shown = method.change(scene.splats) if method.change else scene.splats
                bench.show(shown)
                try:
                    shot = method.shoot(bench, camera)
                except RuntimeError as error:  # what the graphics here can't do
                    tqdm.write(f"without {method.name}: {error}", file=sys.stderr)
                    break
                values: dict[str, Any] = compare(shot.picture, truth)
                values["psnr"] = min(values["psnr"], MOST_PSNR)
                point = Point(
                    key=key, method=method.name, family=method.family, model=method.model,
                    scene=scene.name, camera=camera.id, splats=shot.splats,
                    sort_ms=shot.sort_ms, draw_ms=shot.draw_ms, command=command,
                    **values, **origin,
                )  # fmt: skip
                if camera is scene.cameras[0]:
                    report.save_strip(store.folder, key, shot.picture, truth)
                store.add(point)
            progress.update()
            yield point
    progress.close()


def main(arguments: list[str] | None = None) -> int:
    """Runs the command; 0 if everything was measured."""
    parser = argparse.ArgumentParser(prog="lab", description=__doc__)
    parser.add_argument("scenes", nargs="*", metavar="scene", help=f"scenes: {NAMES}")
    parser.add_argument("--out", type=Path, default=Path("out/lab"), help="folder for results")
    parser.add_argument(
        "--docs", type=Path, help="folder for accuracy.md, stability.md and their pictures (--out)"
    )
    parser.add_argument("--quick", action="store_true", help="few cameras, small atlas: minutes")
    parser.add_argument("--cameras", type=int, help="for each scene (8; quick: 3)")
    parser.add_argument("--width", type=int, default=640, help="of the pictures [px]")
    parser.add_argument("--height", type=int, default=360, help="of the pictures [px]")
    parser.add_argument(
        "--up", type=float, nargs=3, metavar=("X", "Y", "Z"),
        help="the scenes' vertical; files have 0 -1 0, procedural scenes 0 0 1",
    )  # fmt: skip
    parser.add_argument("--only", default="", help="methods whose name or family holds this")
    parser.add_argument(
        "--threads", type=int, default=0, help="of sorters on the CPU (0: as many as there are)"
    )
    parser.add_argument("--repeats", type=int, default=3, help="times are the fastest of so many")
    parser.add_argument(
        "--part", choices=["all", "chart", "atlas"], default="all", help="what to measure"
    )
    options = parser.parse_args(arguments)
    interrupt_by_signals()
    options.cameras = options.cameras or (QUICK_CAMERAS if options.quick else 8)
    command = shlex.join(["lab", *(sys.argv[1:] if arguments is None else arguments)])
    try:
        names = [] if options.part == "atlas" else options.scenes or [f"{PROCEDURAL}100000"]
        scenes = [load(name, options) for name in names]
        store = Store(options.out)
        with ensure_display():
            run(scenes, store, options, command)
    except (SceneError, RuntimeError, OSError) as error:
        print(f"lab: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130
    return 0


def run(scenes: list[Scene], store: Store, options: argparse.Namespace, command: str) -> None:
    """Measures, and writes all there is to see into the store's folder."""
    bench = Bench(options.threads, options.repeats)
    for name, reason in bench.unavailable.items():
        print(f"without the sorter {name}: {reason}", file=sys.stderr)
    wanted = [
        method
        for method in METHODS
        if options.only in f"{method.name} {method.family}" and method.available(bench)
    ]
    if options.part != "atlas":
        measured = [
            point for scene in scenes for point in measure(scene, wanted, bench, store, command)
        ]
        if not measured:
            raise SceneError(f"no method's name or family holds {options.only!r}")
        points.save(store.folder / "lab.json", measured)
        page = report.write(store.folder, measured)
        folder = options.docs or store.folder
        written = [page, accuracy.write(folder, measured), *charts.write(folder, measured)]
        print(f"wrote {', '.join(map(str, written))}")
    if options.part != "chart":
        findings = atlas.explore(bench, options.quick)
        atlas.save(store.folder / "stability.json", findings)
        facts = f"{bench.graphics}, {machine()}, commit {commit()}"
        print(f"wrote {stability.write(options.docs or store.folder, findings, facts)}")
    del bench  # its window before the display


if __name__ == "__main__":
    sys.exit(main())
