"""What needs no graphics: references, models and metrics, in as many processes as there are cores.

Times are taken while these have nothing to do.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from multiprocessing import active_children, get_context
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rosplat_core.cameras import Camera
from rosplat_core.program.files import replacing
from rosplat_core.scenes import load_scene
from rosplat_core.splats import Splats
from rosplat_lab import reference
from rosplat_lab.lab import report
from rosplat_lab.lab.methods import METHODS
from rosplat_lab.metrics import compare
from rosplat_tools.program.processes import ENDINGS

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
        with replacing(self.path) as partial, partial.open("wb") as file:
            np.save(file, picture)


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
    """Processes for tasks: the above. Where the block is left by an exception, they end at once."""

    def __init__(self) -> None:
        self.count = len(os.sched_getaffinity(0))
        # Libraries read this when they are loaded: each process is to use one core.
        os.environ |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        self._pool = ProcessPoolExecutor(self.count, get_context("spawn"))

    def __enter__(self) -> Workers:
        return self

    def run(self, tasks: Iterable[Callable[[], Any]]) -> Iterator[tuple[int, Any]]:
        """The number of each task and what it answers, as they end."""
        with _uninterrupted():  # processes start here
            numbers = {self._pool.submit(task): number for number, task in enumerate(tasks)}
        for future in as_completed(numbers):
            yield numbers[future], future.result()

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        if kind:
            for process in active_children():
                process.terminate()
        self._pool.shutdown(cancel_futures=True)


@contextmanager
def _uninterrupted() -> Iterator[None]:
    """Interrupts after the block. Processes that start in it never hear Ctrl-C: the parent does."""
    late: list[int] = []
    handlers = {
        number: signal.signal(number, lambda number, _: late.append(number)) for number in ENDINGS
    }
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # which processes inherit
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        for number, handler in handlers.items():
            signal.signal(number, handler)
    if late:
        raise KeyboardInterrupt


@lru_cache(maxsize=1)
def _scene(name: str) -> Splats:
    return load_scene(name, lambda done: None, lambda text: None)
