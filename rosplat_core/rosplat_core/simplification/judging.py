"""How far a map's pictures are from those of the map that it was made from.

Only what shows the map counts: a view's mean square error is over the area that the map covers,
which is the sum of its alpha. So a thin thing over black is judged like a wall. A view that shows
next to nothing counts as if it showed LEAST_SHOWN of a picture.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binom

from rosplat_core.cameras import Camera
from rosplat_core.maps import DELETE, UPSERT
from rosplat_core.rendering import Contributions as Sums
from rosplat_core.rendering import CpuRenderer, SplatCamera, edit, insert_all, posed, psnr_of
from rosplat_core.simplification.merging import Contributions, Indices, Pairs
from rosplat_core.splats import Splats

SHARE = 0.95  # of the views, that reach a bound
SURE = 0.9  # confidence of a search that they do
LEAST_SHOWN = 0.01
LEVELS = (
    65535  # of the colours that are compared: finer than a screen's, in half of a float's bytes
)
BATCH = 1 << 19  # splats that are sent to a renderer at a time


@dataclass(frozen=True)
class Quality:
    """How far views of a map are from those of the map that it was made from. [dB]"""

    psnr: float
    """What SHARE of the views reach."""
    mean: float
    """Of all views together."""
    worst: float
    """Of the view that differs most."""

    @classmethod
    def of(cls, errors: NDArray[np.float64]) -> Quality:
        """The quality for the mean square errors (n,) of views."""
        return cls(
            psnr_of(exceeded(errors, int(len(errors) * (1 - SHARE) + 1e-9))),
            psnr_of(float(errors.mean())),
            psnr_of(float(errors.max())),
        )


def allowed(views: int) -> int:
    """How many of so many random views may miss a bound if SURE that SHARE of all reach it.

    One at least, so that no single view decides.
    """
    return max(1, int(binom.ppf(1 - SURE, views, 1 - SHARE)) - 1)


def exceeded(errors: NDArray[np.float64], most: int) -> float:
    """The least error that no more than so many of the errors exceed."""
    return float(np.sort(errors)[::-1][most])


class Judge:
    """Compares maps with pictures of the original, from cameras of its own."""

    def __init__(
        self,
        trial: Trial,
        cameras: Sequence[Camera] = (),
        progress: Callable[[float], None] = lambda part: None,
    ) -> None:
        self.cameras: list[Camera] = []
        self._pictures: list[NDArray[np.uint16]] = []
        self._areas: list[float] = []
        self.add(trial, cameras, progress)

    def __len__(self) -> int:
        return len(self.cameras)

    def add(
        self,
        trial: Trial,
        cameras: Sequence[Camera],
        progress: Callable[[float], None] = lambda part: None,
    ) -> None:
        """Adds views; trial: the original."""
        for number, camera in enumerate(cameras):
            progress(number / len(cameras))
            picture, area = _picture(trial.renderer, posed(camera))
            self.cameras.append(camera)
            self._pictures.append(picture)
            self._areas.append(max(area, LEAST_SHOWN * camera.width * camera.height))

    def __call__(self, splats: Splats) -> Quality:
        """Quality of the pictures that a screen shows, over black."""
        return Quality.of(self.errors(Trial(splats)))

    def worst(self, splats: Splats) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Pictures of the view that differs most, (height, width, 3), 0 to 1: original, and map."""
        trial = Trial(splats)
        view = int(self.errors(trial).argmax())
        picture, _ = _picture(trial.renderer, posed(self.cameras[view]))
        one: NDArray[np.float32] = np.divide(self._pictures[view], LEVELS, dtype=np.float32)
        other: NDArray[np.float32] = np.divide(picture, LEVELS, dtype=np.float32)
        return one, other

    def errors(
        self,
        trial: Trial,
        which: Iterable[int] | None = None,
        progress: Callable[[float], None] = lambda part: None,
    ) -> NDArray[np.float64]:
        """Mean square errors of the pictures from some of the views, by default all."""
        views = [*(range(len(self)) if which is None else which)]
        errors = []
        for number, i in enumerate(views):
            progress(number / len(views))
            picture, _ = _picture(trial.renderer, posed(self.cameras[i]))
            differs = (picture.astype(np.float32) - self._pictures[i]).ravel()
            errors.append(float(differs @ differs) / (3 * LEVELS**2 * self._areas[i]))
        return np.array(errors)


def _picture(renderer: CpuRenderer, camera: SplatCamera) -> tuple[NDArray[np.uint16], float]:
    """What a screen shows of a map over black (height, width, 3), and the area it covers [px]."""
    colour = renderer.draw(camera)["colour"]
    shown = np.clip(colour[..., :3], 0, 1)
    shown *= LEVELS
    shown += 0.5
    return shown.astype(np.uint16), float(colour[..., 3].sum())


class Trial:
    """A map in a renderer, with more or fewer of some pairs merged. Only changes are sent."""

    def __init__(self, splats: Splats) -> None:
        self.splats = splats
        self.renderer = CpuRenderer()
        self._sums = Sums()
        self._revision = insert_all(self.renderer, splats)
        self._pairs: Pairs | None = None
        self._count = 0

    def contributions(self, camera: Camera) -> tuple[NDArray[np.uint32], Contributions]:
        """The splats (m,) that a view sees, and what they contribute to it."""
        self.renderer.contribute(posed(camera), self._sums)
        seen, weight, energy, error = self._sums.take_seen()
        return seen, Contributions(weight, energy, error)

    def apply(self, pairs: Pairs, count: int) -> None:
        """Merges the first count of the map's pairs, and no other."""
        if self._pairs is not None and self._pairs is not pairs:
            self._apart(self._pairs, slice(0, self._count))
            self._count = 0
        before, self._pairs, self._count = self._count, pairs, count
        if count > before:
            first, merged, _ = pairs.merged(before, count)
            self._edit(UPSERT, first, merged)
            self._edit(DELETE, pairs.second[before:count], self.splats[:0])
        else:
            self._apart(pairs, slice(count, before))

    def _apart(self, pairs: Pairs, part: slice) -> None:
        slots = np.unique(np.concatenate([pairs.first[part], pairs.second[part]]))
        self._edit(UPSERT, slots, self.splats[slots])

    def _edit(self, operation: int, slots: Indices, splats: Splats) -> None:
        for start in range(0, len(slots), BATCH):
            part = slice(start, start + BATCH)
            self._revision += 1
            edit(self.renderer, operation, slots[part], splats[part], self._revision)
