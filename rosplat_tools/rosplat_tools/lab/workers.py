"""What needs no graphics: references, models and metrics, in as many processes as there are cores.

Times are taken while these have nothing to do.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from functools import lru_cache
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rosplat_tools import reference
from rosplat_tools.cameras import Camera
from rosplat_tools.lab import report
from rosplat_tools.lab.methods import METHODS
from rosplat_tools.metrics import compare
from rosplat_tools.scenes import load_scene
from rosplat_tools.splats import Splats

Image = NDArray[Any]


@dataclass(frozen=True)
class Reference:
    """Draws the truth, (height, width, 3) RGB over black, into a file."""

    scene: str
    camera: Camera
    path: Path

    def __call__(self) -> None:
        picture = reference.render(_scene(self.scene), self.camera).rgba[..., :3]
        self.path.parent.mkdir(exist_ok=True)
        unfinished = self.path.with_suffix(".part.npy")
        np.save(unfinished, picture)
        unfinished.rename(self.path)


@dataclass(frozen=True)
class Comparison:
    """Holds a picture against the truth; answers what `metrics.compare` does."""

    scene: str
    camera: Camera
    method: str
    truth: Path
    picture: Image | None
    """(height, width, 3) RGB over black; None where the method's model is to draw it."""
    strip: Path | None
    """Where small pictures for the report go."""

    def __call__(self) -> dict[str, float]:
        expected = np.load(self.truth)
        picture = self.picture
        if picture is None:
            model = next(method.model for method in METHODS if method.name == self.method)
            assert model
            picture = model(_scene(self.scene), self.camera)
        if self.strip:
            report.save_strip(self.strip, picture, expected)
        return compare(picture, expected)


class Workers:
    """Processes for tasks: the above."""

    def __init__(self) -> None:
        self.count = len(os.sched_getaffinity(0))
        # Libraries read this when they are loaded: each process is to use one core.
        os.environ |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        self._pool = ProcessPoolExecutor(self.count, get_context("spawn"), _leave_interrupts)

    def run(self, tasks: Iterable[Callable[[], Any]]) -> Iterator[tuple[int, Any]]:
        """The number of each task and what it answers, as they end."""
        numbers = {self._pool.submit(task): number for number, task in enumerate(tasks)}
        for future in as_completed(numbers):
            yield numbers[future], future.result()

    def close(self) -> None:
        """Ends what runs, and forgets what waits."""
        self._pool.shutdown(cancel_futures=True)


@lru_cache(maxsize=1)
def _scene(name: str) -> Splats:
    return load_scene(name, lambda done: None, lambda text: None)


def _leave_interrupts() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent decides
