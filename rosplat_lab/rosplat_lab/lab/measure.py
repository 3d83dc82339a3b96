"""Times and errors of every way to draw scenes, as events of a benchmark.

All pictures of a scene are of the same VIEWS, which frames take in turn. A pass goes through all
ways. There are several passes, so that a figure's noise is that of minutes, not of moments.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from rosplat_core.cameras import Camera
from rosplat_core.rendering import psnr_of
from rosplat_core.splats import Splats
from rosplat_lab.bench import scenes, truths
from rosplat_lab.bench.isolation import isolated
from rosplat_lab.bench.plan import Plan
from rosplat_lab.bench.records import (
    Doing,
    Event,
    Measurement,
    Skipped,
    in_a_row,
    milliseconds,
)  # fmt: skip
from rosplat_lab.bench.renderers import RENDERERS, CpuRenderer, DisplayRenderer, Ours, accelerated
from rosplat_lab.lab import moving, orders
from rosplat_lab.lab.ways import ERROR, MODEL, OURS, TIME, WHOLE, WINDOW, Way, counted, maps, ways

PICTURE, QUICK_PICTURE = (1280, 720), (160, 90)
VIEWS = ((scenes.overview, 0.0), (scenes.inside, 0.0), (scenes.overview, 2.5), (scenes.inside, 2.5))
"""Cameras, and by how much they are turned around the scene. [rad]"""
PASSES, QUICK_PASSES = 5, 2
WARM_UP = 0.1  # of drawing in each pass, for a card that had nothing to do [s]
SLOW = 2.0  # a way that takes longer for all views has two passes, of one picture each [s]
SETTLED = 0.01  # by how much the error of levels may still change from picture to picture
MOST_SETTLING = 60  # most pictures until a budget is kept
MOVING_SPLATS = 200_000  # scenes with fewer are drawn in time whatever moves
STRIP_WIDTH = 320  # of the pictures in the report [px]
ERROR_GAIN = 16  # differences are white at a 16th of the way from black to white


@dataclass
class Measured:
    """What the passes of a way have found so far."""

    way: Way
    times: list[float] = field(default_factory=list)
    """Of each pass: mean over the views of the median. [ms]"""
    errors: list[float] = field(default_factory=list)
    """Of each pass: PSNR of all views' pixels together. [dB]"""
    facts: dict[str, Any] = field(default_factory=dict)
    done: bool = False


def measure(plan: Plan, names: Sequence[str], strips: Path) -> Iterator[Event]:
    """A time and an error for each way and scene; small pictures into a folder."""
    from rviz_gaussian_plugin.offscreen import ensure_display

    with ensure_display():
        card = accelerated()
        yield from in_a_row([partial(_scene, plan, name, strips, card) for name in names])


def _scene(plan: Plan, name: str, strips: Path, card: bool) -> Iterator[Event]:
    picture = QUICK_PICTURE if plan.quick else PICTURE
    looks = [partial(_camera, number, picture) for number in range(len(VIEWS))]
    yield Doing(f"{name}: reference", 0.0)
    told = truths.draw(name, looks)
    yield from isolated(_drawn, plan, name, looks, told, strips)
    yield from _models(name, looks, told, strips)
    if not card:  # a card has each picture in time
        yield from _moving(plan, name)


def _camera(number: int, picture: tuple[int, int], splats: Splats) -> Camera:
    view, turn = VIEWS[number]
    return view(splats, *picture, 2, turn)[-1] if turn else view(splats, *picture, 1)[0]


