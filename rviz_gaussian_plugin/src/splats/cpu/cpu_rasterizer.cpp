#include "cpu/cpu_rasterizer.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstring>
#include <limits>
#include <new>
#include <numeric>
#include <utility>

#include "cpu/kernels.hpp"
#include "map/cut.hpp"
#include "map/page_view.hpp"
#include "map/sorter_view.hpp"

namespace rosplat {

using namespace cpu;
using Clock = std::chrono::steady_clock;

namespace {

constexpr std::uint32_t kSlots = HostSlots::kSlots;
constexpr std::uint32_t kNotOrdered = 0xffffffffu;
constexpr std::size_t kMostPairs = std::size_t{1} << 24;  // of splat and tile, at a time: 256 MiB
constexpr int kLongestSide = 16384;                       // [px], as makeCamera() has it
constexpr std::size_t kSliceSize = std::size_t{1} << 18;  // splats that are worth a slice
constexpr std::size_t kMostSlices = 32;
constexpr double kMostError = 1e15;      // where nothing is left to be merged [px]
constexpr float kLeastPicked = 0.05f;    // contribution to a pixel; less nobody sees
constexpr float kOpen = 2, kEnded = -1;  // window depths up to which tiles may show something
constexpr float kTransparent =
    1e-4f;  // 106 dB and more against blending all; gsplat ends there, too

const Kernels& kernelsFor(CpuRasterizer::Instructions wanted) {
#if defined(__x86_64__) && defined(__GNUC__)
  using Instructions = CpuRasterizer::Instructions;
  __builtin_cpu_init();
  if (wanted >= Instructions::kAvx512 && __builtin_cpu_supports("avx512f") &&
      __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512vl") &&
      __builtin_cpu_supports("avx512bw")) {
    return avx512::kKernels;
  }
  if (wanted >= Instructions::kAvx2 && __builtin_cpu_supports("avx2") &&
      __builtin_cpu_supports("fma")) {
    return avx2::kKernels;
  }
#else
  static_cast<void>(wanted);
#endif
  return plain::kKernels;
}

// Memory for values to come: nothing is kept when it grows, nor cleared.
template <typename T>
class Room {
 public:
  T* reserve(std::size_t size) {
    if (size > size_) {
      memory_.reset();
      size_ = 0;
      memory_.reset(new T[size + size / 4]);
      size_ = size + size / 4;
    }
    return memory_.get();
  }
  T* get() const { return memory_.get(); }
  T& operator[](std::size_t i) const { return memory_[i]; }
  std::size_t bytes() const { return size_ * sizeof(T); }

 private:
  std::unique_ptr<T[]> memory_;
  std::size_t size_ = 0;
};

// Dealt candidates that are nearer than those of the next slice.
struct Slice {
  std::size_t begin, end;
};

// A splat on a tile.
struct Pair {
  std::uint32_t tile, record;
};

// Pairs one after the other, in memory that is made before they are written.
struct PairList {
  // Where so many more may be written.
  Pair* makeRoom(std::size_t more) {
    if (size + more > room) {
      const std::size_t larger = size + more + room / 2;
      std::unique_ptr<Pair[]> memory(new Pair[larger]);
      std::copy_n(pairs.get(), size, memory.get());
      pairs = std::move(memory);
      room = larger;
    }
    return pairs.get() + size;
  }

  std::unique_ptr<Pair[]> pairs;
  std::size_t size = 0, room = 0;
};

// Whether splats are solid.
bool drawsBalls(DrawMode mode) {
  return mode == DrawMode::kFlatBall || mode == DrawMode::kGaussianBall;
}

// A share of a step, and what was found in it.
struct Part {
  std::size_t begin = 0, end = 0;
  std::vector<std::size_t> slices;    // candidates of each, then where the next one goes
  std::vector<std::uint32_t> counts;  // pairs of each tile, then where the next one goes
  PairList pairs;
  std::size_t drawn = 0;
};

// From where to where tiles are covered in a row of them; see across() in splat_tiles.glsl.
void columnsOf(const Footprint& f, int row, int& first, int& last) {
  const float top = float(kTile * row) + 0.5f - f.y, bottom = top + float(kTile - 1);
  const auto inside = [](float v, float limit) { return std::clamp(v, -limit, limit); };
  const float from = inside(top, f.reach_y), to = inside(bottom, f.reach_y);
  const float left = std::clamp(-f.rightmost, from, to), right = std::clamp(f.rightmost, from, to);
  const float scale = 1 / (f.reach_y * f.reach_y);
  const auto halfWidth = [&](float down) {
    return f.half_width * std::sqrt(std::max(1 - down * down * scale, 0.0f));
  };
  const float begin = f.x + f.lean * left - halfWidth(left);
  const float end = f.x + f.lean * right + halfWidth(right);
  const float slack = 0.05f + 1e-5f * (end - begin);
  const float least = std::ceil(begin - 0.5f - slack), most = std::floor(end - 0.5f + slack);
  first = last = 0;
  if (!(least <= most)) return;
  first = int(std::clamp(std::floor(least / kTile), float(f.left), float(f.right)));
  last = int(std::clamp(std::floor(most / kTile) + 1, float(f.left), float(f.right)));
}

// By key, and those of equal keys as they come.
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

// The part of a picture that a tile is.
struct TileRect {
  TileRect(std::size_t tile, int across, int width_of_all, int height_of_all)
      : left(int(tile) % across * kTile),
        top(int(tile) / across * kTile),
        width(std::min(kTile, width_of_all - left)),
        height(std::min(kTile, height_of_all - top)),
        first(std::size_t(top) * std::size_t(width_of_all) + std::size_t(left)),
        stride(std::size_t(width_of_all)) {}

