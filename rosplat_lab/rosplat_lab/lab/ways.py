"""The ways to draw a map that users can choose, and models of other programs. A line adds one."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from rosplat_core import payload
from rosplat_core.cameras import Camera
from rosplat_core.models import Model
from rosplat_core.rendering import batches
from rosplat_core.simplification.search import Simplification
from rosplat_core.splats import Splats, concatenate
from rosplat_lab.bench.renderers import RENDERERS
from rosplat_lab.bench.scenes import turned
from rosplat_lab.bench.truths import Draw
from rosplat_lab.lab import orders, viewers

TIME, ERROR = "frame", "PSNR"  # names of what is measured
DEFAULT = "the defaults"
# Why a way is not held against others.
MODEL = "a model"
LATE = "an order that is late"
# What draws.
OURS = "ours"  # the display's on a graphics card, else the processor's rasteriser
DISPLAY = "display"
WINDOW = "window"  # the display's, read as a screen gets it

# Models that maps of three scales are drawn in, as the property names them.
MODELS = {Model.EWA: "EWA", Model.EWA_ANTIALIASED: "EWA Antialiased", Model.RAY: "Ray"}

WHOLE = "whole"
MOST_SIMPLIFIED = 1_000_000  # splats that `simplify` is tried with
REFIT_MINUTES, QUICK_REFIT_MINUTES = 0.5, 0.02
TURNING = np.radians(30)  # of a camera with late orders [rad/s]


@dataclass(frozen=True)
class Way:
    """A way to draw a picture."""

    setting: str
    """What a user types."""
    family: str
    settings: Mapping[str, Any] = field(default_factory=dict)
    """Of RenderSettings, by name."""
    map: str = WHOLE
    """Which of the maps that `maps` makes."""
    by: str = OURS
    order: Callable[[orders.Sorter, Camera], orders.Order] | None = None
    """Makes a sorter's order, which is drawn."""
    aside: str = ""
    """Why it is not held against others, empty where it is."""
    model: Draw | None = None
    """Draws in place of a renderer."""


def counted(splats: float) -> str:
    """A number of splats, as Detail and SPLATS take it."""
    if splats < 1e3:
        return f"{splats:.0f}"
    return f"{splats / 1e6:g}M" if splats >= 1e6 else f"{splats / 1e3:.0f}k"


def ways(splats: Splats, card: bool, quick: bool) -> Iterator[Way]:
    """The ways for a scene, the default first. card: whether a graphics card draws."""
    count = len(splats)
    yield Way(DEFAULT, "rasteriser")
    if card:
        yield Way("Rasterizer: Processor", "rasteriser", {"rasterizer": "PROCESSOR"}, by=DISPLAY)
    else:
        yield Way("Rasterizer: Tiles, by Mesa", "rasteriser", {"rasterizer": "TILES"}, by=DISPLAY)
    yield Way("the defaults, in a window of 8 bits", "rasteriser", by=WINDOW)
    for model, text in MODELS.items():  # the reference draws the map's own
        if model is not splats.model:
            yield Way(f"Model: {text}", "Model", {"model": model})

    given = {"order": "SIDECAR"}
    exact = partial(Way, family="order", settings=given, by=DISPLAY)
    yield exact("Order Source: Sidecar", order=orders.Sorter.order)
    for late in (33, 100, 300):
        yield exact(
            f"Order Source: Sidecar, {late} ms late at 30 deg/s", aside=LATE,
            order=partial(_late, seconds=late / 1000),
        )  # fmt: skip
    keys: dict[str, orders.Keys] = {
        "16 bits": orders.linear(16), "12 bits": orders.linear(12), "distance": orders.by_distance,
    }  # fmt: skip
    for name, key in keys.items():
        yield exact(f"sort keys: {name}", aside=MODEL, order=partial(orders.Sorter.keyed, keys=key))

    for pixels in (2, 4, 8, 16):
        yield Way(f"Detail: {pixels} px", "Detail", {"detail": f"{pixels}px", "interactive": True})
    for part in (2, 4, 8):
        fewer = max(count // part, 1)
        yield Way(f"Detail: {counted(fewer)}", "Detail",
                  {"detail": f"{fewer}", "interactive": True})  # fmt: skip
    yield Way("compression: quantised", "numbers of a splat", map="quantised")
    for degree in range(splats.sh_degree):
        yield Way(f"SH Degree: {degree}", "numbers of a splat", {"max_sh_degree": degree})
    if count <= MOST_SIMPLIFIED:
        minutes = QUICK_REFIT_MINUTES if quick else REFIT_MINUTES
        for part in (2, 4):
            setting = f"simplify SPLATS={counted(count // part)}"
            yield Way(setting, "simplify", map=f"1/{part}")
            if not refits(splats):
                continue
            yield Way(f"{setting} REFINE={minutes:g}", "simplify", map=f"1/{part} refitted")
    if card:
        for name in RENDERERS:
            if name != "cpu":
                yield Way(name, "other renderers", by=name)
    yield Way("RVizSplat 1.0.0", "other renderers", aside=MODEL, model=viewers.rvizsplat)


def refits(splats: Splats) -> bool:
    """Whether simplify can refine the map: a refit draws by EWA."""
    return splats.model in (Model.EWA, Model.EWA_ANTIALIASED)


def maps(splats: Splats, quick: bool) -> Iterator[tuple[str, Splats]]:
    """The maps that ways name, one by one."""
    yield WHOLE, splats
    yield "quantised", quantised(splats)
    if len(splats) > MOST_SIMPLIFIED:
        return
    work = Simplification(splats)
    for part in (2, 4):
        work.reduce(len(splats) // part)
        merged = work.splats
        yield f"1/{part}", merged
        if not refits(splats):
            continue
        work.refine(60 * (QUICK_REFIT_MINUTES if quick else REFIT_MINUTES))
        yield f"1/{part} refitted", work.splats
        work.splats = merged


def quantised(splats: Splats, always: bool = False) -> Splats:
    """The splats as they arrive, batch by batch, if a publisher's compression is quantised.

    always: in one batch, however far apart its splats are.
    """
    parts = []
    for part in [slice(None)] if always else batches(splats):
        sent = splats[part]
        usable = np.ones(len(sent), bool)
        if always or payload.suits(sent, usable):
            came = payload.decode(payload.encode(sent, usable), len(sent), sent.sh_degree)
            sent = replace(sent, **vars(came))
        parts.append(sent)
    return concatenate(parts)


def _late(sorter: orders.Sorter, camera: Camera, seconds: float) -> orders.Order:
    return sorter.order(turned(camera, -TURNING * seconds))
