// Culls and sorts by depth. Cull: one pass that writes the visible splats, the highest slot first,
// and counts their keys' digits. Sort: "Onesweep", Adinets and Merrill 2022, a pass for each digit.
// Both hand running sums from tile to tile by decoupled look-back, Merrill and Garland 2016.

namespace {

constexpr unsigned kDigitBits = DIGIT_BITS, kBins = 1 << kDigitBits;
constexpr unsigned kDigits = (32 + kDigitBits - 1) / kDigitBits;
constexpr unsigned kUsualDigits = USUAL_DIGITS;  // sorted by before it is known whether more count
constexpr unsigned kThreads = kBins;             // one for each bin
constexpr unsigned kLanes = 32, kWarps = kThreads / kLanes, kAll = 0xffffffffu;
constexpr unsigned kCullItems = CULL_ITEMS, kCullTile = kCullItems * kThreads;
constexpr unsigned kPageSlots = SLOTS_PER_PAGE;
constexpr unsigned kSortItems = SORT_ITEMS, kSortTile = kSortItems * kThreads;

// Flags of what a tile tells later ones: its own sum, or the sum up to its end. 0: nothing yet.
constexpr unsigned kOwn = 1u << 30, kInclusive = 2u << 30, kSum = kOwn - 1;

// Zero before each order.
struct Header {
  unsigned count;                  // of visible splats
  unsigned largest;                // of their depth keys
  unsigned tickets;                // tiles taken by cull ...
  unsigned sort_tickets[kDigits];  // ... and by sort_digit, for each digit
};

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

// A page of neighbouring slots, the place of its rows, and its group's index in frames.
struct Page {
  unsigned first_slot, place, group;
};

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

// How far a splat's key is above that of the near plane; 0 where it is not visible.
__device__ unsigned visible_key(const View& view, bool orthographic, const Frame& frame,
                                const Real (&p)[3], Real extent) {
  const Real x = transform(frame, 0, p), y = transform(frame, 1, p), z = transform(frame, 2, p);
  const Real w = orthographic ? Real{1.0f} : z;
  const bool visible =
      Real{0.0f} <= extent && view.near_clip < z && z < view.far_clip &&
      abs(view.fx * x + view.offset_x * w) <= view.half_width * w + view.slope_x * extent &&
      abs(view.fy * y + view.offset_y * w) <= view.half_height * w + view.slope_y * extent;
  return visible ? depth_key(z) - depth_key(view.near_clip) : 0;
}

__device__ unsigned digit_of(unsigned key, unsigned place) {
  return (key >> (place * kDigitBits)) & (kBins - 1);
}

__device__ unsigned lane_id() { return threadIdx.x % kLanes; }

__device__ unsigned warp_id() { return threadIdx.x / kLanes; }

__device__ unsigned lanes_below() { return (1u << lane_id()) - 1; }

// Sum of the values of the warp's lanes up to this one.
__device__ unsigned inclusive_scan(unsigned value) {
#pragma unroll
  for (unsigned distance = 1; distance < kLanes; distance *= 2) {
    const unsigned below = __shfl_up_sync(kAll, value, distance);
    if (lane_id() >= distance) value += below;
  }
  return value;
}

__device__ unsigned sum_before(const unsigned (&warp_totals)[kWarps]) {
  unsigned sum = 0;
  for (unsigned warp = 0; warp < warp_id(); ++warp) sum += warp_totals[warp];
  return sum;
}

// Sum of the values of the block's threads before this one.
__device__ unsigned block_scan(unsigned value) {
  __shared__ unsigned warp_totals[kWarps];
  const unsigned inclusive = inclusive_scan(value);
  if (lane_id() == kLanes - 1) warp_totals[warp_id()] = inclusive;
  __syncthreads();
  return sum_before(warp_totals) + inclusive - value;
}

// Tiles are handed out in turn, so that the earlier tiles that are looked back on are all at work.
__device__ unsigned take_tile(unsigned* tickets) {
  __shared__ unsigned tile;
  if (threadIdx.x == 0) tile = atomicAdd(tickets, 1u);
  __syncthreads();
  return tile;
}

// Sum over all tiles before this one. Called by a whole warp; sums: one for each tile.
__device__ unsigned warp_look_back(volatile const unsigned* sums, unsigned tile) {
  unsigned before = 0;
  for (int last = static_cast<int>(tile) - 1;; last -= kLanes) {
    const int other = last - static_cast<int>(lane_id());
    unsigned seen;
    do {
      seen = other < 0 ? kInclusive : sums[other];
    } while (__any_sync(kAll, seen == 0));
    const unsigned inclusive = __ballot_sync(kAll, (seen & kInclusive) != 0);
    const unsigned used = inclusive ? __ffs(inclusive) : kLanes;
    before += __shfl_sync(kAll, inclusive_scan(lane_id() < used ? seen & kSum : 0), kLanes - 1);
    if (inclusive) return before;
  }
}

// The same for each bin, by one thread each; row 0 of the sums is the sum before all tiles.
__device__ unsigned bin_look_back(volatile const unsigned* sums, unsigned tile) {
  unsigned before = 0;
  for (volatile const unsigned* sum = sums + tile * kBins + threadIdx.x;; sum -= kBins) {
    unsigned seen;
    do {
      seen = *sum;
    } while (seen == 0);
    before += seen & kSum;
    if (seen & kInclusive) return before;
  }
}

}  // namespace