  // Calls each(pixel of the tile, pixel of the picture).
  template <typename Each>
  void forEach(const Each& each) const {
    for (int row = 0; row < height; ++row) {
      for (int column = 0; column < width; ++column) {
        each(std::size_t(kTile * row + column),
             first + std::size_t(row) * stride + std::size_t(column));
      }
    }
  }

  int left, top, width, height;  // [px]
  std::size_t first, stride;
};

// Copies a tile of some depths, far where there is no pixel; null where there are none.
const float* depthsOf(const ArrayView<float>& depths, const TileRect& rect, float* copy) {
  if (depths.empty()) return nullptr;
  std::fill_n(copy, kTilePixels, 1.0f);
  rect.forEach([&](std::size_t i, std::size_t pixel) { copy[i] = depths[pixel]; });
  return copy;
}

}  // namespace

struct CpuRasterizer::Work {
  Work(std::shared_ptr<rosplat_sorter::ThreadTeam> with, const Kernels& fastest)
      : team(std::move(with)), kernels(fastest), members(team->size()) {}

  // A member's own.
  struct Member {
    TilePixels pixels, behind;
    alignas(64) float opaque[kTilePixels], divided[kTilePixels], most[kTilePixels];
    alignas(64) std::uint32_t slots[kTilePixels];
    Room<Listed> spare;
    std::vector<std::uint16_t> places, numbers, kept;
    std::vector<Footprint> footprints;
  };

  // Draws, or picks, or finds what contributes to a picture that was drawn.
  struct Wanted {
    SplatPicture* picture = nullptr;
    std::vector<std::uint32_t>* picked = nullptr;
    Contributions* contributions = nullptr;
  };

  bool run(const HostSlots& slots, const MapState& map, const PictureRequest& request,
           const Wanted& wanted);
  void setViews(const HostSlots& slots, const MapState& map, const PictureRequest& request);
  void choosePages(const HostSlots& slots, const MapState& map, const PictureRequest& request,
                   double error);
  void choose(const SlotPage& page, const HostSlots::Page& memory);
  void cull();
  void deal();
  void halve(const Slice& slice);
  void openTiles(const PictureRequest& request);
  void raisePyramid();
  bool hidden(const SlotPage& page) const;
  void findTiles(const Footprint& footprint, std::uint32_t record, Part& part) const;
  bool project(const Slice& slice);
  void list();
  void blend(const PictureRequest& request, SplatPicture& picture, bool first, std::size_t tile,
             Member& member);
  void pick(const PictureRequest& request, std::vector<std::uint32_t>& picked, bool first,
            std::size_t tile, Member& member);
  void contribute(const PictureRequest& request, const SplatPicture& picture, bool first,
                  std::size_t tile, Member& member);
  void addUp(Contributions& contributions) const;
  std::size_t inTile(std::size_t tile, Member& member);
  void findDepthRange();

  // Does step(part, member) for parts of [0, count), side by side.
  template <typename Step>
  void inParts(std::size_t count, std::size_t least_share, const Step& step);
  bool cancelled() const { return cancel && cancel->load(std::memory_order_relaxed); }
  void lap(const char* stage) {
    const Clock::time_point now = Clock::now();
    profile[stage] += std::chrono::duration<double>(now - began).count();
    began = now;
  }

  std::shared_ptr<rosplat_sorter::ThreadTeam> team;
  const Kernels& kernels;
  std::vector<Member> members;
  std::vector<Part> parts;

  CullView cull_view;
  ProjectView project_view;
  std::vector<PageSlots> pages;  // that the picture may show
  std::vector<const SlotPage*> bounds;
  std::array<HostSlots::PerSlot<float>, kLevels> node_parents;  // PageSlots::parents, by level
  Room<std::uint32_t> ranks;  // in a given order, by place of a page and in that
  bool ordered = false;
  Room<Candidate> found, dealt;
  std::size_t candidates = 0;
  std::vector<Slice> waiting;    // the nearest one last
  std::vector<float> open;       // the pyramid's
  std::vector<float> picking;    // transmittance and the most contributed so far, by pixel
  std::vector<float> remaining;  // transmittance and what is still to come of the colour, by pixel
  Room<Contribution> of_listed;
  Pyramid pyramid;
  int levels = 0;
  bool hides = false;  // some tile isn't open
  Room<Record> records;
  Room<std::uint32_t> keys;  // of the records
  Room<Listed> listed;
  std::vector<std::size_t> begins;  // of each tile's
  std::size_t tiles = 0, total_pairs = 0;

