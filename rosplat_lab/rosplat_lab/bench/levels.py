"""Levels of detail: error against what they save, what they cost, and popping."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from rosplat_core import rendering
from rosplat_core.cameras import Camera
from rosplat_core.rendering import posed
from rosplat_core.splats import SceneError, Splats
from rosplat_lab import metrics
from rosplat_lab.bench import embedded, scenes
from rosplat_lab.bench.isolation import isolated
from rosplat_lab.bench.plan import Plan
from rosplat_lab.bench.records import Budget, Doing, Event, Measurement, milliseconds

Array = NDArray[np.float64]

SIZES, QUICK_SIZES = (5_000_000,), (20_000,)
PICTURE, QUICK_PICTURE = (1280, 720), (320, 180)
ERRORS = (1, 2, 3, 4, 6, 8, 12, 16)  # [px]
SPLATS = 1_000_000  # that a budget allows
SHARES = (0.75, 0.5, 0.33, 0.25, 0.12)  # of the splats that full detail draws, as budgets
EDITED = 10_000  # splats, of an edit
SUPERSAMPLED = 4  # pixels of the truth in one, along an axis
PATH, QUICK_PATH = 30, 4  # pictures
POPPING = ("2px", "4px", "8px")
STEPS = 8  # cameras that take turns
STEP = 0.005  # from one picture to the next [m]
NEAR = 0.5  # away, to what the camera comes nearer by STEP [m]


class Drawer(Protocol):
    """A map, drawn in any detail. Making it raises RuntimeError where it can't draw."""

    renderer: Any
    device: str
    """What draws."""

    def merge(self) -> dict[str, float]:
        """Has the levels hold all of the map; what they take, and how many nodes they have."""

    def draw(self, camera: Camera) -> dict[str, Any]:
        """`splats` drawn and the `error` [px]; returns when the picture is whole."""

    def colour(self) -> Array:
        """(height, width, 3) of the last picture, over black."""


class Processor:
    """Draws without a graphics card."""

    def __init__(self) -> None:
        self._pose = lambda camera: posed(camera)
        self.renderer = rendering.CpuRenderer()
        self.device = f"CPU, {self.renderer.instructions}"

    def merge(self) -> dict[str, float]:
        nodes = self.renderer.merge()
        return {"nodes": nodes, "memory": self.renderer.levels_bytes}

    def draw(self, camera: Camera) -> dict[str, Any]:
        self._drawn: dict[str, Any] = self.renderer.draw(self._pose(camera))
        return self._drawn

    def colour(self) -> Array:
        return self._drawn["colour"][..., :3].astype(np.float64)


class Card:
    """Draws with a graphics card. Merging includes what brings the nodes there."""

    def __init__(self) -> None:
        self.renderer = embedded.open_renderer()
        self.device = self.renderer.renderer_info
        # The levels stay for as long as some view wants any.
        self._views = {
            full: embedded.NumberedView(self.renderer, str(full)) for full in (False, True)
        }
        self._finish = embedded.gl_finish()

    def merge(self) -> dict[str, float]:
        self.renderer.settings.detail = "1px"
        drawn = self.draw(Camera(0, 16, 16, 16.0, 16.0, 8.0, 8.0, np.eye(4)))
        return {"memory": drawn["levels_bytes"]}

    def draw(self, camera: Camera) -> dict[str, Any]:
        view = self._views[self.renderer.settings.detail == "full"]
        view.look(camera)
        drawn = view.draw(sort_now=True)
        self._finish()
        return drawn

    def colour(self) -> Array:
        return self.renderer.read_color()[..., :3].astype(np.float64)


DRAWERS: dict[str, Callable[[], Drawer]] = {"processor": Processor, "card": Card}


def measure(plan: Plan) -> Iterator[Event]:
    """Building and repairing levels; PSNR and frames by error; popping."""
    sizes = plan.sizes or ((QUICK_SIZES if plan.quick else SIZES) if not plan.scenes else ())
    picture = QUICK_PICTURE if plan.quick else PICTURE
    length = QUICK_PATH if plan.quick else PATH
    with _drawers(plan) as drawers:
        jobs = [(name, which) for name in scenes.names(sizes, plan.scenes) for which in drawers]
        for number, (name, which) in enumerate(jobs):
            yield Doing(f"{name}, {which}", number / len(jobs))
            yield from isolated(_scene, name, which, picture, length, plan.budget)


@contextmanager
def _drawers(plan: Plan) -> Iterator[Sequence[str]]:
    """Those that there are, or of these those that are asked for, with a display to draw on."""
    from rviz_gaussian_plugin.offscreen import ensure_display

    if unknown := set(plan.variants) - DRAWERS.keys():
        known = ", ".join(DRAWERS)
        raise SceneError(f"unknown variant '{unknown.pop()}', known are {known}")
    if plan.variants == ("processor",):
        yield plan.variants
        return
    with ensure_display():
        (drawing,) = isolated(embedded.hardware)
        accelerated = isinstance(drawing, Measurement) and "llvmpipe" not in drawing.gpu
        yield plan.variants or (tuple(DRAWERS) if accelerated else ("processor",))


