// Stages that project a slice, and list its splats by the tiles that they touch.

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numeric>
#include <utility>

#include "raster/raster_work.hpp"

namespace rosplat {

namespace {

constexpr std::size_t kMostPairs = std::size_t{1} << 24;  // in a slice: 256 MiB with their lists
constexpr std::size_t kUncounted = std::size_t{1}
                                   << 16;  // pairs that a thread adds to them at once

// Finds the tiles [first, last) that a splat may cover in a row; see across() in splat_tiles.glsl.
void columnsOf(const Footprint& f, int row, int& first, int& last) {
  const float top = float(kTile * row) + 0.5f - f.between - f.y;
  const float bottom = top + float(kTile - 1) + 2 * f.between;
  const auto inside = [](float v, float limit) { return std::clamp(v, -limit, limit); };
  const float from = inside(top, f.reach_y), to = inside(bottom, f.reach_y);
  const float left = std::clamp(-f.rightmost, from, to), right = std::clamp(f.rightmost, from, to);
  const float scale = 1 / (f.reach_y * f.reach_y);
  const auto halfWidth = [&](float down) {
    return f.half_width * std::sqrt(std::max(1 - down * down * scale, 0.0f));
  };
  const float begin = f.x + f.lean * left - halfWidth(left);
  const float end = f.x + f.lean * right + halfWidth(right);
  const float slack = 0.05f + 1e-5f * (end - begin) + f.between;
  const float least = std::ceil(begin - 0.5f - slack), most = std::floor(end - 0.5f + slack);
  first = last = 0;
  if (!(least <= most)) return;
  first = int(std::clamp(std::floor(least / kTile), float(f.left), float(f.right)));
  last = int(std::clamp(std::floor(most / kTile) + 1, float(f.left), float(f.right)));
}

// Sorts by key; stable.
void sortByKey(Listed* listed, std::size_t count, Listed* spare) {
  if (count < 48) {
    for (std::size_t i = 1; i < count; ++i) {
      const Listed moved = listed[i];
      std::size_t k = i;
      for (; k > 0 && listed[k - 1].key > moved.key; --k) listed[k] = listed[k - 1];
      listed[k] = moved;
    }
    return;
  }
  // Least significant digit first, over the bits in which the keys differ.
  constexpr unsigned kDigitBits = 9, kMostPasses = 4;
  std::uint32_t least = ~0u, greatest = 0;
  for (std::size_t i = 0; i < count; ++i) {
    least = std::min(least, listed[i].key);
    greatest = std::max(greatest, listed[i].key);
  }
  unsigned bits = 0;
  while (bits < 32 && (greatest - least) >> bits != 0) ++bits;
  const unsigned passes = (bits + kDigitBits - 1) / kDigitBits;
  const unsigned digit_bits = passes > 0 ? (bits + passes - 1) / passes : 0;
  const std::uint32_t mask = (1u << digit_bits) - 1;
  std::array<std::array<std::uint32_t, 1u << kDigitBits>, kMostPasses> targets;
  for (unsigned pass = 0; pass < passes; ++pass) std::fill_n(targets[pass].begin(), mask + 1, 0u);
  for (std::size_t i = 0; i < count; ++i) {
    std::uint32_t key = listed[i].key - least;
    for (unsigned pass = 0; pass < passes; ++pass, key >>= digit_bits) ++targets[pass][key & mask];
  }
  Listed* from = listed;
  Listed* to = spare;
  for (unsigned pass = 0; pass < passes; ++pass, std::swap(from, to)) {
    std::uint32_t* const target = targets[pass].data();
    std::exclusive_scan(target, target + mask + 1, target, 0u);
    const unsigned shift = pass * digit_bits;
    for (std::size_t i = 0; i < count; ++i) {
      to[target[(from[i].key - least) >> shift & mask]++] = from[i];
    }
  }
  if (from != listed) std::copy_n(from, count, listed);
}

}  // namespace

// Pairs a record with the tiles that it touches and that may still show it.
void CpuRasterizer::Work::findTiles(const Footprint& f, std::uint32_t record,
                                    StepShare& part) const {
  Pair* out = part.pairs.makeRoom(std::size_t(f.bottom - f.top) * std::size_t(f.right - f.left));
  const float* const until = hides ? open.data() : nullptr;
  const float window_depth = records[record].window_depth;
  std::uint32_t* const counts = part.counts.data();
  const bool spans = f.bottom - f.top <= Footprint::kRows;
  for (int row = f.top; row < f.bottom; ++row) {
    int first, last;
    if (spans) {
      first = f.first[row - f.top];
      last = f.last[row - f.top];
    } else {
      columnsOf(f, row, first, last);
    }
    const int begin = row * across;
    for (int tile = begin + first; tile < begin + last; ++tile) {
      if (until && window_depth > until[tile]) continue;
      *out++ = {std::uint32_t(tile), record};
      ++counts[tile];
    }
  }
  part.pairs.size = std::size_t(out - part.pairs.pairs.get());
}

// Projects a slice, and finds its splats' tiles. Returns false if there are more than kMostPairs.
bool CpuRasterizer::Work::project(const DepthSlice& slice) {
  const std::size_t begin = slice.begin, end = slice.end;
  records.reserve(end - begin + kSlots);
  keys.reserve(end - begin + kSlots);
  if (conics || planes) shapes.reserve(end - begin + kSlots);
  std::atomic<std::size_t> pairs{0};
  inParts(end - begin, 4096, [&](StepShare& part, Member& member) {
    part.counts.assign(tiles, 0);
    part.pairs.size = 0;
    part.of_layers.assign(layers.size(), 0);
    member.places.resize(kSlots + kMostLanes);
    member.kept.resize(kSlots);
    member.numbers.resize(kSlots);
    member.footprints.resize(kSlots);
    std::size_t out = part.begin;
    for (std::size_t i = part.begin; i < part.end && !cancelled() && pairs <= kMostPairs;) {
      const Candidate* const run = &dealt[begin + i];
      const std::uint32_t page = run->index / kSlots;
      std::size_t count = 0;
      for (; i < part.end && dealt[begin + i].index / kSlots == page; ++i) {
        member.places[count] = static_cast<std::uint16_t>(run[count].index % kSlots);
        ++count;
      }
      const SeenPage& of = pages[page];
      const SeenLayer& layer = layers[of.layer];
      if (hides && hidden(of)) continue;
      if (hides) {
        count = kernels.hide(layer.cull, layer.project, pyramid, of.slots, member.places.data(),
                             member.numbers.data(), count);
      }
      const std::size_t seen = kernels.project(
          layer.project, of.slots, member.places.data(), count, &records[out],
          conics || planes ? &shapes[out] : nullptr, member.footprints.data(), member.kept.data());
      part.of_layers[of.layer] += seen;
      std::size_t counted = part.pairs.size;
      for (std::size_t k = 0; k < seen && pairs <= kMostPairs; ++k, ++out) {
        const std::uint16_t number = member.kept[k];
        keys[out] = run[hides ? member.numbers[number] : number].key;
        findTiles(member.footprints[k], static_cast<std::uint32_t>(out), part);
        if (part.pairs.size - counted > kUncounted) {
          pairs += part.pairs.size - counted;
          counted = part.pairs.size;
        }
      }
      pairs += part.pairs.size - counted;
    }
    part.drawn = out - part.begin;
  });
  total_pairs = pairs;
  return pairs <= kMostPairs;
}

// Sets the range of layers of mode kDepth without one: that of all these layers' splats in view.
void CpuRasterizer::Work::findDepthRanges() {
  const auto wants = [](const SeenLayer& layer) {
    const ProjectView& view = layer.project;
    return view.mode == DrawMode::kDepth && view.depth_range.empty();
  };
  if (std::none_of(layers.begin(), layers.end(), wants)) return;
  constexpr float kInfinity = std::numeric_limits<float>::infinity();
  Range range{kInfinity, -kInfinity};
  for (std::size_t number = 0; number < waiting.size();) {
    const DepthSlice slice = waiting[number];
    if (!project(slice) && slice.end - slice.begin > 1 && !cancelled()) {
      halve(number);
      continue;
    }
    ++number;
    for (const StepShare& part : parts) {
      for (std::size_t i = part.begin; i < part.begin + part.drawn; ++i) {
        if (!wants(layers[pages[records[i].index / kSlots].layer])) continue;
        range = {std::min(range.least, records[i].depth), std::max(range.most, records[i].depth)};
      }
    }
  }
  for (SeenLayer& layer : layers) {
    if (wants(layer)) layer.project.depth_range = range;
  }
}

// Lists each tile's splats, in the order of their slots.
void CpuRasterizer::Work::list() {
  listed.reserve(total_pairs);
  begins.assign(tiles + 1, 0);
  std::size_t next = 0;
  for (std::size_t tile = 0; tile < tiles; ++tile) {
    begins[tile] = next;
    for (StepShare& part : parts) {
      next += std::exchange(part.counts[tile], static_cast<std::uint32_t>(next));
    }
  }
  begins[tiles] = next;
  team->run(unsigned(parts.size()), [&](unsigned number, unsigned) {
    StepShare& part = parts[number];
    for (std::size_t i = 0; i < part.pairs.size; ++i) {
      const Pair pair = part.pairs.pairs[i];
      listed[part.counts[pair.tile]++] = {keys[pair.record], pair.record};
    }
  });
}

// Sorts a tile's list, nearest first.
void CpuRasterizer::Work::sortTile(std::size_t tile, Member& member) {
  const std::size_t count = inTile(tile);
  sortByKey(listed.get() + begins[tile], count, member.spare.reserve(count));
}

}  // namespace rosplat