  const std::atomic<bool>* cancel = nullptr;
  std::atomic<bool> out_of_memory{false};
  std::map<std::string, double> profile;
  Clock::time_point began;
};

template <typename Step>
void CpuRasterizer::Work::inParts(std::size_t count, std::size_t least_share, const Step& step) {
  const std::size_t most = members.size() > 1 ? 2 * members.size() : 1;
  parts.resize(std::min(most, 1 + count / least_share));
  team->run(unsigned(parts.size()), [&](unsigned number, unsigned member) {
    Part& part = parts[number];
    part.begin = count * number / parts.size();
    part.end = count * (number + 1) / parts.size();
    try {
      step(part, members[member]);
    } catch (const std::bad_alloc&) {
      out_of_memory = true;
    }
  });
  if (out_of_memory) throw std::bad_alloc();
}

void CpuRasterizer::Work::setViews(const HostSlots& slots, const MapState& map,
                                   const PictureRequest& request) {
  const SplatCamera& camera = request.camera;
  const RenderSettings& settings = request.settings;
  // Rebased in double precision: neither the map's origin nor the camera's position reaches
  // float32.
  const rosplat_sorter::View view = sorterView(camera, map.origin, 1.0);
  CullView& c = cull_view;
  std::copy_n(view.rotation, 9, c.rotation);
  std::copy_n(view.translation, 3, c.translation);
  c.fx = view.fx;
  c.fy = view.fy;
  c.offset_x = view.offset_x;
  c.offset_y = view.offset_y;
  c.half_width = view.half_width;
  c.half_height = view.half_height;
  c.slope_x = view.slope_x;
  c.slope_y = view.slope_y;
  c.near_clip = view.near_clip;
  c.far_clip = view.far_clip;
  c.orthographic = view.orthographic;
  const ClipBox& box = settings.clip_box;
  c.clip_to_box = box.enabled;
  for (int i = 0; i < 3; ++i) {
    c.box_centre[i] = static_cast<float>(box.centre[i] - map.origin[i]);
    c.half_box[i] = 0.5f * box.size[i];
  }

  ProjectView& p = project_view;
  std::copy_n(view.rotation, 9, p.rotation);
  std::copy_n(view.translation, 3, p.translation);
  const auto& r = camera.rotation;
  for (int i = 0; i < 3; ++i) {
    double position = 0;
    for (int k = 0; k < 3; ++k) {
      double t = camera.translation[k];
      for (int j = 0; j < 3; ++j) t += r[3 * k + j] * map.origin[j];
      position -= r[3 * k + i] * t;
    }
    p.eye[i] = static_cast<float>(camera.orthographic ? r[6 + i] : position);
  }
  p.fx = view.fx;
  p.fy = view.fy;
  p.cx = static_cast<float>(camera.cx);
  p.cy = static_cast<float>(camera.cy);
  p.width = static_cast<float>(camera.width);
  p.height = static_cast<float>(camera.height);
  const SplatCamera::Whole whole = camera.whole();
  const auto tangents = [&](int axis, double focal, double centre, double size) {
    const double slack = 0.15 * size / focal;  // 0.3 tan(fov / 2)
    p.least_tangent[axis] = static_cast<float>(-centre / focal - slack);
    p.most_tangent[axis] = static_cast<float>((size - centre) / focal + slack);
  };
  tangents(0, camera.fx, whole.cx, whole.width);
  tangents(1, camera.fy, whole.cy, whole.height);
  p.near_clip = view.near_clip;
  p.near_fade = settings.near_fade;
  p.ndc_scale = static_cast<float>(camera.ndc_scale);
  p.ndc_offset = static_cast<float>(camera.ndc_offset);
  p.scale_modifier = settings.scale;
  p.opacity_modifier = settings.opacity;
  p.now = static_cast<float>(request.now);
  p.age_range = settings.age_range;
  p.depth_range[0] = settings.depth_range[0];
  p.depth_range[1] = settings.depth_range[1];
  p.mode = static_cast<int>(settings.mode);
  p.sh_degree = std::min(slots.shDegree(), settings.max_sh_degree);
  p.only_band = settings.only_band;
  p.tiles_across = (camera.width + kTile - 1) / kTile;
  p.tiles_down = (camera.height + kTile - 1) / kTile;
  p.orthographic = camera.orthographic;
  p.antialiased = settings.antialiasing == Antialiasing::kAsTrained
                      ? map.antialiased
                      : settings.antialiasing == Antialiasing::kOn;
  tiles = std::size_t(p.tiles_across) * std::size_t(p.tiles_down);

  ordered = request.order.has_value();
  if (ordered) {
    const std::size_t room = slots.pages().size() * kSlots;
    std::uint32_t* const rank = ranks.reserve(room);
    std::fill_n(rank, room, kNotOrdered);
    const ArrayView<std::uint32_t>& order = *request.order;
    for (std::size_t i = 0; i < order.size; ++i) {
      const SlotPage* const page = slots.index().find(order[i]);
      if (page) {
        rank[std::size_t(page->place) * kSlots + order[i] % kSlots] =
            static_cast<std::uint32_t>(order.size - 1 - i);
      }
    }
  }
}

// Those that may have something in the picture.
void CpuRasterizer::Work::choosePages(const HostSlots& slots, const MapState& map,
                                      const PictureRequest& request, double error) {
  pages.clear();
  bounds.clear();
  const PageView view(sorterView(request.camera, map.origin, 1.0), request.settings.clip_box,
                      map.origin);
  if (error == 0) {
    for (const SlotPage& page : slots.pages()) {
      if (view.mayShow(page)) choose(page, slots.at(page));
    }
    return;
  }
  const Cut cut(request.camera, map.origin, error, drawsBalls(request.settings.mode));
  CutView& c = cull_view.cut;
  for (int i = 0; i < 3; ++i) c.eye[i] = static_cast<float>(cut.eye[i]);
  c.focal = static_cast<float>(cut.focal);
  c.from = static_cast<float>(cut.from);
  c.over_span = static_cast<float>(1 / (cut.to - cut.from));
  c.orthographic = cut.orthographic;
  project_view.cut = c;
  for (const SlotPage& page : slots.pages()) {
    const HostSlots::Page& memory = slots.at(page);
    if (!view.mayShow(page) || !cut.mayShow(page, 0, memory.widest_parent)) continue;
    choose(page, memory);
    if (memory.parents) pages.back().parents = memory.parents->data();
  }
  for (int level = 0; level < kLevels; ++level) {
    const float own = cellSize(level), parent = level + 1 < kLevels ? 2 * own : kBoundless;
    HostSlots::PerSlot<float>& parents = node_parents[std::size_t(level)];
    parents.fill(parent);
    for (const auto& page : request.levels->pages()[std::size_t(level)]) {
      if (!view.mayShow(page->bounds) || !cut.mayShow(page->bounds, own, parent)) continue;
      choose(page->bounds, page->slots);
      pages.back().parents = parents.data();
      pages.back().own_cell = own;
      pages.back().opacity_unit *= kMostNodeOpacity;
    }
  }
}

void CpuRasterizer::Work::choose(const SlotPage& page, const HostSlots::Page& memory) {
  static const std::vector<std::uint32_t> kZeros(std::size_t{7} * kSlots);
  PageSlots& chosen = pages.emplace_back();
  for (int i = 0; i < 3; ++i) chosen.position[i] = memory.position[i].data();
  chosen.extent = memory.extent.data();
  chosen.words = memory.words[0].data();
  for (int band = 1; band <= kMaxShDegree; ++band) {
    chosen.bands[band] = memory.bands[band] ? memory.bands[band].get() : kZeros.data();
  }
  chosen.parents = nullptr;
  chosen.own_cell = 0;
  chosen.opacity_unit = 1.0f / 65535.0f;
  chosen.first_slot = page.first_slot;
  bounds.push_back(&page);
}

void CpuRasterizer::Work::cull() {
  found.reserve(pages.size() * kSlots + 1);
  inParts(pages.size(), 16, [&](Part& part, Member&) {
    Candidate* const begin = &found[part.begin * kSlots];
    Candidate* out = begin;
    for (std::size_t i = part.begin; i < part.end; ++i) {
      if (cancelled()) break;
      const std::size_t count =
          kernels.cull(cull_view, pages[i], static_cast<std::uint32_t>(i * kSlots), out);
      if (!ordered) {
        out += count;
        continue;
      }
      const Candidate* const end = out + count;
      for (const Candidate* c = out; c < end; ++c) {
        const std::uint32_t rank =
            ranks[std::size_t(bounds[i]->place) * kSlots + c->index % kSlots];
        if (rank != kNotOrdered) *out++ = {rank, c->index};
      }
    }
    part.begin *= kSlots;
    part.end = part.begin + std::size_t(out - begin);
  });
  candidates = 0;
  for (const Part& part : parts) candidates += part.end - part.begin;
}

// Deals what was found out to slices of depth, nearest first, in each in the order of slots.
void CpuRasterizer::Work::deal() {
  const std::size_t slices = std::clamp<std::size_t>(candidates / kSliceSize, 1, kMostSlices);

  // So that about as many are in each, by samples.
  std::vector<std::uint32_t> samples, bounds_of_slices;
  const std::size_t stride = std::max<std::size_t>(candidates / (256 * slices), 1);
  std::size_t skip = 0;
  for (const Part& part : parts) {
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
  for (Part& part : parts) part.slices.assign(slices, 0);
  eachPart([&](Part& part) {
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
    for (Part& part : parts) next += std::exchange(part.slices[slice], next);
    waiting.push_back({begin, next});
  }
  std::reverse(waiting.begin(), waiting.end());
  eachPart([&](Part& part) {
    for (std::size_t i = part.begin; i < part.end; ++i) {
      dealt[part.slices[slices == 1 ? 0 : sliceOf(found[i].key)]++] = found[i];
    }
  });
}

// Makes two of a slice, each in the order of slots.
void CpuRasterizer::Work::halve(const Slice& slice) {
  Candidate* const begin = &dealt[slice.begin];
  Candidate* const end = begin + (slice.end - slice.begin);
  const auto bySlot = [](const Candidate& a, const Candidate& b) { return a.index < b.index; };
  Candidate* const middle = begin + (end - begin) / 2;
  std::nth_element(begin, middle, end, [](const Candidate& a, const Candidate& b) {
    return a.key != b.key ? a.key < b.key : a.index < b.index;
  });
  std::sort(begin, middle, bySlot);
  std::sort(middle, end, bySlot);
  const std::size_t half = slice.begin + std::size_t(middle - begin);
  waiting.push_back({half, slice.end});
  waiting.push_back({slice.begin, half});
}

// Up to which depth each tile may show something, before the first splat is blended.
void CpuRasterizer::Work::openTiles(const PictureRequest& request) {
  const int across = project_view.tiles_across, down = project_view.tiles_down;
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
  inParts(tiles, 256, [&](const Part& part, Member&) {
    for (std::size_t tile = part.begin; tile < part.end; ++tile) {
      const TileRect rect(tile, across, request.camera.width, request.camera.height);
      float farthest = 0;
      rect.forEach([&](std::size_t, std::size_t pixel) {
        farthest = std::max(farthest, request.scene_depth[pixel]);
      });
      open[tile] = farthest;
    }
  });
}

void CpuRasterizer::Work::raisePyramid() {
  int w = project_view.tiles_across, h = project_view.tiles_down;
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

// Whether all that a page may hold lies behind what tiles may still show.
bool CpuRasterizer::Work::hidden(const SlotPage& page) const {
  const ProjectView& v = project_view;
  float centre[3], half[3];  // of a box around it, as the camera sees it [m]
  for (int axis = 0; axis < 3; ++axis) {
    const float* const row = v.rotation + 3 * axis;
    centre[axis] = v.translation[axis];
    half[axis] = 0;
    for (int i = 0; i < 3; ++i) {
      centre[axis] += row[i] * 0.5f * (page.least[i] + page.most[i]);
      half[axis] += std::fabs(row[i]) * 0.5f * (page.most[i] - page.least[i]);
    }
    half[axis] += 1e-5f * (std::fabs(centre[axis]) + half[axis]);  // for rounding
  }
  const float nearest = centre[2] - half[2], farthest = centre[2] + half[2];
  if (!v.orthographic && nearest <= v.near_clip) return false;
  const float ndc = (v.ndc_scale * nearest + v.ndc_offset) / (v.orthographic ? 1 : nearest);
  const float window_depth = 0.5f * std::min(ndc, 1.0f) + 0.5f;
  const auto tilesAlong = [&](int axis, float focal, float middle, float slope, int count) {
    constexpr float kMargin = 3;  // of the low-pass filter, and for rounding [px]
    const float least = centre[axis] - half[axis], most = centre[axis] + half[axis];
    const float over_near = v.orthographic ? 1 : 1 / nearest;
    const float over_far = v.orthographic ? 1 : 1 / farthest;
    const float reach = slope * page.extent * over_near + kMargin;
    const auto tile = [&](float pixel) {
      return int(std::clamp(pixel / kTile, 0.0f, float(count - 1)));
    };
    return std::pair(tile(focal * std::min(least * over_near, least * over_far) + middle - reach),
                     tile(focal * std::max(most * over_near, most * over_far) + middle + reach));
  };
  auto [left, right] = tilesAlong(0, v.fx, v.cx, cull_view.slope_x, v.tiles_across);
  auto [top, bottom] = tilesAlong(1, v.fy, v.cy, cull_view.slope_y, v.tiles_down);
  int level = 0;
  for (; right - left > 1 || bottom - top > 1; ++level)
    left /= 2, right /= 2, top /= 2, bottom /= 2;
  const float* const open_here = &open[std::size_t(pyramid.begins[level])];
  const int width = pyramid.widths[level];
  return window_depth >
         std::max(std::max(open_here[top * width + left], open_here[top * width + right]),
                  std::max(open_here[bottom * width + left], open_here[bottom * width + right]));
}

// Pairs a record with its tiles.
void CpuRasterizer::Work::findTiles(const Footprint& f, std::uint32_t record, Part& part) const {
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
    const int begin = row * project_view.tiles_across;
    for (int tile = begin + first; tile < begin + last; ++tile) {
      if (until && window_depth > until[tile]) continue;
      *out++ = {std::uint32_t(tile), record};
      ++counts[tile];
    }
  }
  part.pairs.size = std::size_t(out - part.pairs.pairs.get());
}

// Projects a slice and finds its splats' tiles; false where there are too many pairs.
bool CpuRasterizer::Work::project(const Slice& slice) {
  const std::size_t begin = slice.begin, end = slice.end;
  records.reserve(end - begin + kSlots);
  keys.reserve(end - begin + kSlots);
  std::atomic<std::size_t> pairs{0};
  inParts(end - begin, 4096, [&](Part& part, Member& member) {
    part.counts.assign(tiles, 0);
    part.pairs.size = 0;
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
      if (hides && hidden(*bounds[page])) continue;
      if (hides) {
        count = kernels.hide(cull_view, project_view, pyramid, pages[page], member.places.data(),
                             member.numbers.data(), count);
      }
      const std::size_t seen =
          kernels.project(project_view, pages[page], member.places.data(), count, &records[out],
                          member.footprints.data(), member.kept.data());
      const std::size_t before = part.pairs.size;
      for (std::size_t k = 0; k < seen; ++k, ++out) {
        const std::uint16_t number = member.kept[k];
        keys[out] = run[hides ? member.numbers[number] : number].key;
        findTiles(member.footprints[k], static_cast<std::uint32_t>(out), part);
      }
      pairs += part.pairs.size - before;
    }
    part.drawn = out - part.begin;
  });
  total_pairs = pairs;
  return pairs <= kMostPairs;
}

// Lists each tile's splats, in the order of their slots.
void CpuRasterizer::Work::list() {
  listed.reserve(total_pairs);
  begins.assign(tiles + 1, 0);
  std::size_t next = 0;
  for (std::size_t tile = 0; tile < tiles; ++tile) {
    begins[tile] = next;
    for (Part& part : parts) {
      next += std::exchange(part.counts[tile], static_cast<std::uint32_t>(next));
    }
  }
  begins[tiles] = next;
  team->run(unsigned(parts.size()), [&](unsigned number, unsigned) {
    Part& part = parts[number];
    for (std::size_t i = 0; i < part.pairs.size; ++i) {
      const Pair pair = part.pairs.pairs[i];
      listed[part.counts[pair.tile]++] = {keys[pair.record], pair.record};
    }
  });
}

// Sorts a tile's splats, nearest first; returns how many there are.
std::size_t CpuRasterizer::Work::inTile(std::size_t tile, Member& member) {
  const std::size_t count = begins[tile + 1] - begins[tile];
  sortByKey(&listed[begins[tile]], count, member.spare.reserve(count));
  return count;
}

void CpuRasterizer::Work::blend(const PictureRequest& request, SplatPicture& picture, bool first,
                                std::size_t number, Member& member) {
  const DrawMode mode = request.settings.mode;
  const TileRect rect(number, project_view.tiles_across, picture.width, picture.height);
  const bool divided = !request.translucent_depth.empty();
  BlendTile tile;
  tile.count = inTile(number, member);
  if (tile.count == 0 && !first) return;
  // What was blended so far is in the picture.
  const auto read = [&](TilePixels& pixels, const std::vector<float>& colour) {
    std::memset(&pixels, 0, sizeof(pixels));
    rect.forEach([&](std::size_t i, std::size_t pixel) {
      pixels.transmittance[i] = first ? 1 : 1 - colour[4 * pixel + 3];
      for (int k = 0; k < 3 && !first; ++k) pixels.colour[k][i] = colour[4 * pixel + k];
    });
  };
  read(member.pixels, picture.colour);
  if (request.mean_depth && !first) {
    rect.forEach(
        [&](std::size_t i, std::size_t pixel) { member.pixels.depth[i] = picture.depth[pixel]; });
  }
  if (divided) {
    read(member.behind, picture.behind);
    rect.forEach([&](std::size_t i, std::size_t pixel) {
      if (!first) member.behind.depth[i] = picture.nearness[2 * pixel];
    });
  }

  tile.listed = &listed[begins[number]];
  tile.records = records.get();
  tile.left = rect.left;
  tile.top = rect.top;
  tile.ends_at = kTransparent;
  tile.pixels = &member.pixels;
  tile.behind = divided ? &member.behind : nullptr;
  tile.opaque = depthsOf(request.scene_depth, rect, member.opaque);
  tile.divided = depthsOf(request.translucent_depth, rect, member.divided);
  const bool ended =
      kernels.blend(tile, drawsBalls(mode), mode == DrawMode::kGaussianBall, request.mean_depth);
  if (ended) open[number] = kEnded;

  const auto write = [&](const TilePixels& pixels, std::vector<float>& colour) {
    rect.forEach([&](std::size_t i, std::size_t pixel) {
      float* const rgba = &colour[4 * pixel];
      for (int k = 0; k < 3; ++k) rgba[k] = pixels.colour[k][i];
      rgba[3] = 1 - pixels.transmittance[i];
    });
  };
  write(member.pixels, picture.colour);
  if (request.mean_depth) {
    rect.forEach(
        [&](std::size_t i, std::size_t pixel) { picture.depth[pixel] = member.pixels.depth[i]; });
  }
  if (divided) {
    write(member.behind, picture.behind);
    rect.forEach([&](std::size_t i, std::size_t pixel) {
      picture.nearness[2 * pixel] = member.behind.depth[i];
      picture.nearness[2 * pixel + 1] = 1 - member.behind.transmittance[i];
    });
  }
}

void CpuRasterizer::Work::pick(const PictureRequest& request, std::vector<std::uint32_t>& picked,
                               bool first, std::size_t number, Member& member) {
  const SplatCamera& camera = request.camera;
  const DrawMode mode = request.settings.mode;
  const TileRect rect(number, project_view.tiles_across, camera.width, camera.height);
  PickTile tile;
  tile.count = inTile(number, member);
  if (tile.count == 0 && !first) return;
  tile.listed = &listed[begins[number]];
  tile.records = records.get();
  tile.left = rect.left;
  tile.top = rect.top;
  tile.opaque = depthsOf(request.scene_depth, rect, member.opaque);
  tile.transmittance = member.pixels.transmittance;
  tile.most = member.most;
  tile.slot = member.slots;
  std::fill_n(tile.transmittance, kTilePixels, 0.0f);
  rect.forEach([&](std::size_t i, std::size_t pixel) {
    tile.transmittance[i] = first ? 1 : picking[2 * pixel];
    tile.most[i] = first ? kLeastPicked : picking[2 * pixel + 1];
    tile.slot[i] = first ? kNoSlot : picked[pixel];
  });
  const bool ended = kernels.pick(tile, drawsBalls(mode));
  if (ended) open[number] = kEnded;
  rect.forEach([&](std::size_t i, std::size_t pixel) {
    picking[2 * pixel] = tile.transmittance[i];
    picking[2 * pixel + 1] = tile.most[i];
    picked[pixel] = tile.slot[i];
  });
}

void CpuRasterizer::Work::contribute(const PictureRequest& request, const SplatPicture& picture,
                                     bool first, std::size_t number, Member& member) {
  const TileRect rect(number, project_view.tiles_across, picture.width, picture.height);
  ContributeTile tile;
  tile.count = inTile(number, member);
  if (tile.count == 0 && !first) return;
  tile.listed = &listed[begins[number]];
  tile.records = records.get();
  tile.left = rect.left;
  tile.top = rect.top;
  tile.ends_at = kTransparent;
  tile.opaque = depthsOf(request.scene_depth, rect, member.opaque);
  tile.pixels = &member.pixels;
  tile.splats = &of_listed[begins[number]];
  std::memset(&member.pixels, 0, sizeof(member.pixels));
  rect.forEach([&](std::size_t i, std::size_t pixel) {
    member.pixels.transmittance[i] = first ? 1 : remaining[4 * pixel + 3];
    for (int k = 0; k < 3; ++k) {
      member.pixels.colour[k][i] = first ? picture.colour[4 * pixel + k] : remaining[4 * pixel + k];
    }
  });
  if (kernels.contribute(tile)) open[number] = kEnded;
  rect.forEach([&](std::size_t i, std::size_t pixel) {
    for (int k = 0; k < 3; ++k) remaining[4 * pixel + k] = member.pixels.colour[k][i];
    remaining[4 * pixel + 3] = member.pixels.transmittance[i];
  });
}

// Tile by tile, so that sums are the same for any number of threads.
void CpuRasterizer::Work::addUp(Contributions& contributions) const {
  for (std::size_t i = 0; i < total_pairs; ++i) {
    const std::uint32_t slot = records[listed[i].record].slot;
    contributions.weight[slot] += of_listed[i].weight;
    contributions.error[slot] += of_listed[i].error;
  }
}

// Of mode kDepth without a range: that of all that is in the picture.
void CpuRasterizer::Work::findDepthRange() {
  if (project_view.mode != static_cast<int>(DrawMode::kDepth) ||
      project_view.depth_range[1] > project_view.depth_range[0]) {
    return;
  }
  float nearest = std::numeric_limits<float>::infinity(), farthest = -nearest;
  for (const Slice& slice : waiting) {
    project(slice);
    for (const Part& part : parts) {
      for (std::size_t i = part.begin; i < part.begin + part.drawn; ++i) {
        nearest = std::min(nearest, records[i].depth);
        farthest = std::max(farthest, records[i].depth);
      }
    }
  }
  project_view.depth_range[0] = nearest;
  project_view.depth_range[1] = farthest;
}

bool CpuRasterizer::Work::run(const HostSlots& slots, const MapState& map,
                              const PictureRequest& request, const Wanted& wanted) {
  SplatPicture* const picture = wanted.picture;
  cancel = request.cancelled;
  out_of_memory = false;
  profile.clear();
  began = Clock::now();
  const SplatCamera& camera = request.camera;
  if (std::min(camera.width, camera.height) < 1 ||
      std::max(camera.width, camera.height) > kLongestSide) {
    throw PictureError("a picture of " + std::to_string(camera.width) + " x " +
                       std::to_string(camera.height) + " pixels can't be drawn, only 1 to " +
                       std::to_string(kLongestSide));
  }
  const std::size_t pixels = std::size_t(camera.width) * std::size_t(camera.height);
  for (const ArrayView<float>* depths : {&request.scene_depth, &request.translucent_depth}) {
    if (!depths->empty() && depths->size != pixels) {
      throw PictureError("depths of " + std::to_string(depths->size) +
                         " pixels do not fit a picture of " + std::to_string(pixels));
    }
  }
  if (wanted.contributions) {
    remaining.resize(4 * pixels);
    wanted.contributions->weight.assign(map.capacity, 0);
    wanted.contributions->error.assign(map.capacity, 0);
  } else if (picture) {
    picture->width = camera.width;
    picture->height = camera.height;
    picture->colour.resize(4 * pixels);
    picture->depth.resize(request.mean_depth ? pixels : 0);
    picture->behind.resize(request.translucent_depth.empty() ? 0 : 4 * pixels);
    picture->nearness.resize(request.translucent_depth.empty() ? 0 : 2 * pixels);
  } else {
    wanted.picked->resize(pixels);
    picking.resize(2 * pixels);
  }
  setViews(slots, map, request);
  double error = request.levels ? request.error : 0;
  while (true) {
    choosePages(slots, map, request, error);
    cull();
    if (error == 0 || candidates <= request.most_splats || error > kMostError || cancelled()) break;
    error *= std::clamp(std::sqrt(double(candidates) / double(request.most_splats)), 1.01, 2.0);
  }
  if (cancelled()) return false;
  deal();
  lap("cull");
  openTiles(request);
  findDepthRange();
  std::size_t drawn = 0;
  bool first = true;
  while (!waiting.empty()) {
    const Slice slice = waiting.back();
    waiting.pop_back();
    if (hides) raisePyramid();
    const bool fits = project(slice);
    lap("project");
    if (cancelled()) return false;
    if (!fits && slice.end - slice.begin > 1) {
      halve(slice);
      continue;
    }
    list();
    lap("list");
    if (wanted.contributions) of_listed.reserve(total_pairs);
    std::atomic<std::size_t> next{0};
    team->run(unsigned(members.size()), [&](unsigned, unsigned number) {
      Member& member = members[number];
      try {
        for (std::size_t tile; (tile = next++) < tiles && !cancelled();) {
          if (wanted.contributions) {
            contribute(request, *picture, first, tile, member);
          } else if (picture) {
            blend(request, *picture, first, tile, member);
          } else {
            pick(request, *wanted.picked, first, tile, member);
          }
        }
      } catch (const std::bad_alloc&) {
        out_of_memory = true;
      }
    });
    if (out_of_memory) throw std::bad_alloc();
    if (cancelled()) return false;
    if (wanted.contributions) addUp(*wanted.contributions);
    lap("blend");
    for (const Part& part : parts) drawn += part.drawn;
    first = false;
    hides = hides || std::find(open.begin(), open.begin() + std::ptrdiff_t(tiles), kEnded) !=
                         open.begin() + std::ptrdiff_t(tiles);
  }
  if (picture && !wanted.contributions) {
    inParts(picture->depth.size(), 1 << 14, [&](const Part& part, Member&) {
      for (std::size_t i = part.begin; i < part.end; ++i) {
        const float alpha = picture->colour[4 * i + 3];
        picture->depth[i] =
            alpha > 0 ? picture->depth[i] / alpha : std::numeric_limits<float>::quiet_NaN();
      }
    });
    picture->drawn = drawn;
    picture->error = error;
    picture->profile = profile;
  }
  return true;
}

CpuRasterizer::CpuRasterizer(std::shared_ptr<rosplat_sorter::ThreadTeam> team,
                             Instructions instructions)
    : work_(std::make_unique<Work>(std::move(team), kernelsFor(instructions))) {}

CpuRasterizer::~CpuRasterizer() = default;

namespace {

// Runs something that may find no memory.
template <typename Run>
bool orSay(const SplatCamera& camera, const Run& run) {
  try {
    return run();
  } catch (const std::bad_alloc&) {
  } catch (const std::length_error&) {
  }
  throw PictureError("there is no memory for a picture of " + std::to_string(camera.width) + " x " +
                     std::to_string(camera.height) + " pixels");
}

}  // namespace

bool CpuRasterizer::draw(const HostSlots& slots, const MapState& map, const PictureRequest& request,
                         SplatPicture& picture) {
  return orSay(request.camera, [&] { return work_->run(slots, map, request, {&picture}); });
}

std::vector<std::uint32_t> CpuRasterizer::pick(const HostSlots& slots, const MapState& map,
                                               const PictureRequest& request) {
  std::vector<std::uint32_t> picked;
  const bool whole =
      orSay(request.camera, [&] { return work_->run(slots, map, request, {nullptr, &picked}); });
  if (!whole) picked.clear();
  return picked;
}

bool CpuRasterizer::contribute(const HostSlots& slots, const MapState& map,
                               const PictureRequest& request, SplatPicture& picture,
                               Contributions& contributions) {
  PictureRequest in_colour = request;
  in_colour.settings.mode = DrawMode::kColor;
  in_colour.translucent_depth = {};
  return draw(slots, map, in_colour, picture) && orSay(request.camera, [&] {
           return work_->run(slots, map, in_colour, {&picture, nullptr, &contributions});
         });
}

const char* CpuRasterizer::instructions() const { return work_->kernels.name; }

std::size_t CpuRasterizer::bytes() const {
  const Work& w = *work_;
  std::size_t bytes = w.ranks.bytes() + w.found.bytes() + w.dealt.bytes() + w.records.bytes() +
                      w.keys.bytes() + w.listed.bytes() + w.of_listed.bytes() +
                      w.begins.capacity() * sizeof(w.begins[0]) +
                      w.pages.capacity() * sizeof(w.pages[0]);
  for (const Part& part : w.parts) {
    bytes += part.counts.capacity() * sizeof(part.counts[0]) + part.pairs.room * sizeof(Pair);
  }
  for (const Work::Member& member : w.members) bytes += sizeof(member) + member.spare.bytes();
  return bytes;
}

void toHalves(const std::vector<float>& values, std::vector<std::uint16_t>& halves) {
  halves.resize(values.size());
  kernelsFor(CpuRasterizer::Instructions::kBest)
      .toHalves(values.data(), values.size(), halves.data());
}

}  // namespace rosplat
