"""A loop closure: every submap of a map moves, from the message to the picture that shows it."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import cycle, pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rosplat_core.rendering import insert_groups, move
from rosplat_lab.bench import embedded, scenes
from rosplat_lab.bench.isolation import isolated
from rosplat_lab.bench.plan import Plan
from rosplat_lab.bench.records import Budget, Doing, Event, Measurement, milliseconds

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
        ends = [len(splats) * group // SUBMAPS for group in range(SUBMAPS + 1)]
        revision = insert_groups(renderer, [splats[a:b] for a, b in pairwise(ends)])
        finish = embedded.gl_finish()
        view = embedded.NumberedView(renderer)
        cameras = cycle(scenes.overview(splats, *picture, 2))
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
            move(renderer, dict(enumerate(_poses(random))), revision)

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


def _poses(random: np.random.Generator) -> NDArray[np.float64]:
    """(SUBMAPS, 7): x y z [m] and quaternion x y z w of each, off by some drift."""
    poses = np.zeros((SUBMAPS, 7))
    poses[:, :3] = random.normal(scale=DRIFT, size=(SUBMAPS, 3))
    poses[:, 3:6] = random.normal(scale=TURN / 2, size=(SUBMAPS, 3))
    poses[:, 6] = 1
    return poses
