// Stages that cull slots, deal them out to slices of depth, and find what nearer slices hide.

#include <algorithm>
#include <cmath>

#include "raster/raster_work.hpp"
#include "rosplat_core/views/page_view.hpp"

namespace rosplat {

namespace {

constexpr std::size_t kSliceSize = std::size_t{1} << 18;  // splats worth a slice
constexpr std::size_t kMostSlices = 32;

}  // namespace

void CpuRasterizer::Work::cull() {
  static_assert(kSlots * sizeof(Candidate) % sizeof(Record) == 0);
  const std::size_t room = pages.size() * kSlots * sizeof(Candidate) / sizeof(Record);
  found = reinterpret_cast<Candidate*>(records.reserve(room + 1));
  inParts(pages.size(), 16, [&](StepShare& part, Member&) {
    Candidate* const begin = found + part.begin * kSlots;
    Candidate* out = begin;
    for (std::size_t i = part.begin; i < part.end; ++i) {
      if (cancelled()) break;
      const SeenPage& page = pages[i];
      const std::size_t count = kernels.cull(layers[page.layer].cull, page.slots, out);
      if (!ordered) {
        out += count;
        continue;
      }
      const Candidate* const end = out + count;
      for (const Candidate* c = out; c < end; ++c) {
        const std::uint32_t rank =
            ranks[std::size_t(page.page->place) * kSlots + c->index % kSlots];
        if (rank != kNotOrdered) *out++ = {rank, c->index};
      }
    }
    part.begin *= kSlots;
    part.end = part.begin + std::size_t(out - begin);
  });
  candidates = 0;
  for (const StepShare& part : parts) candidates += part.end - part.begin;
}

// Deals the candidates out to slices of depth, nearest first; within a slice in the order of slots.
void CpuRasterizer::Work::deal() {
  const std::size_t slices = std::clamp<std::size_t>(candidates / kSliceSize, 1, kMostSlices);

  // Samples choose the bounds, so that slices have about as many candidates each.
  std::vector<std::uint32_t> samples, bounds_of_slices;
  const std::size_t stride = std::max<std::size_t>(candidates / (256 * slices), 1);
  std::size_t skip = 0;
  for (const StepShare& part : parts) {
    if (slices == 1) break;
    std::size_t i = part.begin + skip;
    for (; i < part.end; i += stride) samples.push_back(found[i].key);
    skip = i - part.end;
  }
  std::sort(samples.begin(), samples.end());
  for (std::size_t slice = 1; slice < slices; ++slice) {
    bounds_of_slices.push_back(samples[samples.size() * slice / slices]);
  }
  const auto sliceOf = [&](std::uint32_t key) {
    std::size_t slice = 0;
    for (const std::uint32_t bound : bounds_of_slices) slice += key >= bound;
    return slice;
  };

  dealt.reserve(candidates + 1);
  const auto eachPart = [&](const auto& step) {
    team->run(unsigned(parts.size()), [&](unsigned number, unsigned) { step(parts[number]); });
  };
  for (StepShare& part : parts) part.slices.assign(slices, 0);
  eachPart([&](StepShare& part) {
    if (slices == 1) {
      part.slices[0] = part.end - part.begin;
      return;
    }
    for (std::size_t i = part.begin; i < part.end; ++i) ++part.slices[sliceOf(found[i].key)];
  });
  waiting.clear();
  std::size_t next = 0;
  for (std::size_t slice = 0; slice < slices; ++slice) {
    const std::size_t begin = next;
    for (StepShare& part : parts) next += std::exchange(part.slices[slice], next);
    waiting.push_back({begin, next});
  }
  std::reverse(waiting.begin(), waiting.end());
  eachPart([&](StepShare& part) {
    for (std::size_t i = part.begin; i < part.end; ++i) {
      dealt[part.slices[slices == 1 ? 0 : sliceOf(found[i].key)]++] = found[i];
    }
  });
}

// Splits a waiting slice by depth into two, each in the order of slots.
void CpuRasterizer::Work::halve(std::size_t number) {
  const DepthSlice slice = waiting[number];
  Candidate* const begin = dealt.get() + slice.begin;
  Candidate* const end = begin + (slice.end - slice.begin);
  const auto bySlot = [](const Candidate& a, const Candidate& b) { return a.index < b.index; };
  Candidate* const middle = begin + (end - begin) / 2;
  std::nth_element(begin, middle, end, [](const Candidate& a, const Candidate& b) {
    return a.key != b.key ? a.key < b.key : a.index < b.index;
  });
  std::sort(begin, middle, bySlot);
  std::sort(middle, end, bySlot);
  const std::size_t half = slice.begin + std::size_t(middle - begin);
  waiting[number] = {half, slice.end};
  waiting.insert(waiting.begin() + std::ptrdiff_t(number) + 1, {slice.begin, half});
}

// Sets up the pyramid: before the first splat is blended, only opaque objects hide anything.
void CpuRasterizer::Work::openTiles(const PictureRequest& request) {
  pyramid.across = across;
  pyramid.down = down;
  std::size_t size = 0;
  int level = 0;
  for (int w = across, h = down;; w = (w + 1) / 2, h = (h + 1) / 2, ++level) {
    pyramid.begins[level] = static_cast<std::int32_t>(size);
    pyramid.widths[level] = w;
    size += std::size_t(w) * std::size_t(h);
    if (w == 1 && h == 1) break;
  }
  levels = level + 1;
  open.assign(size, kOpen);
  pyramid.open = open.data();
  hides = !request.scene_depth.empty();
  if (!hides) return;
  const SplatCamera& camera = request.camera();
  inParts(tiles, 256, [&](const StepShare& part, Member&) {
    for (std::size_t tile = part.begin; tile < part.end; ++tile) {
      const TileRect rect(tile, across, camera.width, camera.height);
      float farthest = 0;
      rect.forEach([&](std::size_t, std::size_t pixel) {
        farthest = std::max(farthest, request.scene_depth[pixel]);
      });
      open[tile] = farthest;
    }
  });
}

void CpuRasterizer::Work::raisePyramid() {
  int w = across, h = down;
  for (int level = 1; level < levels; ++level) {
    const float* const below = &open[std::size_t(pyramid.begins[level - 1])];
    float* const here = &open[std::size_t(pyramid.begins[level])];
    const int width = (w + 1) / 2, height = (h + 1) / 2;
    for (int row = 0; row < height; ++row) {
      for (int column = 0; column < width; ++column) {
        const int right = std::min(2 * column + 1, w - 1), bottom = std::min(2 * row + 1, h - 1);
        here[row * width + column] =
            std::max(std::max(below[2 * row * w + 2 * column], below[2 * row * w + right]),
                     std::max(below[bottom * w + 2 * column], below[bottom * w + right]));
      }
    }
    w = width;
    h = height;
  }
}

// Whether all splats that a page may hold are hidden in all tiles. Pages with bounds beyond float32
// are never hidden: see isBeyond().
bool CpuRasterizer::Work::hidden(const SeenPage& seen) const {
  const SeenLayer& layer = layers[seen.layer];
  const SlotPage& page = *seen.page;
  const ProjectView& v = layer.project;
  float centre[3], half[3];  // of a box around the page, in the camera's frame [m]
  for (int axis = 0; axis < 3; ++axis) {
    const float* const row = layer.groups[page.group].floats.to_camera[axis];
    centre[axis] = row[3];
    half[axis] = 0;
    for (int i = 0; i < 3; ++i) {
      centre[axis] += row[i] * 0.5f * (page.least[i] + page.most[i]);
      half[axis] += std::fabs(row[i]) * 0.5f * (page.most[i] - page.least[i]);
    }
    half[axis] += 1e-5f * (std::fabs(centre[axis]) + half[axis]);  // for rounding
  }
  const float nearest = centre[2] - half[2], farthest = centre[2] + half[2];
  if (!v.orthographic && !(nearest > v.near_clip)) return false;
  const float ndc = (v.ndc_scale * nearest + v.ndc_offset) / (v.orthographic ? 1 : nearest);
  const float window_depth = 0.5f * std::min(ndc, 1.0f) + 0.5f;
  const auto tilesAlong = [&](int axis, float focal, float middle, float slope, int count) {
    constexpr float kMargin = 3;  // for the low-pass filter, and for rounding [px]
    const float least = centre[axis] - half[axis], most = centre[axis] + half[axis];
    const float over_near = v.orthographic ? 1 : 1 / nearest;
    const float over_far = v.orthographic ? 1 : 1 / farthest;
    const float reach = slope * page.extent * over_near + kMargin;
    const float last = float(count - 1);
    const float from = focal * std::min(least * over_near, least * over_far) + middle - reach;
    const float to = focal * std::max(most * over_near, most * over_far) + middle + reach;
    return std::pair(isBeyond(from, 0) ? int(std::min(from / kTile, last)) : 0,
                     isBeyond(-to, -last * kTile) ? int(std::max(to / kTile, 0.0f)) : count - 1);
  };
  auto [left, right] = tilesAlong(0, v.fx, v.cx, layer.cull.slope_x, across);
  auto [top, bottom] = tilesAlong(1, v.fy, v.cy, layer.cull.slope_y, down);
  int level = 0;
  for (; right - left > 1 || bottom - top > 1; ++level)
    left /= 2, right /= 2, top /= 2, bottom /= 2;
  const float* const open_here = &open[std::size_t(pyramid.begins[level])];
  const int width = pyramid.widths[level];
  return window_depth >
         std::max(std::max(open_here[top * width + left], open_here[top * width + right]),
                  std::max(open_here[bottom * width + left], open_here[bottom * width + right]));
}

}  // namespace rosplat
