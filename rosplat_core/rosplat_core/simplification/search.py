"""The smallest map that still looks like a given one."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rosplat_core.cameras import Camera
from rosplat_core.maps import DELETE, UPSERT
from rosplat_core.rendering import (
    MOST_PSNR,
    CpuRenderer,
    edit,
    insert_all,
    posed,
    psnr_of,
)
from rosplat_core.rendering import (
    Contributions as Sums,
)
from rosplat_core.simplification.merging import (
    Contributions,
    Indices,
    Pairs,
    areas,
    find_pairs,
    merge,
)
from rosplat_core.simplification.refitting import MOST_STEPS, picture, refit
from rosplat_core.simplification.views import HEIGHT, WIDTH, Along, Around, Views, resized
from rosplat_core.splats import SceneError, Splats

PIXELS = WIDTH * HEIGHT // 4  # of a view for contributions: more views gain more than more pixels
VALUES = 3 * PIXELS
LEARNT, MOST_LEARNT = 24, 768  # views for contributions, at first and at most
LEARNT_SEED = 0
REFIT_SEED = 2  # of the views that maps are refitted to
LEFT_OUT = 60.0  # PSNR down to which leaving out beats merging, where only a path matters [dB]
BATCH = 1 << 19  # splats that are sent to a renderer at a time
UNSEEN = 0.03  # transmittance at which each splat counts as seen beside what views see of it
CONTRAST = 0.09  # mean square difference that an unseen splat is taken to have from its background
LEAST = 1e-30  # lower bound of errors in logarithms
CLOSE = 0.01  # the search for the smallest map ends within this share of its splats
NEAR = 0.2  # or within this above the bound [dB]
ALIKE = 3.0  # maps whose PSNR is this close differ most in the same views [dB]
TELLING = 3  # views that stand for all, once all were drawn
COHERENT = 0.9  # first guess of log10 of the error of neighbours together over the sum of theirs

Progress = Callable[[str, float], None]
"""Called with the present task, and how much of it is done, 0 to 1."""


@dataclass(frozen=True)
class Quality:
    """How far a map's pictures are from those of the map that it was made from. [dB]"""

    psnr: float
    """Of all views together."""
    worst: float
    """Of the view that differs most."""

    @classmethod
    def of(cls, errors: NDArray[np.float64]) -> Quality:
        """The quality for the mean square errors (n,) of views."""
        return cls(psnr_of(float(errors.mean())), psnr_of(float(errors.max())))


@dataclass(frozen=True)
class Step:
    """A map that was tried."""

    splats: int
    quality: Quality


class Judge:
    """Compares maps with pictures of the original, from cameras of its own."""

    def __init__(self, trial: Trial, cameras: list[Camera]) -> None:
        self._poses = [posed(camera) for camera in cameras]
        self._pictures = [picture(trial.renderer, camera) for camera in self._poses]

    def __call__(self, splats: Splats) -> Quality:
        """Quality of the pictures that a screen shows, over black."""
        return Quality.of(self.errors(Trial(splats)))

    def errors(self, trial: Trial, which: Indices | None = None) -> NDArray[np.float64]:
        """Mean square errors of the pictures from some of the views, by default all."""
        views = range(len(self._poses)) if which is None else which
        return np.array(
            [
                np.mean(np.square(picture(trial.renderer, self._poses[i]) - self._pictures[i]))
                for i in views
            ]
        )


class Trial:
    """A map in a renderer, with more or fewer of its pairs merged. Only changes are sent."""

    def __init__(self, splats: Splats) -> None:
        self.splats = splats
        self.renderer = CpuRenderer()
        self._revision = insert_all(self.renderer, splats)
        self._count = 0

    def merge(self, pairs: Pairs, count: int) -> None:
        """Merges the first count of the map's pairs, and no other."""
        before, self._count = self._count, count
        if count > before:
            first, merged, _ = pairs.merged(before, count)
            self._edit(UPSERT, first, merged)
            self._edit(DELETE, pairs.second[before:count], self.splats[:0])
        else:
            apart = slice(count, before)
            slots = np.unique(np.concatenate([pairs.first[apart], pairs.second[apart]]))
            self._edit(UPSERT, slots, self.splats[slots])

    def _edit(self, operation: int, slots: Indices, splats: Splats) -> None:
        for start in range(0, len(slots), BATCH):
            part = slice(start, start + BATCH)
            self._revision += 1
            edit(self.renderer, operation, slots[part], splats[part], self._revision)


@dataclass(frozen=True)
class Learnt:
    """What views tell of splats."""

    contributions: Contributions
    alone: Indices
    """Splats by what is lost without them, the least first; empty where there is no path."""
    pixel: float
    """Size of a pixel at the splats, in views that maps are compared in. [m]"""
    views: int


