// The visible splats of a map, back to front: culling and an exact, stable radix sort by depth.
//
// All arithmetic is IEEE float32 with every operation rounded by itself, so that each sorter of the
// project finds the same order to the bit (the plain twin is rosplat_sorter/depth.py, which also
// derives the bounds used here). Compilers that fuse a * b + c, as GCC does for ARM, must be told
// not to: link the CMake target rosplat_sorter::depth_order, it carries -ffp-contract=off.

#ifndef ROSPLAT_SORTER__DEPTH_ORDER_HPP_
#define ROSPLAT_SORTER__DEPTH_ORDER_HPP_

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <memory>
#include <utility>
#include <vector>

#include "rosplat_sorter/thread_team.hpp"

#ifdef __FAST_MATH__
#error "depth_order.hpp relies on IEEE arithmetic: compile without -ffast-math"
#endif
#ifdef __clang__
#pragma STDC FP_CONTRACT OFF
#endif

namespace rosplat_sorter {

// A camera as the sorter needs it, in float32: what positions are multiplied with.
struct View {
  float rotation[9];              // map to camera optical frame, row-major
  float translation[3];           // [m]
  float fx, fy;                   // [px], orthographic [px/m]
  float offset_x, offset_y;       // principal point from the picture's centre [px]
  float half_width, half_height;  // of the picture, with a margin for the low-pass filter [px]
  float slope_x, slope_y;         // growth of a footprint with a splat's extent [px], ortho [px/m]
  float near_clip, far_clip;      // [m]
  bool orthographic;
};

// Half the low-pass filter's reach, 3.33 * sqrt(0.3) = 1.82 px, with room for rounding.
constexpr double kMarginPixels = 2.0;

// How much wider than the picture an order is culled: it is drawn for cameras that have moved on,
// and lacks what came in. 1.25 saves 18 dB after a turn of 3 degrees (docs/stability.md).
constexpr double kOverscan = 1.25;

// The View of a camera at rotation (map to camera optical frame, row-major) and translation (of the
// map's origin in the camera frame, [m]) with the intrinsics and the extent_scale of ViewCamera.
inline View makeView(const double rotation[9], const double translation[3], double fx, double fy,
                     double cx, double cy, double width, double height, double near_clip,
                     double far_clip, bool orthographic, double extent_scale = 1.0,
                     double overscan = kOverscan) {
  // A perspective footprint grows with the slope of its ray, which the renderer clamps so.
  const auto slope = [=](double focal, double centre, double size) {
    if (orthographic) return extent_scale * focal;
    const double tangent = std::max(size - centre, centre) / focal + 0.3 * (0.5 * size / focal);
    return extent_scale * focal * std::sqrt(1.0 + tangent * tangent);
  };
  View view;
  std::copy(rotation, rotation + 9, view.rotation);
  std::copy(translation, translation + 3, view.translation);
  view.fx = static_cast<float>(fx);
  view.fy = static_cast<float>(fy);
  view.offset_x = static_cast<float>(cx - width / 2.0);
  view.offset_y = static_cast<float>(cy - height / 2.0);
  view.half_width = static_cast<float>(overscan * width / 2.0 + kMarginPixels);
  view.half_height = static_cast<float>(overscan * height / 2.0 + kMarginPixels);
  view.slope_x = static_cast<float>(slope(fx, cx, width));
  view.slope_y = static_cast<float>(slope(fy, cy, height));
  view.near_clip = static_cast<float>(near_clip);
  view.far_clip = static_cast<float>(far_clip);
  view.orthographic = orthographic;
  return view;
}

// Orders splats by depth. Keeps its workspace and its threads between calls; one caller at a time.
class DepthOrder {
 public:
  // Threads to sort with, the caller's included; 0 takes as many as the machine runs at once.
  explicit DepthOrder(unsigned threads = 0) : DepthOrder(std::make_shared<ThreadTeam>(threads)) {}
  // With a team that others sort with, too.
  explicit DepthOrder(std::shared_ptr<ThreadTeam> team)
      : team_(std::move(team)), parts_(team_->size()) {
    // Here, where it may throw.
    for (Part& part : parts_) part.buckets.reserve(std::size_t{1} << kDigitBits);
  }

  unsigned threads() const { return team_->size(); }

