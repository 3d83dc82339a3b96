"""CuPy: kernels that cull and sort on the GPU, in cupy_backend.cu."""

from __future__ import annotations

import contextlib
import weakref
from pathlib import Path

import cupy
import cupyx
import numpy as np
from numpy.typing import NDArray

from rosplat_core.slot_pages import SLOTS_PER_PAGE
from rosplat_core.view import SortView
from rosplat_sorter.backends import Allocate, new_array, room_for
from rosplat_sorter.map import Rows, SplatMap
from rosplat_sorter.shared_orders import Memory, memory_of

# Keys are sorted by digits, the lowest first; the last is left out where it is the same in all.
_DIGIT_BITS = 9
_BINS = 1 << _DIGIT_BITS
_DIGITS = -(-32 // _DIGIT_BITS)
_USUAL_DIGITS = 3  # enough where the farthest splat is 65536 * near_clip away

_THREADS = _BINS
_CULL_ITEMS = 8  # for each thread
_SORT_ITEMS = 16
_HEADER = 4 + _DIGITS

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
        self._blocks = (
            properties["multiProcessorCount"] * properties["maxThreadsPerMultiProcessor"]
        ) // _THREADS
        module = cupy.RawModule(
            code=Path(__file__).with_suffix(".cu").read_text(),
            options=(
                "-std=c++17",
                f"-DDIGIT_BITS={_DIGIT_BITS}",
                f"-DUSUAL_DIGITS={_USUAL_DIGITS}",
                f"-DCULL_ITEMS={_CULL_ITEMS}",
                f"-DSORT_ITEMS={_SORT_ITEMS}",
                f"-DSLOTS_PER_PAGE={SLOTS_PER_PAGE}",
            ),
        )
        self._cull = module.get_function("cull")
        self._begin_bins = module.get_function("begin_bins")
        self._sort_digit = module.get_function("sort_digit")
        self._visible = cupyx.empty_pinned(2, np.uint32)  # how many, and the largest key
        self._visible_known = cupy.cuda.Event(disable_timing=True)
        self._pinned: weakref.WeakSet[Memory] = weakref.WeakSet()
        self._pages = cupy.empty((0, 3), cupy.uint32)
        self._reserve(0)

    def _reserve(self, capacity: int) -> None:
        """Makes room for so many rows; those held so far are lost."""
        self._positions = cupy.empty((capacity, 3), cupy.float32)
        self._extents = cupy.empty(capacity, cupy.float32)
        # Source and target of the sort by a digit, in turn.
        self._keys = cupy.empty((2, capacity), cupy.uint32)
        self._slots = cupy.empty((2, capacity), cupy.uint32)
        # All of this is zero before each order.
        sizes = (
            _HEADER,
            _DIGITS * _BINS,
            _blocks_for(capacity, _CULL_ITEMS),
            _DIGITS * _BINS * (1 + _blocks_for(capacity, _SORT_ITEMS)),
        )
        self._state = cupy.empty(sum(sizes), cupy.uint32)
        ends = np.cumsum(sizes).tolist()
        self._header, self._histograms, self._cull_sums, self._sort_sums = (
            self._state[end - size : end] for end, size in zip(ends, sizes, strict=True)
        )
        self._sort_sums = self._sort_sums.reshape(_DIGITS, -1)
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
        self._pages = cupy.asarray(splats.pages)
        self._count = count

    def close(self) -> None:
        self._reserve(0)
        self._pages = cupy.empty((0, 3), cupy.uint32)
        cupy.get_default_memory_pool().free_all_blocks()

    def order(self, view: SortView, allocate: Allocate = new_array) -> NDArray[np.uint32]:
        slots = self._order_on_device(view)
        result = allocate(len(slots))
        self._pin(result)
        slots.get(out=result)
        return result

    def _order_on_device(self, view: SortView) -> cupy.ndarray:
        """The order as a GPU array, uint32 (m,), which the GPU may still be writing.

        The next order is written to the same memory.
        """
        numbers = np.array([getattr(view, name) for name in _NUMBERS], np.float32)
        groups = len(view.translations)
        frames = np.hstack([view.rotations.reshape(groups, 9), view.translations])
        self._state.data.memset_async(0, self._state.nbytes)
        self._cull(
            (min(self._blocks, _blocks_for(self._count, _CULL_ITEMS)),),
            (_THREADS,),
            (
                numbers.view(_VIEW).reshape(()),
                np.bool_(view.orthographic),
                cupy.asarray(frames),
                self._positions,
                self._extents,
                self._pages,
                np.uint32(self._count),
                self._header,
                self._histograms,
                self._cull_sums,
                self._keys,
                self._slots,
            ),
        )
        self._header[:2].get(out=self._visible, blocking=False)
        self._visible_known.record()
        self._begin_bins(
            (_DIGITS,),
            (_THREADS,),
            (self._histograms, self._sort_sums, np.uint32(self._sort_sums.shape[1])),
        )
        for place in range(_USUAL_DIGITS):
            self._sort(place)
        self._visible_known.synchronize()
        count, largest = self._visible.tolist()
        digits = _USUAL_DIGITS
        while largest >> (digits * _DIGIT_BITS):
            self._sort(digits)
            digits += 1
        return self._slots[digits % 2, :count]

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

    def _sort(self, place: int) -> None:
        source, target = place % 2, 1 - place % 2
        self._sort_digit(
            (_blocks_for(self._count, _SORT_ITEMS),),
            (_THREADS,),
            (
                np.uint32(place),
                self._header,
                self._sort_sums[place],
                self._keys[source],
                self._slots[source],
                self._keys[target],
                self._slots[target],
            ),
        )


def _unpin(address: int) -> None:
    with contextlib.suppress(cupy.cuda.runtime.CUDARuntimeError):
        cupy.cuda.runtime.hostUnregister(address)


def _blocks_for(count: int, items: int) -> int:
    """The number of blocks for count splats, with `items` of them for each thread."""
    return max(1, -(-count // (_THREADS * items)))
