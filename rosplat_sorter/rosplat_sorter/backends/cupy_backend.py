"""CuPy: one kernel that culls and packs, then a radix sort on the GPU."""

from __future__ import annotations

import cupy
import numpy as np
from numpy.typing import NDArray

from rosplat_sorter.backends import Allocate, new_array
from rosplat_sorter.edits import Slots
from rosplat_sorter.map import SplatMap
from rosplat_sorter.view import View

_THREADS = 256

# Visible splats are appended in any order: key << 32 | slot is unique, so sorting makes it exact.
_KERNEL = r"""
// IEEE float32: never fused, and with subnormal numbers, which CuPy's -ftz=true takes for zero.
struct Real {
  float value;
};

__device__ Real operator+(Real a, Real b) {
  Real c;
  asm("add.rn.f32 %0, %1, %2;" : "=f"(c.value) : "f"(a.value), "f"(b.value));
  return c;
}

__device__ Real operator*(Real a, Real b) {
  Real c;
  asm("mul.rn.f32 %0, %1, %2;" : "=f"(c.value) : "f"(a.value), "f"(b.value));
  return c;
}

__device__ bool operator<(Real a, Real b) {
  int c;
  asm("{.reg .pred p; setp.lt.f32 p, %1, %2; selp.s32 %0, 1, 0, p;}"
      : "=r"(c) : "f"(a.value), "f"(b.value));
  return c;
}

__device__ bool operator<=(Real a, Real b) {
  int c;
  asm("{.reg .pred p; setp.le.f32 p, %1, %2; selp.s32 %0, 1, 0, p;}"
      : "=r"(c) : "f"(a.value), "f"(b.value));
  return c;
}

__device__ Real abs(Real a) {
  return {__uint_as_float(__float_as_uint(a.value) & 0x7fffffffu)};
}

struct View {
  Real rotation[9], translation[3];
  Real fx, fy, offset_x, offset_y, half_width, half_height, slope_x, slope_y;
  Real near_clip, far_clip;
};

__device__ Real transform(const View& view, int axis, const Real* p) {
  const Real* r = view.rotation + 3 * axis;
  return ((r[0] * p[0] + r[1] * p[1]) + r[2] * p[2]) + view.translation[axis];
}

extern "C" __global__ void cull(const View view, const bool orthographic, const Real* positions,
                                const Real* extents, const unsigned count,
                                unsigned long long* entries, unsigned* total) {
  const unsigned slot = blockIdx.x * blockDim.x + threadIdx.x;
  const Real zero = {0.0f}, one = {1.0f};
  bool visible = false;
  Real z = zero;
  if (slot < count) {
    const Real* p = positions + 3ull * slot;
    const Real extent = extents[slot];
    const Real x = transform(view, 0, p), y = transform(view, 1, p);
    z = transform(view, 2, p);
    const Real w = orthographic ? one : z;
    visible = zero <= extent && view.near_clip < z && z < view.far_clip &&
              abs(view.fx * x + view.offset_x * w) <= view.half_width * w + view.slope_x * extent &&
              abs(view.fy * y + view.offset_y * w) <= view.half_height * w + view.slope_y * extent;
  }
  // One atomic addition a block.
  __shared__ unsigned block_total, block_first;
  if (threadIdx.x == 0) block_total = 0;
  __syncthreads();
  const unsigned place = visible ? atomicAdd(&block_total, 1u) : 0;
  __syncthreads();
  if (threadIdx.x == 0) block_first = atomicAdd(total, block_total);
  __syncthreads();
  if (visible) {
    const unsigned bits = __float_as_uint((z + zero).value);  // the sum makes one depth of -0 and 0
    const unsigned key = bits ^ ((bits >> 31) ? 0xffffffffu : 0x80000000u);
    entries[block_first + place] = (unsigned long long)key << 32 | slot;
  }
}
"""

_VIEW = np.dtype(
    [
        ("rotation", np.float32, (9,)),
        ("translation", np.float32, (3,)),
        *(
            (name, np.float32)
            for name in (
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
        ),
    ]
)


class CupyBackend:
    """Keeps the map on the GPU."""

    name = "cupy"

    def __init__(self, threads: int = 0, gpu_only: bool = False) -> None:
        properties = cupy.cuda.runtime.getDeviceProperties(cupy.cuda.Device().id)
        self.device = properties["name"].decode()
        self._cull = cupy.RawKernel(_KERNEL, "cull")
        self._cull.compile()
        self._positions = cupy.empty((0, 3), cupy.float32)
        self._extents = cupy.empty(0, cupy.float32)
        self._entries = cupy.empty(0, cupy.uint64)
        self._count = 0

    def update(self, splats: SplatMap, changed: Slots) -> None:
        if len(splats) > len(self._extents):
            capacity = len(splats) + len(splats) // 2
            self._positions = cupy.empty((capacity, 3), cupy.float32)
            self._extents = cupy.empty(capacity, cupy.float32)
            self._entries = cupy.empty(capacity, cupy.uint64)
            self._count = 0
        for slots in (changed, slice(self._count, len(splats))):  # what changed, what is new
            index = slots if isinstance(slots, slice) else cupy.asarray(slots)
            self._positions[index] = cupy.asarray(splats.positions[slots])
            self._extents[index] = cupy.asarray(splats.extents[slots])
        self._count = len(splats)

    def order(self, view: View, allocate: Allocate = new_array) -> NDArray[np.uint32]:
        slots = self.order_on_device(view)
        result = allocate(len(slots))
        slots.get(out=result)
        return result

    def order_on_device(self, view: View) -> cupy.ndarray:
        """The order as a GPU array, uint32 (m,), which may still be in the making."""
        parameters = np.zeros((), _VIEW)
        for name in _VIEW.names or ():
            parameters[name] = np.ravel(getattr(view, name)).squeeze()
        total = cupy.zeros(1, cupy.uint32)
        self._cull(
            (max(1, -(-self._count // _THREADS)),),
            (_THREADS,),
            (
                parameters,
                np.bool_(view.orthographic),
                self._positions,
                self._extents,
                np.uint32(self._count),
                self._entries,
                total,
            ),
        )
        entries = self._entries[: int(total[0])]
        entries.sort()
        return entries[::-1].astype(cupy.uint32)
