"""Other ways to sort, to hold ours against: shadygm/ROSplat's.

None of them culls. Each is made for positions, float32 (n, 3); making it raises ImportError or
RuntimeError where it can't run. Called with a SortView, it returns the slots, farthest first.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rosplat_core.view import SortView

Positions = NDArray[np.float32]
Sort = Callable[[SortView], Any]


def _opengl(view: SortView) -> tuple[Positions, Positions]:
    """Rotation and translation into a camera that looks along -z: what is farthest has least z."""
    flip = np.array([1, -1, -1], np.float32)
    return flip[:, None] * view.rotations[0], flip * view.translations[0]


def argsort(positions: Positions) -> Sort:
    """Depths by a batch of 3x3 products, then np.argsort: shadygm/ROSplat's CPUSorter."""

    def sort(view: SortView) -> NDArray[np.int32]:
        rotation, translation = _opengl(view)
        seen = rotation[None] @ positions[..., None] + translation[None, :, None]
        return np.argsort(seen[:, 2, 0]).astype(np.int32).reshape(-1, 1)

    return sort


def cupy_uploading(positions: Positions) -> Sort:
    """The same by CuPy, with all positions sent to the GPU each time: shadygm/ROSplat's
    CupySorter, whose renderer always asks for a forced update."""
    import cupy

    cupy.cuda.Device().compute_capability  # noqa: B018  raises where there is none

    def sort(view: SortView) -> NDArray[np.int32]:
        on_device = cupy.asarray(positions)
        rotation, translation = (cupy.asarray(part) for part in _opengl(view))
        seen = rotation[None] @ on_device[..., None] + translation[None, :, None]
        order = cupy.argsort(seen[:, 2, 0]).astype(cupy.int32).reshape(-1, 1)
        result: NDArray[np.int32] = cupy.asnumpy(order)
        return result

    return sort


BASELINES: dict[str, Callable[[Positions], Sort]] = {
    "shadygm/ROSplat, np.argsort": argsort,
    "shadygm/ROSplat, cupy": cupy_uploading,
}
