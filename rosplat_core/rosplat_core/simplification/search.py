"""The smallest map that still looks like a given one.

1. Views of the whole map tell what each splat contributes, and what is lost without it.
2. A search leaves out, or merges, what costs least, a quarter of the splats at a time: whichever of
   the two makes the smaller error with as many, as pictures tell. It checks maps from views that
   nothing was learnt from: so many reach the bound that SHARE of all surely do.
3. The map that it finds is checked from new views. If too many miss the bound, these are learnt
   from, and count more than others. The next search checks maps from more views, none of these.
4. Where a number of splats is the bound, what is left is made as bright as what left.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rosplat_core.cameras import Camera, resized
from rosplat_core.harmonics import C0
from rosplat_core.rendering import MOST_PSNR, posed, psnr_of
from rosplat_core.rendering import Contributions as Sums
from rosplat_core.simplification.judging import (
    LEAST_SHOWN,
    Judge,
    Quality,
    Trial,
    allowed,
    exceeded,
)
from rosplat_core.simplification.merging import (
    MOST,
    Contributions,
    Pairs,
    areas,
    find_pairs,
    in_chunks,
    merge,
)
from rosplat_core.simplification.refitting import MOST_STEPS, picture, refit
from rosplat_core.simplification.views import HEIGHT, WIDTH, Along, Around, Views
from rosplat_core.splats import InputError, Splats

PIXELS = 640 * 360  # of a view for contributions: more views gain more than more pixels
VALUES = 3 * PIXELS
LEARNT = 96  # views for contributions at first
BRIGHTENING = 4  # one of so many of these tells how bright splats have to be that are left
AGAIN = 0.25  # weight of views that missed a bound among all that are learnt from
LEARNT_SEED = 0
FRESH = 64  # new views that a map is checked in
ROUNDS = 3  # in which these are learnt from, at most
FRESH_SEED, REFIT_SEED = 1000, 2  # of these views, and of those that maps are refitted to
FREE = 15.0  # so far above a bound is what is left out without a thought of merging [dB]
UNNOTICED = 60.0  # what is left out is less than 8 bits of a screen round away, 58.9 [dB]
COMPARED = 12  # views that tell whether leaving out or merging makes the smaller error
CONTRAST = 0.09  # mean square difference that an unseen splat is taken to have from its background
LEAST = 1e-30  # lower bound of errors in logarithms
CLOSE = 0.03  # the search for the smallest map ends within this share of what may be merged
NEAR = 0.2  # or within this above the bound [dB]
SPARE = 0.3  # aimed at above a bound: of views much alike, many miss it by tenths [dB]
TELLING = 4  # views beside those that may miss a bound, which tell whether all have to be drawn
COHERENT = 0.9  # first guess of log10 of the error of neighbours together over the sum of theirs

Progress = Callable[[str, float], None]
"""Called with the present task, and how much of it is done, 0 to 1."""


@dataclass(frozen=True)
class Step:
    """A map that a search found, judged in new views; or one that is refitted, in all."""

    splats: int
    quality: Quality


class Learnt:
    """What views tell of splats: sums over views, each as if the map filled its picture.

    So thin things, which fill little of it, count like walls.
    """

    def __init__(self, trial: Trial, places: Views) -> None:
        """Raises InputError where no camera of a path sees a splat, whatever its neighbours see."""
        if places.path and not any(len(_look(trial, camera)[0]) for camera in places.path):
            raise InputError(
                "no camera of the path sees a splat: is it in the scene's coordinates?"
            )
        self._splats, self._places = trial.splats, places
        self._sums = Contributions(*np.zeros((3, len(trial.splats)), np.float32))
        self.drawn = 0
        """How many views were drawn at random."""
        self.missed = 0
        """How many that missed a bound were learnt from as well."""
        self.views = 0.0
        """How many views the sums are of, those that count several times so often."""

    def add(self, trial: Trial, views: int, progress: Callable[[float], None]) -> None:
        """Adds so many new views; trial: the whole map."""
        self.drawn += views
        self._add(trial, self._places.to_learn(self.drawn, LEARNT_SEED)[-views:], 1.0, progress)

    def add_again(
        self, trial: Trial, cameras: Sequence[Camera], progress: Callable[[float], None]
    ) -> None:
        """Adds these views, as a part of AGAIN of all; trial: the whole map."""
        self.missed += len(cameras)
        times = max(1.0, AGAIN * self.views / len(cameras))
        self._add(trial, cameras, times, progress)

    def _add(
        self,
        trial: Trial,
        cameras: Sequence[Camera],
        times: float,
        progress: Callable[[float], None],
    ) -> None:
        for number, camera in enumerate(cameras):
            progress(number / len(cameras))
            seen, found = _look(trial, camera)
            for name in ("weight", "energy", "error"):
                getattr(self._sums, name)[seen] += times * getattr(found, name)
        self.views += times * len(cameras)

    @property
    def contributions(self) -> Contributions:
        """The sums, with a little added for what no view sees: others will."""
        return Contributions.concatenate(in_chunks(len(self._splats), self._with_unseen))

    def _with_unseen(self, part: slice) -> Contributions:
        splats, sums = self._splats[part], self._sums[part]
        pixels = self._places.pixels[part] * math.sqrt(WIDTH * HEIGHT / PIXELS)
        unhidden = np.minimum(2 * math.pi * splats.opacities * areas(splats) / pixels**2, PIXELS)
        unseen = self._places.unseen
        weight = (self.views * unseen * unhidden).astype(np.float32)
        energy = weight * unseen * splats.opacities / 2  # a Gaussian's squares: half its integral
        return Contributions(
            sums.weight + weight, sums.energy + energy, sums.error + CONTRAST * energy
        )

    @property
    def pixel(self) -> float:
        """Size of a pixel at the splats, in views that maps are compared in. [m]"""
        pixels, hidden = self._places.pixels, self._sums.weight == 0
        return float(np.median(pixels if hidden.all() else pixels[~hidden]))


def _look(trial: Trial, camera: Camera) -> tuple[NDArray[np.uint32], Contributions]:
    """The splats (m,) that a view sees, and what they contribute, as if the map filled it."""
    camera = resized(camera, PIXELS)
    seen, found = trial.contributions(camera)
    shown = max(found.weight.sum(dtype=np.float64), LEAST_SHOWN * camera.width * camera.height)
    return seen, found.times(PIXELS / shown)


class Simplification:
    """A map that is made smaller, and the maps that searches found."""

    def __init__(
        self,
        splats: Splats,
        progress: Progress = lambda what, part: None,
        path: Sequence[Camera] | None = None,
        margin: float | None = None,
    ) -> None:
        """Looks at the map along a path, see Along, or without a path as Around does."""
        self.splats = self._whole = splats
        self.steps: list[Step] = []
        self._progress = progress
        self.views: Views = Around(splats) if path is None else Along(splats, path, margin)
        self._trial: Trial | None = Trial(splats)
        self.learnt = Learnt(self._trial, self.views)
        self.learnt.add(self._trial, LEARNT, self._telling_of("finding what contributes to views"))
        self.judge = Judge(
            self._trial, self.views.checked, self._telling_of("drawing the views to check")
        )
        self._contributions = self.learnt.contributions
        # Fit to the tries so far: the error is about a power of the sum of the pairs' costs.
        self._slope, self._offset = 1.0, COHERENT
        self._fresh, self._rounds = FRESH_SEED, 0
        self._errors = np.full(len(self.judge), np.inf)  # of the judge's views, the last time

    def reduce(self, count: int) -> None:
        """Reduces the map to count splats, or a few fewer."""
        if len(self.splats) <= count:
            return
        while len(self.splats) > count:
            chosen = self._alone()
            fewer = min(len(chosen), len(self.splats) - count)
            error = self._compared(chosen, fewer)
            if psnr_of(error) < UNNOTICED:
                pairs = self._pairs()
                if self._compared(pairs, fewer) < error:
                    chosen = pairs
            self._trial = None  # of another map
            self._merge(chosen, fewer)
        self._trial = None  # frees its memory
        self._brighten()

    def _brighten(self) -> None:
        """Makes each splat brighter or darker by the mean of what its pixels lack.

        A step of SIRT (Gilbert 1972) towards the least squares of all colours. One for red, green
        and blue each would gain 0.1 dB more.
        """
        whole, left = Trial(self._whole).renderer, Trial(self.splats).renderer
        cameras = self.views.to_learn(LEARNT, LEARNT_SEED)[::BRIGHTENING]
        sums = Sums()
        for number, camera in enumerate(cameras):
            self._progress("making up for what left", number / len(cameras))
            view = posed(resized(camera, PIXELS))
            lacks = picture(whole, view) - picture(left, view)
            left.contribute(view, sums, lacks.mean(axis=2))
        self.splats.sh[:, 0] += (sums.residual / np.maximum(sums.weight, 1e-6) / C0)[:, None]

    def shrink(self, bound: float) -> None:
        """Reduces the map to about the fewest splats of which SHARE of the views reach bound [dB].

        Checks the map from new views. While too many of these miss the bound, and ROUNDS are left,
        they are learnt from, and the search begins anew, checked from more views.
        """
        self._search(bound + SPARE)
        while self._rounds < ROUNDS and len(self.splats) < len(self._whole):
            self._rounds += 1
            tell = self._telling_of("drawing new views")
            new = Judge(Trial(self._whole), self._new_views(), tell)
            tell = self._telling_of(f"checking {len(self.splats):,} splats in new views")
            errors = new.errors(Trial(self.splats), progress=tell)
            self.steps.append(Step(len(self.splats), Quality.of(errors)))
            missed = np.flatnonzero(errors > 10 ** (-bound / 10))
            if len(missed) <= allowed(len(new)):
                return
            self.look_anew()
            self._trial = trial = Trial(self._whole)
            cameras = [new.cameras[view] for view in missed]
            tell = self._telling_of(f"learning from {len(missed)} views that miss the bound")
            self.learnt.add_again(trial, cameras, tell)
            tell = self._telling_of("finding what contributes to half as many views again")
            self.learnt.add(trial, self.learnt.drawn // 2, tell)
            self._search(bound + SPARE)

    def look_anew(self) -> int:
        """Gives the judge new views, from which nothing was learnt; returns how many."""
        self._trial = None  # frees its memory
        tell = self._telling_of("drawing new views")
        self.judge.add(Trial(self._whole), self._new_views(), tell)
        self._errors = np.append(self._errors, np.full(FRESH, np.inf))
        return FRESH

    def _new_views(self) -> list[Camera]:
        self._fresh += 1
        return self.views.cameras(FRESH, self._fresh)

    def deciding(self, splats: Splats) -> float:
        """What SHARE of the views reach, by those that differed most in the search. [dB]"""
        return psnr_of(self._of_worst(Trial(splats), allowed(len(self.judge)) + TELLING))

    def _search(self, bound: float) -> None:
        """Reduces the map to about the fewest splats that the judge's views allow, maybe all."""
        self.splats, self._contributions = self._whole, self.learnt.contributions
        error = 0.0
        while len(self.splats) > 1:
            pairs, count, error = self._cheapest(bound, error)
            self._trial = None  # frees its memory
            self._merge(pairs, count)
            if count < len(pairs) or psnr_of(error) < bound + NEAR:
                return

    def _cheapest(self, bound: float, before: float) -> tuple[Pairs, int, float]:
        """What to leave out or merge, how many of these, and the error then. before: the error now.

        Leaves out where that makes next to no error, or less than merging as many.
        """
        alone = self._alone()
        error = self._look(alone, len(alone), bound + FREE)
        if psnr_of(error) >= bound + FREE:
            return alone, len(alone), error
        pairs = self._pairs()
        count, error = self._most(pairs, bound, before)
        fewer = min(count, len(alone))
        if self._compared(alone, fewer) <= self._compared(pairs, fewer):
            more, less = self._most(alone, bound, before)
            if more >= count:
                return alone, more, less
        return pairs, count, error

    def _compared(self, pairs: Pairs, count: int) -> float:
        """The error in some of the judge's views with the first count pairs merged."""
        trial = self._trial = self._trial or Trial(self.splats)
        trial.apply(pairs, count)
        views = np.linspace(0, len(self.judge) - 1, COMPARED).astype(np.intp)
        tell = self._telling_of(f"looking at {len(self.splats) - count:,} splats")
        return float(self.judge.errors(trial, views, tell).mean())

    def refine(
        self, seconds: float, bound: float = MOST_PSNR, most_steps: int = MOST_STEPS
    ) -> bool:
        """Refits the map for `seconds` [s], most_steps, or until it has a PSNR of bound [dB].

        Keeps only a map of which SHARE of the checked views reach more, and the worst no less.
        Ctrl-C ends the fit and keeps the best map so far; without one, it is raised.
        Returns whether there was no Ctrl-C.
        """
        self._trial = None  # frees its memory
        first = best = self.judge(self.splats)
        undisturbed = True
        self.steps.append(Step(len(self.splats), first))
        fitted = refit(
            self.splats, Trial(self._whole).renderer,
            self.views.cameras, seconds,
            self._telling_of(f"refitting {len(self.splats):,} splats"), REFIT_SEED, most_steps,
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
        """How many pairs may be merged, and the error then. before: the error now."""
        costs = np.log10(np.cumsum(pairs.costs, dtype=np.float64) / self._values + LEAST)
        aim = math.log10(max(10 ** (-(bound + NEAR / 2) / 10) - before, LEAST))
        good, bad, error = 0, len(pairs) + 1, before
        tries: list[tuple[float, float]] = []
        while bad - good > max(1, CLOSE * bad) or bad > len(pairs) > good:
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
        """The error that decides, see exceeded(), with the first count pairs merged.

        Draws the views that differed most the last time, and all only where these keep the bound.
        """
        trial = self._trial = self._trial or Trial(self.splats)
        trial.apply(pairs, count)
        error = self._of_worst(trial, allowed(len(self.judge)) + TELLING)
        if psnr_of(error) < bound:
            return error
        return self._of_worst(trial, len(self.judge))

    def _of_worst(self, trial: Trial, count: int) -> float:
        """The error that decides, by the count views that differed most the last time."""
        missing = allowed(len(self.judge))
        worst = np.argsort(-self._errors, kind="stable")[: max(count, missing + 1)]
        tell = self._telling_of(f"checking for the bound in {len(worst)} views")
        self._errors[worst] = self.judge.errors(trial, worst, tell)
        return exceeded(self._errors[worst], missing)

    @property
    def _values(self) -> float:
        """Values of the pictures that contributions are sums of."""
        return VALUES * self.learnt.views

    def _alone(self) -> Pairs:
        """The splats to leave out next, those first that are missed least."""
        errors = self._contributions.error
        most = max(1, int(MOST * len(errors)))
        which = np.argpartition(errors, most - 1)[:most]
        which = which[np.argsort(errors[which], kind="stable")]
        return Pairs(
            self.splats, self._contributions, which, which, errors[which], self.learnt.pixel
        )

    def _pairs(self) -> Pairs:
        self._trial = None  # frees its memory
        return find_pairs(
            self.splats, self._contributions, self.learnt.pixel,
            self._telling_of(f"pairing {len(self.splats):,} splats"),
        )  # fmt: skip

    def _merge(self, pairs: Pairs, count: int) -> None:
        self.splats, self._contributions = merge(self.splats, self._contributions, pairs, count)

    def _telling_of(self, what: str) -> Callable[[float], None]:
        return lambda part: self._progress(what, part)