def learn(trial: Trial, places: Views, progress: Progress) -> Learnt:
    """Finds contributions in as many views as it takes: doubles them as long as that tells more.

    The measure is what held-back views lose without the half of the splats that contributes least.
    Raises SceneError where no camera of a path sees a splat, whatever its neighbours see.
    """
    if places.path and not any(_sees(trial, camera) for camera in places.path):
        raise SceneError("no camera of the path sees a splat: is it in the scene's coordinates?")
    held = []
    for number, camera in enumerate(places.held):
        progress("looking from the views to check", number / len(places.held))
        seen = _look(trial, camera, Sums())
        slots = np.flatnonzero(seen).astype(np.uint32)
        held.append((slots, seen[slots]))
    sums, views, before = Sums(), 0, 0.0
    learnt: Learnt | None = None
    while True:
        more = max(LEARNT, views)
        for number, camera in enumerate(places.cameras(views + more, LEARNT_SEED)[views:]):
            progress(f"finding what contributes in {views + more} views", number / more)
            errors = _look(trial, camera, sums)
        least = errors <= np.median(errors)
        worst = psnr_of(max(float(lost[least[slots]].sum()) for slots, lost in held) / VALUES)
        if learnt and worst < before + places.still:
            return learnt
        views, before = views + more, worst
        learnt = _learnt(trial.splats, places, sums, views)
        if views >= MOST_LEARNT:
            return learnt


def _sees(trial: Trial, camera: Camera) -> bool:
    sums = Sums()
    _look(trial, camera, sums)
    return bool(sums.weight.any())


def _look(trial: Trial, camera: Camera, sums: Sums) -> NDArray[np.float32]:
    """Adds a view to sums; returns (n,) squares by which pictures change without each splat."""
    trial.renderer.contribute(posed(resized(camera, PIXELS)), sums)
    return sums.error[: len(trial.splats)]


def _learnt(splats: Splats, places: Views, sums: Sums, views: int) -> Learnt:
    """The result of `views` views, with a little added for what no view sees: others will."""
    found = [array[: len(splats)] for array in (sums.weight, sums.energy, sums.error)]
    hidden = found[0] == 0
    pixels = places.pixels * math.sqrt(WIDTH * HEIGHT / PIXELS)
    unhidden = np.minimum(2 * math.pi * splats.opacities * areas(splats) / pixels**2, PIXELS)
    weight = views * UNSEEN * unhidden
    if places.complete:
        weight *= hidden  # more for splats seen now and then would displace those that matter
    energy = weight * UNSEEN * splats.opacities / 2  # a Gaussian's squares have half its integral
    missed = (weight, energy, CONTRAST * energy)
    contributions = Contributions(*(one + more for one, more in zip(found, missed, strict=True)))
    alone = np.argsort(contributions.error, kind="stable")[:-1]
    pixel = float(np.median(places.pixels if hidden.all() else places.pixels[~hidden]))
    return Learnt(contributions, alone if places.complete else alone[:0], pixel, views)


