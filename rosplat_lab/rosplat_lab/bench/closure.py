"""A loop closure: every submap of a map moves, from the message to the picture that shows it."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rosplat_core import maps, rendering
from rosplat_core.slot_pages import SLOTS_PER_PAGE
from rosplat_core.splats import Splats
from rosplat_lab.bench import embedded, scenes
from rosplat_lab.bench.isolation import isolated
from rosplat_lab.bench.plan import Plan
from rosplat_lab.bench.records import Budget, Doing, Event, Measurement, milliseconds
from rviz_gaussian_plugin.offscreen import Renderer

SIZES, QUICK_SIZES = (5_000_000,), (20_000,)
PICTURE, QUICK_PICTURE = (1920, 1080), (320, 180)
SUBMAPS = 50
DRIFT, TURN = 0.02, 0.01  # standard deviations of the poses before a closure [m], [rad]


def measure(plan: Plan) -> Iterator[Event]:
    """Times to apply a closure, and until a picture shows all submaps in place."""
    sizes = plan.sizes or ((QUICK_SIZES if plan.quick else SIZES) if not plan.scenes else ())
    names = scenes.names(sizes, plan.scenes)
    for number, name in enumerate(names):
        yield Doing(name, number / len(names))
        yield from isolated(_scene, name, QUICK_PICTURE if plan.quick else PICTURE, plan.budget)


def _scene(name: str, picture: tuple[int, int], budget: Budget) -> Iterator[Event]:
    from rviz_gaussian_plugin.offscreen import ensure_display

    splats = scenes.load(name)
    with ensure_display():
        renderer = embedded.open_renderer()
        revision = _insert(renderer, splats)
        finish = embedded.gl_finish()
        view = embedded.NumberedView(renderer)
        cameras = itertools.cycle(scenes.overview(splats, *picture, 2))
        random = np.random.default_rng(0)

        def draw() -> None:
            view.draw(sort_now=True)
            finish()

        def frame(_: int) -> float:
            view.look(next(cameras))
            return milliseconds(draw)

        def take() -> None:
            nonlocal revision
            revision += 1
            _move(renderer, _poses(random), revision)

        took: list[float] = []

        def closure(_: int) -> float:
            took.append(milliseconds(take))
            return took[-1] + milliseconds(draw)

        frames = budget.spend(frame, embedded.WARM_UP)
        closures = budget.spend(closure)
        common: dict[str, Any] = {"scene": name, "splats": len(splats)}
        common |= {"gpu": renderer.renderer_info}
        parameters: dict[str, Any] = {"submaps": SUBMAPS, "width": picture[0], "height": picture[1]}
        yield Measurement.of("to take it", "ms", took, **common, **parameters)
        yield Measurement.of("to the picture", "ms", closures, **common, **parameters)
        yield Measurement.of("a frame after a turn", "ms", frames, **common, **parameters)
        renderer = view = None  # type: ignore[assignment] # before the display


def _insert(renderer: Renderer, splats: Splats) -> int:
    """Inserts a map of submaps, each of neighbours in space; returns its revision."""
    revision, first = 1, 0
    fields = {"map_id": rendering.MAP, "expected_slots": len(splats)}
    renderer.apply(maps.batch_of(splats, slice(0), revision=revision, **fields))
    for group in range(SUBMAPS):
        part = slice(len(splats) * group // SUBMAPS, len(splats) * (group + 1) // SUBMAPS)
        revision += 1
        renderer.apply(
            maps.batch_of(
                splats, part, operation=maps.UPSERT, first_slot=first, revision=revision,
                group=group, **fields,
            )
        )  # fmt: skip
        first += -(-(part.stop - part.start) // SLOTS_PER_PAGE) * SLOTS_PER_PAGE
    return revision


def _poses(random: np.random.Generator) -> NDArray[np.float64]:
    """(SUBMAPS, 7): x y z [m] and quaternion x y z w of each, off by some drift."""
    poses = np.zeros((SUBMAPS, 7))
    poses[:, :3] = random.normal(scale=DRIFT, size=(SUBMAPS, 3))
    poses[:, 3:6] = random.normal(scale=TURN / 2, size=(SUBMAPS, 3))
    poses[:, 6] = 1
    return poses


def _move(renderer: Renderer, poses: NDArray[np.float64], revision: int) -> None:
    rendering.move(renderer, dict(enumerate(poses)), revision)