def _drawn(
    plan: Plan, name: str, looks: Sequence[truths.Look], told: list[truths.Truth], strips: Path
) -> Iterator[Event]:
    """Measures all ways that have a time. Needs a process of its own."""
    splats = scenes.load(name)
    cameras = [look(splats) for look in looks]
    display = DisplayRenderer()
    wanted = [way for way in ways(splats, display.accelerated, plan.quick) if not way.model]
    made: dict[str, Splats] = {}
    for which, smaller in maps(splats, plan.quick):
        yield Doing(f"{name}: {which} of the map", 0.1 + 0.05 * len(made))
        made[which] = smaller
    stage = Stage(plan, cameras, made, display)
    found = [Measured(way) for way in wanted]
    passes = QUICK_PASSES if plan.quick else PASSES
    for number in range(passes):
        for index, measured in enumerate(found):
            way = measured.way
            if measured.done:
                continue
            part = 0.4 + 0.5 * (number + index / len(found)) / passes
            yield Doing(f"{name}, {way.setting}, pass {number + 1} of {passes}", part)
            try:
                first = stage.measure(measured, told)
            except (ImportError, RuntimeError, ValueError) as error:
                yield Skipped(f"{name}, {way.setting}: {error}")
                measured.done = True
                continue
            if number == 0:
                save_strip(strip(strips, name, way.setting), first, told[0])
            slow = sum(measured.times) / 1e3 * len(cameras) > SLOW
            measured.done = slow and len(measured.times) > 1
    for measured in found:
        if measured.times:
            yield from _measurements(name, len(splats), stage.device, measured)


def _measurements(name: str, count: int, device: str, measured: Measured) -> Iterator[Measurement]:
    way = measured.way
    labels: dict[str, Any] = {
        "scene": Path(name).name, "splats": count, "gpu": device, "setting": way.setting,
        "family": way.family, "aside": way.aside,
    }  # fmt: skip
    if measured.times and way.aside != MODEL:
        yield Measurement(TIME, "ms", measured.times, **labels)
    yield Measurement(ERROR, "dB", measured.errors, **labels, **measured.facts)