  // The visible slots of [0, count), back to front; of equal depths the higher slot first.
  // positions: 3 * count [m]; extents: count [m], negative for what is never visible.
  // The result is valid until the next call.
  const std::vector<std::uint32_t>& sort(const View& view, const float* positions,
                                         const float* extents, std::size_t count) {
    sort(view, positions, extents, count, Keep{order_});
    return order_;
  }

  // The same into memory of the caller's: allocate(m) returns where the m visible slots go.
  template <typename Allocate>
  void sort(const View& view, const float* positions, const float* extents, std::size_t count,
            const Allocate& allocate) {
    sortSlots(
        view, positions, extents, count,
        [](std::size_t i) { return static_cast<std::uint32_t>(i); }, allocate);
  }

  // The same among the count given slots only, which are in ascending order.
  const std::vector<std::uint32_t>& sort(const View& view, const float* positions,
                                         const float* extents, const std::uint32_t* slots,
                                         std::size_t count) {
    sortSlots(
        view, positions, extents, count, [slots](std::size_t i) { return slots[i]; }, Keep{order_});
    return order_;
  }

  // The depth along the optical axis that sort() orders by. [m]
  static float depth(const View& view, const float* position) {
    return transform(view, 2, position);
  }

 private:
  struct Entry {
    std::uint32_t key;
    std::uint32_t slot;
  };

  // Allocates memory of the sorter's own.
  struct Keep {
    std::vector<std::uint32_t>& order;
    std::uint32_t* operator()(std::size_t total) const {
      order.resize(total);
      return order.data();
    }
  };

  // What one thread found: its entries start at begin.
  struct Part {
    std::size_t begin = 0;
    std::size_t end = 0;
    std::uint32_t least = 0;
    std::uint32_t greatest = 0;
    std::vector<std::size_t> buckets;
  };

  static constexpr std::size_t kBlock = 512;            // splats culled at a time, in L1
  static constexpr std::size_t kLeastShare = 1u << 15;  // splats worth waking a thread for
  static constexpr unsigned kDigitBits = 9;             // 512 buckets stay in L1 and its TLB

  static float transform(const View& view, int axis, const float* p) {
    const float* r = view.rotation + 3 * axis;
    return ((r[0] * p[0] + r[1] * p[1]) + r[2] * p[2]) + view.translation[axis];
  }

  // Whether any of a splat's footprint can touch the picture. Without branches, to vectorise.
  static bool visible(const View& view, float x, float y, float z, float extent) {
    const float w = view.orthographic ? 1.0f : z;
    const bool in_depth = (extent >= 0.0f) & (z > view.near_clip) & (z < view.far_clip);
    const bool in_width =
        std::fabs(view.fx * x + view.offset_x * w) <= view.half_width * w + view.slope_x * extent;
    const bool in_height =
        std::fabs(view.fy * y + view.offset_y * w) <= view.half_height * w + view.slope_y * extent;
    return in_depth & in_width & in_height;
  }

  // Unsigned integers that compare as the depths do.
  static std::uint32_t key(float depth) {
    depth += 0.0f;  // -0 and 0 are the same depth
    std::uint32_t bits;
    std::memcpy(&bits, &depth, sizeof(bits));
    const std::uint32_t negative = 0u - (bits >> 31);
    return bits ^ (negative | 0x80000000u);
  }

  template <typename SlotAt, typename Allocate>
  void sortSlots(const View& view, const float* positions, const float* extents, std::size_t count,
                 const SlotAt& slot_at, const Allocate& allocate) {
    if (count > capacity_) {
      capacity_ = count + count / 4;
      for (auto& buffer : entries_) buffer.reset(new Entry[capacity_]);
    }
    const auto members =
        static_cast<unsigned>(std::min<std::size_t>(team_->size(), 1 + count / kLeastShare));
    team_->run(members, [&](unsigned member) {
      Part& part = parts_[member];
      part.begin = count * member / members;
      part.end = count * (member + 1) / members;
      cull(view, positions, extents, slot_at, part);
    });
    sortEntries(members, allocate);
  }