// Writes the keys, which ascend back to front, and slots of all visible splats. pages: in order of
// slots. sums: one for each tile, 0 at first.
extern "C" __global__ void __launch_bounds__(kThreads)
    cull(const View view, const bool orthographic, const Frame* frames, const Real* positions,
         const Real* extents, const Page* pages, const unsigned count, Header* header,
         unsigned* histograms, volatile unsigned* sums, unsigned* keys, unsigned* slots) {
  static_assert(kPageSlots % (kCullItems * kLanes) == 0, "a warp's rows lie in one page");
  __shared__ unsigned histogram[kDigits * kBins], warp_totals[kWarps], tile_first, block_largest;
  for (unsigned i = threadIdx.x; i < kDigits * kBins; i += kThreads) histogram[i] = 0;
  if (threadIdx.x == 0) block_largest = 0;
  unsigned largest = 0;

  const unsigned tiles = (count + kCullTile - 1) / kCullTile;
  for (unsigned tile; (tile = take_tile(&header->tickets)) < tiles;) {
    const unsigned first = tile * kCullTile + warp_id() * kCullItems * kLanes + lane_id();
    const Page page = pages[(count - 1 - min(first, count - 1)) / kPageSlots];
    const Frame frame = frames[page.group];
    Real position[kCullItems][3], extent[kCullItems];
#pragma unroll
    for (unsigned i = 0; i < kCullItems; ++i) {
      const unsigned rank = count - 1 - min(first + i * kLanes, count - 1);
      const unsigned row = page.place * kPageSlots + rank % kPageSlots;
#pragma unroll
      for (unsigned axis = 0; axis < 3; ++axis) position[i][axis] = positions[3ull * row + axis];
      extent[i] = extents[row];
    }
    unsigned own[kCullItems], warp_total = 0;
#pragma unroll
    for (unsigned i = 0; i < kCullItems; ++i) {
      own[i] = visible_key(view, orthographic, frame, position[i], extent[i]);
      if (first + i * kLanes >= count) own[i] = 0;
      largest = max(largest, own[i]);
      warp_total += __popc(__ballot_sync(kAll, own[i] != 0));
    }
    if (lane_id() == 0) warp_totals[warp_id()] = warp_total;
    __syncthreads();

    if (warp_id() == 0) {
      const unsigned total = __shfl_sync(
          kAll, inclusive_scan(lane_id() < kWarps ? warp_totals[lane_id()] : 0), kLanes - 1);
      if (lane_id() == 0) sums[tile] = kOwn | total;
      const unsigned before = warp_look_back(sums, tile);
      if (lane_id() == 0) {
        sums[tile] = kInclusive | (before + total);
        tile_first = before;
        if (tile == tiles - 1) header->count = before + total;
      }
    }
#pragma unroll
    for (unsigned i = 0; i < kCullItems; ++i) {
      if (own[i] == 0) continue;
#pragma unroll
      for (unsigned place = 0; place < kDigits; ++place) {
        const unsigned digit = digit_of(~own[i], place);
        // No bin needs the count of the last one, which has the highest digit of most splats.
        if (place < kDigits - 1 || digit != digit_of(kAll, place))
          atomicAdd(&histogram[place * kBins + digit], 1u);
      }
    }
    __syncthreads();

    unsigned to = tile_first + sum_before(warp_totals);
#pragma unroll
    for (unsigned i = 0; i < kCullItems; ++i) {
      const unsigned visible = __ballot_sync(kAll, own[i] != 0);
      if (own[i] != 0) {
        const unsigned rank = count - 1 - (first + i * kLanes);
        keys[to + __popc(visible & lanes_below())] = ~own[i];
        slots[to + __popc(visible & lanes_below())] = page.first_slot + rank % kPageSlots;
      }
      to += __popc(visible);
    }
  }

  atomicMax(&block_largest, largest);
  __syncthreads();
  if (threadIdx.x == 0) atomicMax(&header->largest, block_largest);
  for (unsigned i = threadIdx.x; i < kDigits * kBins; i += kThreads)
    if (histogram[i]) atomicAdd(&histograms[i], histogram[i]);
}

