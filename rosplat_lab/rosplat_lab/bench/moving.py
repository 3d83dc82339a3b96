"""What a view shows under motion where the processor paints: an older picture, carried over."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rosplat_lab import metrics
from rosplat_lab.bench import embedded, scenes
from rosplat_lab.bench.isolation import isolated
from rosplat_lab.bench.plan import Plan
from rosplat_lab.bench.records import Doing, Event, Measurement
from rosplat_tools.cameras import Camera

if TYPE_CHECKING:
    from rviz_gaussian_plugin.offscreen import Renderer

SIZES, QUICK_SIZES = (500_000,), (20_000,)
PICTURE, QUICK_PICTURE = (1280, 720), (320, 180)
AGES = (1, 2, 3, 4, 6, 8, 12)  # of the picture, in degrees that the camera has turned since
VIEWS = ("overview", "inside")


def measure(plan: Plan) -> Iterator[Event]:
    """PSNR of what is shown against the exact picture, by the turn of the camera since."""
    sizes = plan.sizes or (QUICK_SIZES if plan.quick else SIZES)
    names = scenes.names(sizes, plan.scenes)
    for number, name in enumerate(names):
        yield Doing(name, number / len(names))
        yield from isolated(_scene, name, QUICK_PICTURE if plan.quick else PICTURE)


def _shown(
    renderer: Renderer, view: embedded.View, camera: Camera, asynchronous: bool = False
) -> NDArray[np.float64]:
    renderer.settings.asynchronous = asynchronous
    view.look(camera)
    view.draw()
    picture: NDArray[np.float64] = renderer.read_color8() / 255
    return picture


def _scene(name: str, picture: tuple[int, int]) -> Iterator[Event]:
    from rviz_gaussian_plugin.offscreen import Rasterizer, ensure_display

    splats = scenes.load(name)
    with ensure_display():
        renderer = embedded.open_renderer()
        renderer.settings.rasterizer = Rasterizer.PROCESSOR
        embedded.insert_all(renderer, splats)
        view = embedded.View(renderer)

        for motion in VIEWS:
            cameras = scenes.VIEWS[motion](splats, *picture, max(AGES) + 1)
            stale = _shown(renderer, view, cameras[0])
            for age in AGES:
                exact = _shown(renderer, view, cameras[age])
                renderer.settings.asynchronous = True
                view.look(cameras[0])
                while not view.draw()["order_fresh"]:
                    pass
                carried = _shown(renderer, view, cameras[age], asynchronous=True)
                for what, seen in (("carried over", carried), ("as it is", stale)):
                    yield Measurement.of(
                        "PSNR", "dB", metrics.psnr(seen, exact), name, len(splats),
                        renderer.renderer_info, view=motion, turned=age, shown=what,
                    )  # fmt: skip
        del renderer, view  # while its display is there
