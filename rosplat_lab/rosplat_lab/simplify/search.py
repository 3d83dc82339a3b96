"""The smallest map that still looks like a given one."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from rosplat_lab.bench.embedded import insert_all, pose
from rosplat_lab.metrics import MOST_PSNR
from rosplat_lab.simplify.merging import Pairs, areas, find_pairs, merge
from rosplat_lab.simplify.views import FOCAL, HEIGHT, WIDTH, views, whereabouts
from rosplat_tools.cameras import Camera
from rosplat_tools.splats import Splats
from rviz_gaussian_plugin import offscreen

LEARNT = 24  # views that contributions are found in, of half the size: more gain more than larger
CHECKED = 8  # other views, which maps are held to
SEEDS = (0, 1)  # of these
UNSEEN = 0.03  # part of what it could contribute that a splat counts as that no view sees
CLOSE = 0.01  # part of a map's splats up to which the smallest is looked for

Progress = Callable[[str, float], None]
"""Hears what is being done, and how much of that, 0 to 1."""


@dataclass(frozen=True)
class Quality:
    """How far a map's pictures are from those of the map that it was made from. [dB]"""

    psnr: float
    """Of all views together."""
    worst: float
    """Of the view that differs most."""


@dataclass(frozen=True)
class Step:
    """A map that was tried."""

    splats: int
    quality: Quality


class Judge:
    """Holds maps against pictures of another, from views of its own."""

    def __init__(self, splats: Splats, cameras: list[Camera]) -> None:
        self._cameras = cameras
        self._pictures = [_clipped(picture) for picture in _pictures(splats, cameras)]

    def __call__(self, splats: Splats) -> Quality:
        """PSNR of what a screen shows, over black."""
        errors = [
            float(np.mean(np.square(_clipped(picture) - truth)))
            for picture, truth in zip(_pictures(splats, self._cameras), self._pictures, strict=True)
        ]
        return Quality(_decibels(float(np.mean(errors))), _decibels(max(errors)))


def contributions(splats: Splats, cameras: list[Camera], progress: Progress) -> NDArray[np.float64]:
    """(n,) of how many pixels of the views each splat is the colour.

    And a little for what none of them sees: other views will.
    """
    renderer = _renderer(splats)
    weights = np.zeros(len(splats))
    for number, camera in enumerate(cameras):
        progress("finding what contributes", number / len(cameras))
        weights += renderer.contribute(offscreen.Camera(*pose(camera)))["weight"]
    picture = cameras[0].width * cameras[0].height
    pixel = whereabouts(splats).radius / cameras[0].fx  # [m]
    unhidden = 2 * math.pi * splats.opacities * areas(splats) / pixel**2
    return weights + UNSEEN * np.minimum(unhidden, picture) * len(cameras)


@dataclass
class Simplification:
    """A map on its way to fewer splats, and what was tried."""

    splats: Splats
    progress: Progress = lambda what, part: None
    steps: list[Step] = field(default_factory=list)

    def __post_init__(self) -> None:
        """Looks at the map."""
        self._pixel = whereabouts(self.splats).radius / FOCAL  # [m]
        learnt = views(self.splats, LEARNT, SEEDS[0], WIDTH // 2, HEIGHT // 2)
        self._weights = contributions(self.splats, learnt, self.progress)
        self._whole = self.splats, self._weights
        self.progress("drawing the views to check", 0.0)
        self.judge = Judge(self.splats, views(self.splats, CHECKED, SEEDS[1]))

    def reduce(self, count: int) -> None:
        """To count splats, or a few fewer."""
        for pairs in self._rounds():
            if len(self.splats) <= count:
                return
            self._merge(pairs, min(len(pairs), len(self.splats) - count))

    def shrink(self, bound: float) -> None:
        """To about as few splats as have a PSNR of bound [dB], which may be all of them."""
        self.splats, self._weights = self._whole
        for pairs in self._rounds():
            if self._holds(pairs, len(pairs), bound):
                self._merge(pairs, len(pairs))
                continue
            good, bad = 0, len(pairs)
            while bad - good > max(1, CLOSE * len(self.splats)):
                middle = (good + bad) // 2
                if self._holds(pairs, middle, bound):
                    good = middle
                else:
                    bad = middle
            self._merge(pairs, good)
            return

    def look(self, splats: Splats) -> Step:
        """Notes a map and how good it is."""
        self.progress(f"checking {len(splats):,} splats", 0.0)
        step = Step(len(splats), self.judge(splats))
        self.steps.append(step)
        return step

    def _rounds(self) -> Iterator[Pairs]:
        while True:
            pairs = find_pairs(
                self.splats, self._weights, self._pixel,
                lambda part: self.progress(f"pairing {len(self.splats):,} splats", part),
            )  # fmt: skip
            if not len(pairs):
                return
            yield pairs

    def _holds(self, pairs: Pairs, count: int, bound: float) -> bool:
        fewer, _ = merge(self.splats, self._weights, pairs, count)
        return self.look(fewer).quality.psnr >= bound

    def _merge(self, pairs: Pairs, count: int) -> None:
        self.splats, self._weights = merge(self.splats, self._weights, pairs, count)


def _renderer(splats: Splats) -> offscreen.CpuRenderer:
    renderer = offscreen.CpuRenderer()
    insert_all(renderer, splats)
    return renderer


def _pictures(splats: Splats, cameras: list[Camera]) -> Iterator[NDArray[np.float32]]:
    renderer = _renderer(splats)
    for camera in cameras:
        yield renderer.draw(offscreen.Camera(*pose(camera)))["colour"]


def _clipped(picture: NDArray[np.float32]) -> NDArray[np.float32]:
    """(height, width, 3) of premultiplied RGBA, as a screen shows it."""
    clipped: NDArray[np.float32] = np.clip(picture[..., :3], 0, 1)
    return clipped


def _decibels(error: float) -> float:
    return MOST_PSNR if error <= 0 else min(MOST_PSNR, -10 * math.log10(error))
