// Culls: one thread a row gives depth and slot as one integer that sorts as the order does.

namespace {

constexpr unsigned kPageSlots = SLOTS_PER_PAGE;

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
      : "=r"(c)
      : "f"(a.value), "f"(b.value));
  return c;
}

__device__ bool operator<=(Real a, Real b) {
  int c;
  asm("{.reg .pred p; setp.le.f32 p, %1, %2; selp.s32 %0, 1, 0, p;}"
      : "=r"(c)
      : "f"(a.value), "f"(b.value));
  return c;
}

__device__ Real abs(Real a) { return {__uint_as_float(__float_as_uint(a.value) & 0x7fffffffu)}; }

// Rigid transform of a group's positions into the camera's optical frame.
struct Frame {
  Real rotation[9], translation[3];
};

struct View {
  Real fx, fy, offset_x, offset_y, half_width, half_height, slope_x, slope_y;
  Real near_clip, far_clip;
};

__device__ Real transform(const Frame& frame, int axis, const Real (&p)[3]) {
  const Real* r = frame.rotation + 3 * axis;
  return ((r[0] * p[0] + r[1] * p[1]) + r[2] * p[2]) + frame.translation[axis];
}

// An integer that compares as the depth does.
__device__ unsigned depth_key(Real z) {
  const unsigned bits = __float_as_uint((z + Real{0.0f}).value);  // turns -0 into 0
  return bits ^ ((bits >> 31) ? 0xffffffffu : 0x80000000u);
}

__device__ bool visible(const View& view, bool orthographic, Real x, Real y, Real z, Real extent) {
  const Real w = orthographic ? Real{1.0f} : z;
  return Real{0.0f} <= extent && view.near_clip < z && z < view.far_clip &&
         abs(view.fx * x + view.offset_x * w) <= view.half_width * w + view.slope_x * extent &&
         abs(view.fy * y + view.offset_y * w) <= view.half_height * w + view.slope_y * extent;
}

}  // namespace

// first_slots, groups: of each page. entries: key << 32 | slot of each row, 0 where it isn't seen.
extern "C" __global__ void cull(View view, bool orthographic, const Frame* frames,
                                const Real (*positions)[3], const Real* extents,
                                const unsigned* first_slots, const unsigned* groups, unsigned count,
                                unsigned long long* entries) {
  const unsigned row = blockIdx.x * blockDim.x + threadIdx.x;
  if (row >= count) return;
  const unsigned page = row / kPageSlots;
  const Frame& frame = frames[groups[page]];
  const Real(&p)[3] = positions[row];
  const Real z = transform(frame, 2, p);
  const bool seen =
      visible(view, orthographic, transform(frame, 0, p), transform(frame, 1, p), z, extents[row]);
  const unsigned slot = first_slots[page] + row % kPageSlots;
  entries[row] = seen ? static_cast<unsigned long long>(depth_key(z)) << 32 | slot : 0;
}
