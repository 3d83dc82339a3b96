"""A streamed scene, as a camera flies through it: pauses, memory, waiting, and what is missing."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rosplat_core import rendering
from rosplat_core.cameras import Camera, look_at
from rosplat_core.formats.streamed_sog import Pieces, Streamed, open_streamed
from rosplat_core.posed_camera import PosedCamera
from rosplat_core.program import machine
from rosplat_core.splats import InputError, concatenate, splat_bytes
from rosplat_lab import metrics
from rosplat_lab.bench import streamed_gardens
from rosplat_lab.bench.isolation import isolated
from rosplat_lab.bench.plan import Plan
from rosplat_lab.bench.records import Doing, Event, Measurement
from rosplat_lab.programs import Programs
from rosplat_ros.program.processes import quoted
from rosplat_ros.view_cameras import view_camera
from rosplat_tools.streaming.detail import NOTHING, Levels, choose, in_sight, magnification

if TYPE_CHECKING:
    from rosplat_msgs.srv import RenderView

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

TRUTH_BYTES = 1 << 29  # most for the truth's splats, as in messages; the nearest come first
TRUTH_ERROR = 0.25  # that is small enough for it [px]


@dataclass(frozen=True)
class Sight:
    """What a viewer showed to a camera, (height, width, 3), and when: at rest, say."""

    camera: Camera
    picture: NDArray[np.float32]
    when: str


def measure(plan: Plan) -> Iterator[Event]:
    """Pictures' times and processes' memory in flight, seconds until rest, PSNR."""
    names = [] if plan.scenes and not plan.sizes else list(plan.sizes)
    if not names and not plan.scenes:
        names = list(QUICK_SIZES if plan.quick else SIZES)
    with TemporaryDirectory() as folder:
        jobs = []
        for size in names:
            yield Doing(f"a scene of {size:,} splats is written", 0.0)
            jobs.append(
                (streamed_gardens.write(Path(folder) / f"gardens-{size}", size), size // SHARE)
            )
        jobs += [(Path(scene), budget) for scene in plan.scenes for budget in BUDGETS]
        for number, (path, budget) in enumerate(jobs):
            yield Doing(f"{path.parent.name}, {budget:,} splats", number / len(jobs))
            yield from isolated(_scene, path, budget, plan.out, plan.quick)


def _scene(path: Path, budget: int, out: Path, quick: bool) -> Iterator[Event]:
    scene = open_streamed(path)
    course = Course(scene, *(QUICK_PICTURE if quick else PICTURE))
    common: dict[str, Any] = {"scene": scene.path.parent.name, "splats": scene.splats}
    sights: list[Sight] = []
    with Watched(path, budget, out / "log") as watched:
        flight = QUICK_FLIGHT if quick else FLIGHT
        waits = {"start": watched.until_rest(course.at(0.0))}
        yield Measurement.of(
            "picture at rest", "ms", 1e3 * np.array(watched.still), **common, budget=budget
        )
        sights.append(Sight(course.at(0.0), watched.picture, "at rest"))
        pauses = []
        began = time.monotonic()
        while (since := time.monotonic() - began) < flight:
            camera = course.at(since)
            pauses.append(watched.render(camera))
            if len(sights) - 1 < SIGHTS and since > len(sights) / (SIGHTS + 1) * flight:
                sights.append(Sight(camera, watched.picture, "in flight"))
        yield Measurement.of(
            "picture in flight", "ms", 1e3 * np.array(pauses), **common, budget=budget
        )
        waits["flight"] = watched.until_rest(course.at(flight))
        sights.append(Sight(course.at(flight), watched.picture, "at rest"))
        waits["jump"] = watched.until_rest(course.at(0.0, ELSEWHERE))
        sights.append(Sight(course.at(0.0, ELSEWHERE), watched.picture, "at rest"))
        for after, wait in waits.items():
            yield Measurement.of(
                "until at rest", "s", wait.time, **common, budget=budget, after=after
            )
            for name, work in wait.work.items():
                yield Measurement.of(
                    "processor time until at rest", "s", work, **common, budget=budget, after=after,
                    process=name,
                )  # fmt: skip
        for name, peak in watched.peaks().items():
            yield Measurement.of("RAM", "MB", peak / 1e6, **common, budget=budget, process=name)
    values: dict[str, list[float]] = {}
    for sight in sights:
        shown, truth = np.clip(sight.picture, 0, 1), _truth(scene, sight.camera)
        values.setdefault(sight.when, []).append(metrics.psnr(shown, truth))
    for when, found in values.items():
        yield Measurement.of("PSNR", "dB", found, **common, budget=budget, when=when)


@dataclass(frozen=True)
class Wait:
    """Time until a map was at rest, and processor time until then, by program. [s]"""

    time: float
    work: dict[str, float]


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
        from rosplat_msgs.srv import RenderView

        super().__enter__()
        self._programs = {
            "viewer": self.node("rviz_gaussian_plugin", "viewer", "-p", "serve:=true"),
            "publisher": self.node(
                "rosplat_tools", "stream_publisher", *self._arguments, name="publisher"
            ),
        }
        self._client: Any = self.asker.create_client(RenderView, "gaussians/render")
        self._revision = -1
        return self

    def render(self, camera: Camera) -> float:
        """Has a camera's picture drawn; returns how long that took [s]."""
        began = time.monotonic()
        answer = self._ask(camera)
        took = time.monotonic() - began
        colour = np.frombuffer(answer.color.data, np.float32)
        self.picture = colour.reshape(camera.height, camera.width, 4)[..., :3].copy()
        self._revision = answer.revision
        return took

    def until_rest(self, camera: Camera) -> Wait:
        """Draws until nothing more comes. Raises RuntimeError after PATIENCE."""
        began = changed = time.monotonic()
        before = done = self._work()
        revision = self._revision
        self.still: list[float] = []
        while (now := time.monotonic()) - changed < SETTLED or not self._at_rest():
            if now - began > PATIENCE:
                raise RuntimeError(f"not at rest after {PATIENCE:.0f} s")
            self.still.append(self.render(camera))
            if self._revision != revision:
                revision, changed, done = self._revision, time.monotonic(), self._work()
                self.still.clear()
        return Wait(changed - began, {name: done[name] - before[name] for name in done})

    def peaks(self) -> dict[str, int]:
        """The most memory that each of the programs has had in RAM. [bytes]"""
        return {name: machine.peak_bytes(run.pid) for name, run in self._programs.items()}

    def _work(self) -> dict[str, float]:
        return {name: machine.processor_seconds(run.pid) for name, run in self._programs.items()}

    def _at_rest(self) -> bool:
        return "at rest:" in self.last_line("publisher")

    def _ask(self, camera: Camera) -> RenderView.Response:
        from rosplat_msgs.srv import RenderView

        complaint = f"no picture from {self._client.srv_name}"
        deadline = time.monotonic() + PATIENCE
        while time.monotonic() < deadline:
            request = RenderView.Request(camera=view_camera(camera))
            answer = self.call(self._client, request, complaint)
            if answer.success:
                return answer
        raise TimeoutError(complaint)


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