// Writes where each bin begins to row 0 of the sums of each digit's sort. One block a digit.
extern "C" __global__ void __launch_bounds__(kThreads)
    begin_bins(const unsigned* histograms, unsigned* sums, const unsigned sums_per_digit) {
  const unsigned place = blockIdx.x, bin = threadIdx.x;
  sums[place * sums_per_digit + bin] = kInclusive | block_scan(histograms[place * kBins + bin]);
}

// Sorts by one digit, stably. sums: row 0 by begin_bins, then a row for each tile, 0 at first.
extern "C" __global__ void __launch_bounds__(kThreads, 2)
    sort_digit(const unsigned place, Header* header, volatile unsigned* sums, const unsigned* keys,
               const unsigned* slots, unsigned* sorted_keys, unsigned* sorted_slots) {
  __shared__ unsigned scratch[kWarps * kBins];  // the warps' counts, then the tile's keys and slots
  static_assert(kSortTile <= kWarps * kBins, "room for a tile");
  __shared__ unsigned bin_target[kBins];
  const unsigned count = header->count;
  const unsigned tile = take_tile(&header->sort_tickets[place]);
  if (tile * kSortTile >= count) return;

  const unsigned first = tile * kSortTile + warp_id() * kSortItems * kLanes + lane_id();
  unsigned own[kSortItems], rank[kSortItems];
#pragma unroll
  for (unsigned i = 0; i < kSortItems; ++i)
    own[i] = first + i * kLanes < count ? keys[first + i * kLanes] : kAll;  // the rest goes last

  // Rank among equal digits of the warp.
  unsigned* warp_counts = scratch + warp_id() * kBins;
  for (unsigned bin = lane_id(); bin < kBins; bin += kLanes) warp_counts[bin] = 0;
  __syncwarp();
#pragma unroll
  for (unsigned i = 0; i < kSortItems; ++i) {
    const unsigned digit = digit_of(own[i], place);
    unsigned equal = kAll;
#pragma unroll
    for (unsigned bit = 0; bit < kDigitBits; ++bit) {
      const bool set = (digit >> bit) & 1;
      const unsigned lanes = __ballot_sync(kAll, set);
      equal &= set ? lanes : ~lanes;
    }
    const unsigned below = __popc(equal & lanes_below()), before = warp_counts[digit];
    rank[i] = before + below;
    __syncwarp();
    if (below == 0) warp_counts[digit] = before + __popc(equal);
    __syncwarp();
  }
  __syncthreads();

  // Rank in the tile.
  const unsigned bin = threadIdx.x;
  unsigned total = 0;
#pragma unroll
  for (unsigned warp = 0; warp < kWarps; ++warp) {
    const unsigned warp_count = scratch[warp * kBins + bin];
    scratch[warp * kBins + bin] = total;
    total += warp_count;
  }
  sums[(tile + 1) * kBins + bin] = kOwn | total;
  const unsigned tile_first = block_scan(total);
#pragma unroll
  for (unsigned warp = 0; warp < kWarps; ++warp) scratch[warp * kBins + bin] += tile_first;
  __syncthreads();
#pragma unroll
  for (unsigned i = 0; i < kSortItems; ++i) rank[i] += warp_counts[digit_of(own[i], place)];
  __syncthreads();
#pragma unroll
  for (unsigned i = 0; i < kSortItems; ++i) scratch[rank[i]] = own[i];
#pragma unroll
  for (unsigned i = 0; i < kSortItems; ++i)
    if (first + i * kLanes < count) own[i] = slots[first + i * kLanes];

  // Rank among all, which is where keys and slots are written.
  const unsigned before = bin_look_back(sums, tile);
  sums[(tile + 1) * kBins + bin] = kInclusive | (before + total);
  bin_target[bin] = before - tile_first;
  __syncthreads();
  const bool more = place + 1 < kUsualDigits ||
                    (place + 1 < kDigits && header->largest >> ((place + 1) * kDigitBits) != 0);
  const unsigned valid = min(count - tile * kSortTile, kSortTile);
  unsigned target[kSortItems];
#pragma unroll
  for (unsigned i = 0; i < kSortItems; ++i) {
    const unsigned index = threadIdx.x + i * kThreads;
    const unsigned key = scratch[index];
    target[i] = bin_target[digit_of(key, place)] + index;
    if (more && index < valid) sorted_keys[target[i]] = key;
  }
  __syncthreads();
#pragma unroll
  for (unsigned i = 0; i < kSortItems; ++i) scratch[rank[i]] = own[i];
  __syncthreads();
#pragma unroll
  for (unsigned i = 0; i < kSortItems; ++i) {
    const unsigned index = threadIdx.x + i * kThreads;
    if (index < valid) sorted_slots[target[i]] = scratch[index];
  }
}