  // Writes an entry for each visible splat of [part.begin, part.end) and shortens the part to them.
  template <typename SlotAt>
  void cull(const View& camera, const float* positions, const float* extents, const SlotAt& slot_at,
            Part& part) {
    const View view = camera;  // a copy that no store below can alias
    std::array<std::uint32_t, kBlock> keys;
    std::array<std::uint32_t, kBlock> seen;
    Entry* out = entries_[0].get() + part.begin;
    part.least = ~0u;
    part.greatest = 0;
    for (std::size_t first = part.begin; first < part.end; first += kBlock) {
      const std::size_t size = std::min(kBlock, part.end - first);
      for (std::size_t i = 0; i < size; ++i) {
        const std::size_t slot = slot_at(first + i);
        const float* p = positions + 3 * slot;
        const float z = transform(view, 2, p);
        keys[i] = key(z);
        seen[i] = visible(view, transform(view, 0, p), transform(view, 1, p), z, extents[slot]);
      }
      for (std::size_t i = 0; i < size; ++i) {
        *out = {keys[i], slot_at(first + i)};
        out += seen[i];
        part.least = std::min(part.least, seen[i] ? keys[i] : ~0u);
        part.greatest = std::max(part.greatest, seen[i] ? keys[i] : 0u);
      }
    }
    part.end = static_cast<std::size_t>(out - entries_[0].get());
  }

  // Least significant digit first radix sort of the entries, over the bits in which they differ.
  template <typename Allocate>
  void sortEntries(unsigned members, const Allocate& allocate) {
    std::size_t total = 0;
    std::uint32_t least = ~0u;
    std::uint32_t greatest = 0;
    for (unsigned member = 0; member < members; ++member) {
      const Part& part = parts_[member];
      total += part.end - part.begin;
      least = std::min(least, part.least);
      greatest = std::max(greatest, part.greatest);
    }
    std::uint32_t* const order = allocate(total);
    if (total == 0) return;

    unsigned bits = 0;
    while (bits < 32 && (greatest - least) >> bits != 0) ++bits;
    const unsigned passes = std::max(1u, (bits + kDigitBits - 1) / kDigitBits);
    const unsigned digit_bits = (bits + passes - 1) / passes;
    for (unsigned pass = 0; pass < passes; ++pass) {
      const Entry* from = entries_[pass % 2].get();
      Entry* to = entries_[(pass + 1) % 2].get();
      const unsigned shift = pass * digit_bits;
      const std::uint32_t mask = (1u << digit_bits) - 1;
      const auto digit = [=](const Entry& e) { return ((e.key - least) >> shift) & mask; };
      team_->run(members, [&](unsigned member) {
        Part& part = parts_[member];
        if (pass > 0) {  // the first pass reads what each thread found, the next ones equal shares
          part.begin = total * member / members;
          part.end = total * (member + 1) / members;
        }
        part.buckets.assign(std::size_t{mask} + 1, 0);
        for (std::size_t i = part.begin; i < part.end; ++i) ++part.buckets[digit(from[i])];
      });
      std::size_t next = 0;
      for (std::size_t bucket = 0; bucket <= mask; ++bucket) {
        for (unsigned member = 0; member < members; ++member) {
          const std::size_t size = parts_[member].buckets[bucket];
          parts_[member].buckets[bucket] = next;
          next += size;
        }
      }
      const bool last = pass + 1 == passes;
      team_->run(members, [&](unsigned member) {
        const Part& part = parts_[member];
        std::size_t* target = parts_[member].buckets.data();
        if (last) {  // ascending depth, read from its end, is back to front
          std::uint32_t* const nearest = order + total - 1;
          for (std::size_t i = part.begin; i < part.end; ++i) {
            nearest[-static_cast<std::ptrdiff_t>(target[digit(from[i])]++)] = from[i].slot;
          }
        } else {
          for (std::size_t i = part.begin; i < part.end; ++i)
            to[target[digit(from[i])]++] = from[i];
        }
      });
    }
  }

  std::shared_ptr<ThreadTeam> team_;
  std::vector<Part> parts_;  // one for each thread
  std::array<std::unique_ptr<Entry[]>, 2> entries_;
  std::size_t capacity_ = 0;
  std::vector<std::uint32_t> order_;
};

}  // namespace rosplat_sorter

#endif  // ROSPLAT_SORTER__DEPTH_ORDER_HPP_
