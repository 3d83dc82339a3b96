"""The smallest map that still looks like a given one."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from rosplat_lab.bench.embedded import insert_all, pose
from rosplat_lab.metrics import MOST_PSNR
from rosplat_lab.simplify.merging import Contributions, Pairs, areas, find_pairs, merge
from rosplat_lab.simplify.views import FOCAL, HEIGHT, WIDTH, views, whereabouts
from rosplat_tools.cameras import Camera
from rosplat_tools.splats import Splats
from rviz_gaussian_plugin import offscreen

LEARNT = 24  # views that contributions are found in, of half the size: more gain more than larger
CHECKED = 8  # other views, which maps are held to
SEEDS = (0, 1)  # of these
UNSEEN = 0.03  # transmittance that each splat counts as seen through beside what views see of it
CONTRAST = 0.09  # mean square by which what no view sees counts as different from what is behind it
LEAST = 1e-30  # error whose logarithm is taken
CLOSE = 0.01  # part of a map's splats up to which the smallest is looked for
NEAR = 0.2  # or above the bound [dB]
COHERENT = 0.7  # logarithm of how many times their sum errors of neighbours are, to begin with

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


def contributions(splats: Splats, cameras: list[Camera], progress: Progress) -> Contributions:
    """What each splat is to the views' pictures.

    And a little for what none of them sees: other views will.
    """
    renderer = _renderer(splats)
    sums = np.zeros((3, len(splats)))
    for number, camera in enumerate(cameras):
        progress("finding what contributes", number / len(cameras))
        found = renderer.contribute(offscreen.Camera(*pose(camera)))
        sums += [found["weight"], found["energy"], found["error"]]
    picture = cameras[0].width * cameras[0].height
    pixel = whereabouts(splats).radius / cameras[0].fx  # [m]
    unhidden = np.minimum(2 * math.pi * splats.opacities * areas(splats) / pixel**2, picture)
    weight = len(cameras) * UNSEEN * unhidden
    energy = weight * UNSEEN * splats.opacities / 2  # a Gaussian's squares have half its integral
    return Contributions(sums[0] + weight, sums[1] + energy, sums[2] + CONTRAST * energy)


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
        self._values = 3 * sum(camera.width * camera.height for camera in learnt)
        self._contributions = contributions(self.splats, learnt, self.progress)
        self._whole = self.splats, self._contributions
        self._first = self._pairs()
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
        self.splats, self._contributions = self._whole
        before = 0.0  # mean square of errors
        for pairs in self._rounds():
            count, before = self._most(pairs, bound, before)
            self._merge(pairs, count)
            if count < len(pairs):
                return

    def look(self, splats: Splats) -> Step:
        """Notes a map and how good it is."""
        self.progress(f"checking {len(splats):,} splats", 0.0)
        step = Step(len(splats), self.judge(splats))
        self.steps.append(step)
        return step

    def _most(self, pairs: Pairs, bound: float, before: float) -> tuple[int, float]:
        """How many pairs may be merged, and the mean square of errors then. before: that of now.

        Errors go about with a power of the sum of the pairs' costs, which each try tells better.
        """
        costs = np.log10(np.cumsum(pairs.costs, dtype=np.float64) / self._values + LEAST)
        aim = math.log10(max(10 ** (-(bound + NEAR / 2) / 10) - before, LEAST))
        good, bad, error = 0, len(pairs) + 1, before
        slope, offset = 1.0, COHERENT
        tries: list[tuple[float, float]] = []
        while bad - good > max(1, CLOSE * len(self.splats)) or bad > len(pairs) > good:
            count = int(np.searchsorted(costs, (aim - offset) / slope))
            count = min(max(count, good + 1), bad - 1)
            fewer, _ = merge(self.splats, self._contributions, pairs, count)
            psnr = self.look(fewer).quality.psnr
            found = 10 ** (-psnr / 10)
            if psnr < bound:
                bad = count
            else:
                good, error = count, found
                if psnr < bound + NEAR:
                    break
            tries.append((float(costs[count - 1]), math.log10(max(found - before, LEAST))))
            if len(tries) > 1 and tries[-1][0] != tries[-2][0]:
                (x, y), (last_x, last_y) = tries[-1], tries[-2]
                slope = min(max((y - last_y) / (x - last_x), 0.3), 3)
            offset = tries[-1][1] - slope * tries[-1][0]
        return good, error

    def _rounds(self) -> Iterator[Pairs]:
        pairs = self._first if self.splats is self._whole[0] else self._pairs()
        while len(pairs):
            yield pairs
            pairs = self._pairs()

    def _pairs(self) -> Pairs:
        return find_pairs(
            self.splats, self._contributions, self._pixel,
            lambda part: self.progress(f"pairing {len(self.splats):,} splats", part),
        )  # fmt: skip

    def _merge(self, pairs: Pairs, count: int) -> None:
        self.splats, self._contributions = merge(self.splats, self._contributions, pairs, count)


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
