"""A streamed scene, as a camera flies through it: pauses, memory, waiting, and what is missing."""

from __future__ import annotations

import io
import json
import math
import time
import zipfile
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rosplat_core import rendering
from rosplat_core.cameras import Camera, look_at
from rosplat_core.formats import sog
from rosplat_core.formats.streamed_sog import META, Pieces, Streamed, open_streamed
from rosplat_core.generated import generate
from rosplat_core.posed_camera import PosedCamera
from rosplat_core.program import machine
from rosplat_core.splats import InputError, Splats, concatenate, splat_bytes
from rosplat_lab import metrics
from rosplat_lab.bench.isolation import isolated
from rosplat_lab.bench.plan import Plan
from rosplat_lab.bench.records import Doing, Event, Measurement
from rosplat_lab.programs import Programs
from rosplat_ros.program.processes import quoted
from rosplat_tools.streaming.detail import NOTHING, Levels, choose, in_sight, magnification

Array = NDArray[np.float64]

SIZES, QUICK_SIZES = (4_000_000,), (60_000,)
SHARE = 4  # the map may hold one in so many splats of a generated scene
BUDGETS = (1_000_000, 3_000_000)  # splats, of scenes by name
PICTURE, QUICK_PICTURE = (1280, 720), (320, 180)
FLIGHT, QUICK_FLIGHT = 30.0, 3.0  # [s]
SPEED = 0.25  # chunks a second
SIGHTS = 2  # pictures of the flight that are held against the truth
ELSEWHERE = 0.6  # part of the way at which the camera is put after the flight
DOWN, WEAVE, TURN = 0.35, 0.7, 12.0  # looks down, and left and right [rad], with a period of [s]
SETTLED = 3.0  # a map at rest that has not changed for so long has heard of the camera, too [s]
PATIENCE = 300.0  # until it is at rest [s]
NO_PICTURE = "no picture from gaussians/render"

# The gardens.
SIDE = 4  # gardens along x, and along y
APART = 5.0  # distance of their middles [m]
LEVELS = (1, 4, 16)  # one in so many splats is left, the finest first

TRUTH_BYTES = 1 << 29  # most for the truth's splats, as in messages; the nearest come first
TRUTH_ERROR = 0.25  # that is small enough for it [px]


