"""The backends that sort: interchangeable, each a file of its own, with orders equal to the bit.

BACKENDS has them by name. A backend whose file or library is missing is not available, and `choose`
says why.
"""

from __future__ import annotations

import ctypes
import importlib
import importlib.util
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from rosplat_core.view import SortView
from rosplat_sorter.map import Rows, SplatMap

Allocate = Callable[[int], NDArray[np.uint32]]
"""Makes the array, uint32 (m,), that an order of m slots is written to."""


def new_array(count: int) -> NDArray[np.uint32]:
    """A new array for each order."""
    return np.empty(count, np.uint32)


def room_for(rows: int, room: int) -> int:
    """The number of rows to have room for on a device: `room`, as now, if that is about right."""
    return room if rows <= room <= 4 * rows + (1 << 16) else rows + rows // 2


class Backend(Protocol):
    """Orders the splats of one map."""

    name: str
    """As in BACKENDS."""

    device: str
    """The device that it runs on, for the log."""

    def update(self, splats: SplatMap, changed: Rows) -> None:
        """Takes over the rows that changed since the last call, and those that the map grew by.

        A backend on the CPU may keep the map itself: it changes only between calls.
        """

    def close(self) -> None:
        """Gives back the backend's memory, on the device as well. It can't be used afterwards."""

    def order(self, view: SortView, allocate: Allocate = new_array) -> NDArray[np.uint32]:
        """The visible slots back to front, uint32 (m,), exactly as depth.order.

        Once they are counted, they are written to the array that allocate(m) makes, in shared
        memory or for a message.
        """


class Unavailable(Exception):
    """A backend that can't run here; the text says why."""


@dataclass(frozen=True)
class Entry:
    """The module and class of a backend, and whether it is for GPUs."""

    module: str
    factory: str
    gpu: bool = False


AUTO = "auto"

# In the order of preference.
BACKENDS = {
    "cupy": Entry("cupy_backend", "CupyBackend", gpu=True),
    "torch": Entry("torch_backend", "TorchBackend", gpu=True),
    "native": Entry("native_backend", "NativeBackend"),
    "numpy": Entry("numpy_backend", "NumpyBackend"),
}


def open_backend(name: str, threads: int = 0, gpu_only: bool = False) -> Backend:
    """Opens a backend by its name in BACKENDS. Raises Unavailable where it can't run.

    threads: for backends on the CPU, 0 for as many as there are. gpu_only: raises Unavailable where
    it would run on the CPU. Raises ValueError for another name.
    """
    if name not in BACKENDS:
        raise ValueError(f"backend is '{name}', expected one of {', '.join(BACKENDS)}")
    entry = BACKENDS[name]
    try:
        module = importlib.import_module(f"{__name__}.{entry.module}")
        factory: Callable[[int, bool], Backend] = getattr(module, entry.factory)
        return factory(threads, gpu_only)
    except Unavailable:
        raise
    except Exception as error:  # whatever a library's import or a GPU's driver may raise
        raise Unavailable(_one_line(error)) from error


def choose(
    name: str = AUTO, threads: int = 0, without: frozenset[str] = frozenset()
) -> tuple[Backend, dict[str, str]]:
    """Opens a backend by name, or else the best one present; also says why others were not taken.

    without: names of backends that are not to be opened. Raises Unavailable where none is left.
    """
    reasons: dict[str, str] = {}
    if name != AUTO and name not in without:
        try:
            return open_backend(name, threads), reasons
        except Unavailable as error:
            reasons[name] = str(error)
    for candidate, entry in BACKENDS.items():
        if candidate in without or candidate in reasons:
            continue
        try:
            if entry.gpu and not _has_nvidia_driver():  # spares the seconds that an import takes
                installed = importlib.util.find_spec(candidate)
                raise Unavailable("no NVIDIA driver" if installed else "not installed")
            return open_backend(candidate, threads, gpu_only=entry.gpu), reasons
        except Unavailable as error:
            reasons[candidate] = str(error)
    raise Unavailable("; ".join(f"{name}: {reason}" for name, reason in reasons.items()))


def _has_nvidia_driver() -> bool:
    try:
        ctypes.CDLL("libcuda.so.1")
    except OSError:
        return False
    return True


def _one_line(error: Exception) -> str:
    return (str(error).strip() or type(error).__name__).splitlines()[0]
