"""CuPy: a kernel that culls, in cupy_backend.cu, and CuPy's sort of depth and slot together."""

from __future__ import annotations

import contextlib
import weakref
from pathlib import Path

import cupy
import numpy as np
from numpy.typing import NDArray

from rosplat_core.slot_pages import SLOTS_PER_PAGE
from rosplat_core.view import SortView
from rosplat_sorter.backends import Allocate, new_array, room_for
from rosplat_sorter.map import Rows, SplatMap
from rosplat_sorter.shared_orders import Memory, memory_of

_THREADS = 256  # of a block

_NUMBERS = (
    "fx",
    "fy",
    "offset_x",
    "offset_y",
    "half_width",
    "half_height",
    "slope_x",
    "slope_y",
    "near_clip",
    "far_clip",
)
_VIEW = np.dtype([(name, np.float32) for name in _NUMBERS])


class CupyBackend:
    """Keeps the map on the GPU."""

    name = "cupy"

    def __init__(self, threads: int = 0, gpu_only: bool = False) -> None:
        properties = cupy.cuda.runtime.getDeviceProperties(cupy.cuda.Device().id)
        self.device = properties["name"].decode()
        module = cupy.RawModule(
            code=Path(__file__).with_suffix(".cu").read_text(),
            options=("-std=c++17", f"-DSLOTS_PER_PAGE={SLOTS_PER_PAGE}"),
        )
        self._cull = module.get_function("cull")
        self._pinned: weakref.WeakSet[Memory] = weakref.WeakSet()
        self._first_slots = self._groups = cupy.empty(0, cupy.uint32)
        self._reserve(0)

    def _reserve(self, capacity: int) -> None:
        """Makes room for so many rows; those held so far are lost."""
        self._positions = cupy.empty((capacity, 3), cupy.float32)
        self._extents = cupy.empty(capacity, cupy.float32)
        self._entries = cupy.empty(capacity, cupy.uint64)
        self._count = 0

    def update(self, splats: SplatMap, changed: Rows) -> None:
        count = splats.rows
        room = room_for(count, len(self._extents))
        if room != len(self._extents):
            self._reserve(room)
        for rows in (changed, slice(self._count, count)):  # what changed, what is new
            index = rows if isinstance(rows, slice) else cupy.asarray(rows)
            self._positions[index] = cupy.asarray(splats.positions[rows])
            self._extents[index] = cupy.asarray(splats.extents[rows])
        self._first_slots, self._groups = map(cupy.asarray, splats.by_place())
        self._count = count

    def close(self) -> None:
        self._reserve(0)
        self._first_slots = self._groups = cupy.empty(0, cupy.uint32)
        cupy.get_default_memory_pool().free_all_blocks()

    def order(self, view: SortView, allocate: Allocate = new_array) -> NDArray[np.uint32]:
        numbers = np.array([getattr(view, name) for name in _NUMBERS], np.float32)
        groups = len(view.translations)
        frames = np.hstack([view.rotations.reshape(groups, 9), view.translations])
        if self._count:
            self._cull(
                (-(-self._count // _THREADS),),
                (_THREADS,),
                (
                    numbers.view(_VIEW).reshape(()),
                    np.bool_(view.orthographic),
                    cupy.asarray(frames),
                    self._positions,
                    self._extents,
                    self._first_slots,
                    self._groups,
                    np.uint32(self._count),
                    self._entries,
                ),
            )
        entries = self._entries[: self._count]
        entries = entries[entries != 0]
        entries.sort()
        result = allocate(len(entries))
        self._pin(result)
        entries[::-1].astype(cupy.uint32).get(out=result)  # the lower half of each, the slot
        return result

    def _pin(self, result: NDArray[np.uint32]) -> None:
        """Lets the GPU itself write to a result in shared memory, at three times the speed.

        That memory is pinned until its segment is removed, which is before it is unmapped.
        """
        memory = memory_of(result)
        if memory is None or memory in self._pinned:
            return
        self._pinned.add(memory)  # even if that fails: one try is enough
        whole = np.frombuffer(memory, np.uint8)
        with contextlib.suppress(cupy.cuda.runtime.CUDARuntimeError):  # the copy is just slower
            cupy.cuda.runtime.hostRegister(whole.ctypes.data, whole.nbytes, 0)
            memory.lent.callback(_unpin, whole.ctypes.data)


def _unpin(address: int) -> None:
    with contextlib.suppress(cupy.cuda.runtime.CUDARuntimeError):
        cupy.cuda.runtime.hostUnregister(address)