def measure(plan: Plan) -> Iterator[Event]:
    """Pictures' times and processes' memory in flight, seconds until rest, PSNR."""
    sizes = plan.sizes or (() if plan.scenes else QUICK_SIZES if plan.quick else SIZES)
    with TemporaryDirectory() as folder:
        jobs = []
        for size in sizes:
            yield Doing(f"a scene of {size:,} splats is written", 0.0)
            jobs.append((_gardens(Path(folder) / f"gardens-{size}", size), size // SHARE))
        jobs += [(Path(scene), budget) for scene in plan.scenes for budget in BUDGETS]
        for number, (path, budget) in enumerate(jobs):
            yield Doing(f"{path.parent.name}, {budget:,} splats", number / len(jobs))
            yield from isolated(_scene, path, budget, plan.out, plan.quick)


def _scene(path: Path, budget: int, out: Path, quick: bool) -> Iterator[Event]:
    scene = open_streamed(path)
    course = Course(scene, *(QUICK_PICTURE if quick else PICTURE))
    common: dict[str, Any] = {
        "scene": scene.path.parent.name, "splats": scene.splats, "budget": budget,
    }  # fmt: skip
    # What the viewer showed to a camera, (height, width, 3), and when.
    sights: list[tuple[Camera, NDArray[np.float32], str]] = []
    # By what came before: seconds until a map was at rest, and processor time by program.
    waits: dict[str, tuple[float, dict[str, float]]] = {}
    with Watched(path, budget, out / "log") as watched:

        def rest(after: str, camera: Camera) -> None:
            waits[after] = watched.until_rest(camera)
            sights.append((camera, watched.shown, "at rest"))

        flight = QUICK_FLIGHT if quick else FLIGHT
        rest("start", course.at(0.0))
        yield Measurement("picture at rest", "ms", 1e3 * np.array(watched.still), **common)
        pauses = []
        began = time.monotonic()
        while (since := time.monotonic() - began) < flight:
            camera = course.at(since)
            pauses.append(watched.render(camera))
            if len(sights) - 1 < SIGHTS and since > len(sights) / (SIGHTS + 1) * flight:
                sights.append((camera, watched.shown, "in flight"))
        yield Measurement("picture in flight", "ms", 1e3 * np.array(pauses), **common)
        rest("flight", course.at(flight))
        rest("jump", course.at(0.0, ELSEWHERE))
        for after, (seconds, work) in waits.items():
            yield Measurement("until at rest", "s", seconds, **common, after=after)
            for name, used in work.items():
                yield Measurement(
                    "processor time until at rest", "s", used, **common, after=after, process=name
                )
        for name, peak in watched.peaks().items():
            yield Measurement("RAM", "MB", peak / 1e6, **common, process=name)
    values: dict[str, list[float]] = {}
    for camera, picture, when in sights:
        shown, truth = np.clip(picture, 0, 1), _truth(scene, camera)
        values.setdefault(when, []).append(metrics.psnr(shown, truth))
    for when, found in values.items():
        yield Measurement("PSNR", "dB", found, **common, when=when)


class Course:
    """Where a camera flies, low over the middle of a scene, and looks."""

    def __init__(self, scene: Streamed, width: int, height: int) -> None:
        """width, height: of pictures [px]."""
        low, high = (np.array([getattr(c, end) for c in scene.chunks]) for end in ("low", "high"))
        self._size = (width, height)
        self._first, self._last = np.quantile((low + high) / 2, [0.15, 0.85], axis=0)
        self._up = int(np.argmin(self._last - self._first))  # scenes are wider than they are high
        self._first[self._up] = self._last[self._up] = np.median(high[:, self._up])
        way = self._last - self._first
        self._length = max(float(np.linalg.norm(way)), 1e-9)
        self._ahead = way / self._length
        self._chunk = float(np.median(np.linalg.norm(high - low, axis=1)))

    def at(self, seconds: float, place: float = 0.0) -> Camera:
        """The camera so long after it left a place, 0 to 1 of the way through the scene.

        At the end of the way it flies back, and looks ahead as before.
        """
        flown = place * self._length + SPEED * self._chunk * seconds
        along = self._length - abs(flown % (2 * self._length) - self._length)
        eye = self._first + along * self._ahead
        up = np.eye(3)[self._up]
        turn = WEAVE * math.sin(2 * math.pi * seconds / TURN)
        aside = np.cross(up, self._ahead)
        heading = math.cos(turn) * self._ahead + math.sin(turn) * aside - math.tan(DOWN) * up
        width, height = self._size
        return Camera(
            0, width, height, height, height, width / 2, height / 2,
            look_at(eye, eye + heading, tuple(up)), near=1e-3 * self._chunk,
        )  # fmt: skip


class Watched(Programs):
    """A publisher of a streamed scene, and a viewer that is asked for pictures."""

    def __init__(self, path: Path, budget: int, log: Path) -> None:
        super().__init__(log)
        self._arguments = ["-p", f"path:={quoted(path)}", "-p", f"max_splats:={budget}"]

    def __enter__(self) -> Watched:
        super().__enter__()
        self._programs = {
            "viewer": self.node("rviz_gaussian_plugin", "viewer", "-p", "serve:=true"),
            "publisher": self.node(
                "rosplat_tools", "stream_publisher", *self._arguments, name="publisher"
            ),
        }
        self._revision = -1
        return self

    def render(self, camera: Camera) -> float:
        """Has a camera's picture drawn; returns how long that took [s]."""
        began = time.monotonic()
        answer = self.picture(camera, NO_PICTURE)
        while not answer.success:
            if time.monotonic() > began + PATIENCE:
                raise TimeoutError(NO_PICTURE)
            answer = self.picture(camera, NO_PICTURE)
        took = time.monotonic() - began
        colour = np.frombuffer(answer.color.data, np.float32)
        self.shown = colour.reshape(camera.height, camera.width, 4)[..., :3].copy()
        self._revision = answer.revision
        return took

    def until_rest(self, camera: Camera) -> tuple[float, dict[str, float]]:
        """Draws until nothing more comes; returns how long that took, and programs' work.

        Raises RuntimeError after PATIENCE. [s]
        """
        began = changed = time.monotonic()
        before = done = self._work()
        revision = self._revision
        self.still: list[float] = []
        while (now := time.monotonic()) - changed < SETTLED or (
            "at rest:" not in self.last_line("publisher")
        ):
            if now - began > PATIENCE:
                raise RuntimeError(f"not at rest after {PATIENCE:.0f} s")
            self.still.append(self.render(camera))
            if self._revision != revision:
                revision, changed, done = self._revision, time.monotonic(), self._work()
                self.still.clear()
        return changed - began, {name: done[name] - before[name] for name in done}

    def peaks(self) -> dict[str, int]:
        """The most memory that each of the programs has had in RAM. [bytes]"""
        return {name: machine.peak_bytes(run.pid) for name, run in self._programs.items()}

    def _work(self) -> dict[str, float]:
        return {name: machine.processor_seconds(run.pid) for name, run in self._programs.items()}


def _truth(scene: Streamed, camera: Camera) -> Array:
    """The picture of all that a camera may see, (height, width, 3), as fine as it is to be had."""
    from rosplat_core.rendering import CpuRenderer, posed

    view = PosedCamera(*rendering.pose(camera))
    levels = Levels(
        np.array([chunk.low for chunk in scene.chunks]),
        np.array([chunk.high for chunk in scene.chunks]),
        [tuple(part.count for part in chunk.levels) for chunk in scene.chunks],
    )
    scale = magnification(levels, [view]) * in_sight(levels, view)
    nothing = np.full(len(scene.chunks), NOTHING)
    most = TRUTH_BYTES // splat_bytes(scene.sh_degree)
    wanted = choose(levels, scale, nothing, most, TRUTH_ERROR)
    pieces = Pieces(scene, lambda text: None)
    parts = [
        chunk.levels[level]
        for chunk, level in zip(scene.chunks, wanted, strict=True)
        if level != NOTHING
    ]
    if not parts:
        raise InputError(f"{scene.path}: the camera sees none of its chunks")
    parts.sort(key=lambda part: (part.file, part.offset))
    renderer = CpuRenderer()
    rendering.insert_all(renderer, concatenate([pieces.read(part) for part in parts]))
    colour = renderer.draw(posed(camera))["colour"][..., :3]
    return np.clip(colour.astype(np.float64), 0, 1)


def _gardens(folder: Path, count: int) -> Path:
    """Writes gardens side by side as a streamed SOG, of some `count` splats at its finest; returns
    its lod-meta.json."""
    names: list[str] = []
    chunks: list[dict[str, Any]] = []
    for number in range(SIDE * SIDE):
        quarters: list[dict[str, Any]] = [{"lods": {}} for _ in range(4)]
        for level, share in enumerate(LEVELS):
            splats = generate(max(4, count // SIDE**2 // share), seed=number, sh_degree=0)
            quarter = (splats.positions[:, 0] > 0) + 2 * (splats.positions[:, 1] > 0)
            parts = [splats[quarter == which] for which in range(4)]
            offset = 0
            for chunk, part in zip(quarters, parts, strict=True):
                part.positions[:, :2] += np.multiply(APART, divmod(number, SIDE)).astype(np.float32)
                chunk["lods"][str(level)] = {
                    "file": len(names), "offset": offset, "count": len(part),
                }  # fmt: skip
                offset += len(part)
                if level == 0:
                    low, high = part.positions.min(axis=0), part.positions.max(axis=0)
                    chunk["bound"] = {"min": low.tolist(), "max": high.tolist()}
            names.append(f"{level}_{number}/{sog.META}")
            _unpack(concatenate(parts), folder / f"{level}_{number}")
        chunks += quarters
    path = folder / META
    path.write_text(
        json.dumps(
            {
                "version": 1,
                "lodLevels": len(LEVELS),
                "filenames": names,
                "tree": {"children": chunks},
            }
        )
    )
    return path


def _unpack(splats: Splats, folder: Path) -> None:
    packed = io.BytesIO()
    sog.write(packed, folder, splats)
    with zipfile.ZipFile(packed) as bundle:
        bundle.extractall(folder)