class Simplification:
    """A map that is made smaller, and the maps that were tried."""

    def __init__(
        self,
        splats: Splats,
        progress: Progress = lambda what, part: None,
        path: Sequence[Camera] | None = None,
        margin: float | None = None,
    ) -> None:
        """Looks at the map along a path, see Along, or without a path from all around."""
        self.splats = splats
        self.steps: list[Step] = []
        self._progress = progress
        self.views: Views = Around(splats) if path is None else Along(splats, path, margin)
        self._trial: Trial | None = Trial(splats)
        self.learnt = learn(self._trial, self.views, progress)
        self._contributions = self.learnt.contributions
        self._values = self.learnt.views * VALUES
        self._whole = splats, self._contributions
        progress("drawing the views to check", 0.0)
        self.judge = Judge(self._trial, self.views.held)
        # Fit to the tries so far: the error is about a power of the sum of the pairs' costs.
        self._slope, self._offset = 1.0, COHERENT
        self._telling, self._others = np.arange(len(self.views.held)), 1.0
        self._first = self._spare() if self.views.complete else self._pairs()

    def reduce(self, count: int) -> None:
        """Reduces the map to count splats, or a few fewer."""
        self._trial = None  # frees its memory
        for pairs in self._rounds():
            if len(self.splats) <= count:
                return
            self._merge(pairs, min(len(pairs), len(self.splats) - count))

    def shrink(self, bound: float) -> None:
        """Reduces the map to about the fewest splats with a PSNR of bound [dB], maybe all."""
        self.splats, self._contributions = self._whole
        before = 0.0  # mean square of errors
        for pairs in self._rounds():
            count, before = self._most(pairs, bound, before)
            self._trial = None  # frees its memory
            self._merge(pairs, count)
            if count < len(pairs) or psnr_of(before) < bound + NEAR:
                return

    def refine(
        self, seconds: float, bound: float = MOST_PSNR, most_steps: int = MOST_STEPS
    ) -> bool:
        """Refits the map for `seconds` [s], most_steps, or until it has a PSNR of bound [dB].

        Keeps only a map that is better in the held-back views together, and no worse in the worst
        of them. Ctrl-C ends the fit and keeps the best map so far; without one, it is raised.
        Returns whether there was no Ctrl-C.
        """
        self._trial = None  # frees its memory
        whole = self._whole[0]
        first = best = self.judge(self.splats)
        undisturbed = True
        self.steps.append(Step(len(self.splats), first))
        fitted = refit(
            self.splats, Trial(whole).renderer,
            self.views.cameras, seconds,
            lambda part: self._progress(f"refitting {len(self.splats):,} splats", part), REFIT_SEED,
            most_steps,
        )  # fmt: skip
        try:
            for splats in fitted:
                quality = self.judge(splats)
                if quality.psnr > best.psnr and quality.worst >= first.worst:
                    self.splats, best = splats, quality
                if best.psnr >= bound:
                    break
        except KeyboardInterrupt:
            if best is first:
                raise
            undisturbed = False
        self.steps.append(Step(len(self.splats), best))
        return undisturbed

    def _most(self, pairs: Pairs, bound: float, before: float) -> tuple[int, float]:
        """How many pairs may be merged, and the mean square error then. before: the error now."""
        costs = np.log10(np.cumsum(pairs.costs, dtype=np.float64) / self._values + LEAST)
        aim = math.log10(max(10 ** (-(bound + NEAR / 2) / 10) - before, LEAST))
        good, bad, error = 0, len(pairs) + 1, before
        tries: list[tuple[float, float]] = []
        while bad - good > max(1, CLOSE * len(self.splats)) or bad > len(pairs) > good:
            count = int(np.searchsorted(costs, (aim - self._offset) / self._slope))
            count = min(max(count, good + 1), bad - 1)
            found = self._look(pairs, count, bound)
            psnr = psnr_of(found)
            if psnr < bound:
                bad = count
            else:
                good, error = count, found
                if psnr < bound + NEAR:
                    break
            tries.append((float(costs[count - 1]), math.log10(max(found - before, LEAST))))
            if len(tries) > 1 and tries[-1][0] != tries[-2][0]:
                (x, y), (last_x, last_y) = tries[-1], tries[-2]
                self._slope = min(max((y - last_y) / (x - last_x), 0.3), 3)
            self._offset = tries[-1][1] - self._slope * tries[-1][0]
        return good, error

    def _look(self, pairs: Pairs, count: int, bound: float) -> float:
        """Mean square error with the first count pairs merged.

        Once a map of about that PSNR was drawn from all views, first draws those that differed
        most: maps that fail there are told from three views, but none passes unseen by the others.
        """
        left = len(self.splats) - count
        self._progress(f"checking {left:,} splats", 0.0)
        trial = self._trial = self._trial or Trial(self.splats)
        trial.merge(pairs, count)
        if self.steps and abs(self.steps[-1].quality.psnr - bound) < ALIKE:
            estimate = self._others * float(self.judge.errors(trial, self._telling).mean())
            if psnr_of(estimate) < bound:
                return estimate
        errors = self.judge.errors(trial)
        self.steps.append(Step(left, Quality.of(errors)))
        self._telling = np.argsort(-errors)[:TELLING]
        error = float(errors.mean())
        self._others = error / max(float(errors[self._telling].mean()), LEAST)
        return error

    def _rounds(self) -> Iterator[Pairs]:
        pairs = (self._first if self.splats is self._whole[0] else None) or self._pairs()
        while len(pairs):
            yield pairs
            pairs = self._pairs()

    def _spare(self) -> Pairs:
        """The splats to leave out before any merge: as many as keep a PSNR of LEFT_OUT."""

        def first(count: int) -> Pairs:
            which = self.learnt.alone[:count]
            costs = self._contributions.error[which]
            return Pairs(self.splats, self._contributions, which, which, costs, self.learnt.pixel)

        return first(self._most(first(len(self.splats)), LEFT_OUT, 0.0)[0])

    def _pairs(self) -> Pairs:
        return find_pairs(
            self.splats, self._contributions, self.learnt.pixel,
            lambda part: self._progress(f"pairing {len(self.splats):,} splats", part),
        )  # fmt: skip

    def _merge(self, pairs: Pairs, count: int) -> None:
        self.splats, self._contributions = merge(self.splats, self._contributions, pairs, count)