class Stage:
    """Measures ways: has the renderers, and the map that each of them holds."""

    def __init__(
        self, plan: Plan, cameras: list[Camera], made: dict[str, Splats], display: DisplayRenderer
    ) -> None:
        self._plan, self._cameras, self._maps, self._display = plan, cameras, made, display
        self._on_display = ""  # name of the map that the display holds
        self._renderers: dict[tuple[str, str], Any] = {}
        self._details: dict[tuple[str, int], str] = {}
        self._sorter = orders.Sorter(made[WHOLE])
        self.device = display.device if display.accelerated else CpuRenderer().device

    def measure(self, measured: Measured, told: list[truths.Truth]) -> NDArray[np.float32]:
        """Adds a pass; returns what is compared of the first view.

        Raises RuntimeError where something else was drawn than asked for.
        """
        way = measured.way
        renderer = self._renderer(way)
        shown, drawn, first = [], 0, []
        for number in range(len(told)):
            first.append(self._draw(renderer, way, number))
            shown.append(self._shown(renderer, way))
            drawn += getattr(renderer, "report", {}).get("splats", 0)
        slow = sum(first) > 1e3 * SLOW
        cycles = [first] if slow else []
        warm = perf_counter() + WARM_UP
        end = warm + self._plan.budget.seconds / 8
        while not slow and (perf_counter() < end or not cycles):
            cycle = [self._draw(renderer, way, number) for number in range(len(told))]
            if perf_counter() > warm:
                cycles.append(cycle)
        measured.times.append(float(np.mean(np.median(cycles, axis=0))))
        error, measured.facts = _errors(shown, told, drawn // len(told))
        measured.errors.append(error)
        return shown[0]

    def _renderer(self, way: Way) -> Any:
        """What draws a way, with the way's map."""
        on_processor = way.by == OURS and not self._display.accelerated
        if on_processor or way.by in RENDERERS:
            key = way.by, way.map
            if key not in self._renderers:
                self._renderers[key] = CpuRenderer() if on_processor else RENDERERS[way.by]()
                self._renderers[key].set_map(self._maps[way.map])
            renderer = self._renderers[key]
        else:
            renderer = self._display
            if self._on_display != way.map:
                renderer.set_map(self._maps[way.map])
                self._on_display = way.map
        if "detail" in way.settings:
            renderer.merge()
        return renderer

    def _draw(self, renderer: Any, way: Way, number: int) -> float:
        """Draws a view; returns the time that it took. [ms]"""
        camera = self._cameras[number]
        if way.by not in RENDERERS:
            renderer.use(dict(way.settings))
            if "detail" in way.settings:
                renderer.use({**way.settings, "detail": self._detail(renderer, way, number)})
        renderer.set_camera(camera)
        if not way.order:
            return milliseconds(renderer.draw)
        began = perf_counter()
        order = way.order(self._sorter, camera)
        renderer.set_order(order)
        renderer.draw()
        took = 1e3 * (perf_counter() - began)
        if renderer.report["order_source"] != "bench":
            raise RuntimeError(f"the order of {renderer.report['order_source']} was drawn")
        return took

    def _shown(self, renderer: Any, way: Way) -> NDArray[np.float32]:
        if way.by == WINDOW:
            return truths.middle(renderer.renderer.read_color8() / 255)
        return truths.middle(renderer.picture())

    def _detail(self, renderer: Ours, way: Way, number: int) -> str:
        """Detail as an error in px; of a budget, the error that it comes to in a view. It comes
        there by small steps, from picture to picture, as in rviz nobody waits for one."""
        detail = str(way.settings["detail"])
        if detail.endswith("px"):
            return detail
        key = (way.setting, number)
        if key not in self._details:
            renderer.set_camera(self._cameras[number])
            before = -1.0
            for _ in range(MOST_SETTLING):
                renderer.draw()
                error = float(renderer.report["error"])
                if abs(error - before) <= SETTLED * before:
                    break
                before = error
            self._details[key] = f"{error:.6g}px" if error else "full"
        return self._details[key]


def _errors(
    shown: Sequence[NDArray[np.float32]], told: Sequence[truths.Truth], drawn: int
) -> tuple[float, dict[str, Any]]:
    """PSNR of all views' pixels together [dB], and facts. drawn: splats in a view, on average."""
    pairs = zip(shown, told, strict=True)
    squares = [np.square(picture - np.clip(truth, 0, 1)) for picture, truth in pairs]
    return psnr_of(float(np.mean(squares))), {
        "worst_view": min(psnr_of(float(square.mean())) for square in squares),
        "worst_pixel": math.sqrt(max(float(square.max()) for square in squares)),
        "drawn": drawn,
    }


def _models(
    name: str, looks: Sequence[truths.Look], told: list[truths.Truth], strips: Path
) -> Iterator[Event]:
    """The errors of models, which are drawn in NumPy."""
    splats = scenes.load(name)
    for way in ways(splats, False, True):
        if way.model:
            yield Doing(f"{name}, {way.setting}: a model", 0.9)
            drawn = [np.clip(picture, 0, 1) for picture in truths.draw(name, looks, way.model)]
            save_strip(strip(strips, name, way.setting), drawn[0], told[0])
            error, facts = _errors(drawn, told, len(splats))
            found = Measured(way, [], [error], facts)
            yield from _measurements(name, len(splats), "NumPy", found)


def _moving(plan: Plan, name: str) -> Iterator[Event]:
    """PSNR and times of a window's pictures while the camera turns, by Detail, where the processor
    draws: its pictures come late."""
    count = len(scenes.load(name))
    if count < MOVING_SPLATS and not plan.quick:
        return
    for text, detail in {"Full": "full", counted(count // 4): f"{count // 4}"}.items():
        setting = f"Detail: {text}, while turning"
        yield Doing(f"{name}, {setting}, {moving.MOVING}", 0.95)
        yield from isolated(moving.in_motion, name, plan.quick, setting, detail)


# --- Small pictures -------------------------------------------------------------------------------


def strip(folder: Path, scene: str, setting: str) -> Path:
    """Where the small pictures of a way and a scene are kept."""
    return folder / (re.sub(r"[^\w.]+", "-", f"{Path(scene).stem} {setting}") + ".webp")


def save_strip(path: Path, shown: NDArray[np.floating], truth: truths.Truth) -> None:
    """Keeps small pictures for the report: truth, picture and their difference, side by side."""
    truth = np.clip(truth, 0, 1)
    error = np.clip(ERROR_GAIN * np.abs(shown - truth).max(axis=2, keepdims=True), 0, 1)
    tiles = np.hstack([truth, shown, np.broadcast_to(error, truth.shape)])
    height = round(STRIP_WIDTH * truth.shape[0] / truth.shape[1])
    small = Image.fromarray(np.rint(255 * tiles).astype(np.uint8))
    path.parent.mkdir(parents=True, exist_ok=True)
    small.resize((3 * STRIP_WIDTH, height), Image.Resampling.BOX).save(path, quality=60)