def _scene(
    name: str, which: str, picture: tuple[int, int], length: int, budget: Budget
) -> Iterator[Event]:
    splats = scenes.load(name)
    drawer = DRAWERS[which]()
    rendering.insert_all(drawer.renderer, splats)

    def of(what: str, unit: str, samples: Any, **parameters: str | float) -> Measurement:
        return Measurement.of(what, unit, samples, name, len(splats), drawer.device, **parameters)

    camera = scenes.overview(splats, *picture, 1)[0]
    _show(drawer, camera, "full")  # which has the map where it is drawn
    yield of("build", "s per million splats", 1e3 * milliseconds(drawer.merge) / len(splats))
    held = drawer.merge()
    if "nodes" in held:
        yield of("nodes", "per splat", held["nodes"] / len(splats))
    yield of("memory", "bytes per splat", held["memory"] / len(splats))
    yield of("repair", "ms", [_repair(drawer, splats, part) for part in range(5)])
    for view in scenes.views(name):
        cameras = scenes.VIEWS[view](splats, *picture, STEPS)
        camera = cameras[0]
        full = _picture(drawer, camera, "full")
        whole = drawer.draw(camera)["splats"]
        truth = _truth(drawer, camera)
        yield of("PSNR against the truth", "dB", _psnr(full, truth), view=view, px=0.0)
        # A share of one scene may be just as many.
        budgets = dict.fromkeys((SPLATS, *(max(int(share * whole), 1) for share in SHARES)))
        errors = (f"{error}px" for error in ERRORS)
        for detail in ("full", *(f"{budget}" for budget in budgets), *errors):
            _show(drawer, camera, detail)

            def frame(number: int, cameras: Sequence[Camera] = cameras) -> float:
                return milliseconds(lambda: drawer.draw(cameras[number % STEPS]))

            times = budget.spend(frame, embedded.WARM_UP)
            drawn = drawer.draw(camera)
            shown: dict[str, Any] = {"view": view, "detail": detail, "px": drawn["error"]}
            shown |= {"drawn": drawn["splats"]}
            yield of("frame", "ms", times, **shown)
            if detail == "full":
                continue
            shown |= {"share": drawn["splats"] / max(whole, 1), "ms": float(np.median(times))}
            colour = np.clip(drawer.colour(), 0, 1)
            yield of("PSNR", "dB", _psnr(colour, full), **shown)
            yield of("PSNR against the truth", "dB", _psnr(colour, truth), **shown)
    camera = scenes.inside(splats, *picture, 1)[0]
    for detail, changes in _fades(drawer, camera, length).items():
        most = [np.quantile(change, 0.999) for change in changes]
        yield of("popping of a camera at rest, 99.9 % of pixels", "/255", most, detail=detail)
        worst = [change.max() for change in changes]
        yield of("popping of a camera at rest, worst pixel", "/255", worst, detail=detail)


def _psnr(picture: Array, reference: Array) -> float:
    return min(metrics.psnr(picture, reference), rendering.MOST_PSNR)


def _repair(drawer: Drawer, splats: Splats, part: int) -> float:
    """Milliseconds that the levels take for an edit of neighbouring splats."""
    count = min(EDITED, len(splats))
    first = (len(splats) - count) * part // 4
    rendering.insert(drawer.renderer, splats, slice(first, first + count), 1000 + part)
    return milliseconds(drawer.merge)


def _show(drawer: Drawer, camera: Camera, detail: str) -> None:
    drawer.renderer.settings.detail = detail
    drawer.draw(camera)


def _picture(drawer: Drawer, camera: Camera, detail: str) -> Array:
    """(height, width, 3) as a screen shows it, over black."""
    _show(drawer, camera, detail)
    return np.clip(drawer.colour(), 0, 1)


def _truth(drawer: Drawer, camera: Camera) -> Array:
    """The same, each pixel the mean of many: without what the low-pass filter adds to it."""
    n = SUPERSAMPLED
    fine = replace(
        camera, width=n * camera.width, height=n * camera.height, fx=n * camera.fx,
        fy=n * camera.fy, cx=n * camera.cx, cy=n * camera.cy,
    )  # fmt: skip
    colour = _picture(drawer, fine, "full")
    mean: Array = colour.reshape(camera.height, n, camera.width, n, 3).mean(axis=(1, 3))
    return mean


def _fades(drawer: Drawer, camera: Camera, length: int) -> dict[str, list[Array]]:
    """By how much pixels change from picture to picture by the cut alone [/255]: the camera rests,
    and errors grow as those of what is NEAR do along the path."""

    def pictures(detail: str) -> Iterator[Array]:
        for index in range(length):
            error = float(detail.removesuffix("px")) * (1 + STEP / NEAR) ** index
            yield _picture(drawer, camera, f"{error:.6g}px")

    return {
        detail: [255 * np.abs(b - a).max(axis=2) for a, b in itertools.pairwise(pictures(detail))]
        for detail in POPPING
    }
