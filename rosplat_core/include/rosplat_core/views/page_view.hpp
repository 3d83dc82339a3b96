#pragma once

#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>

#include "rosplat_core/map/slot_pages.hpp"
#include "rosplat_core/views/group_view.hpp"
#include "rosplat_core/views/render_settings.hpp"
#include "rosplat_core/views/sort_view.hpp"

namespace rosplat {

// Whether a bound of a page proves that all of the page lies beyond a limit. A bound that float32
// can't hold, infinite or NaN, proves nothing: the slots of such a page are tested one by one.
inline bool isBeyond(float bound, float limit) {
  return (bound > limit) & (bound <= std::numeric_limits<float>::max());
}

// SlotPage's bounds of several pages side by side, so that a processor tests several at once.
template <std::size_t N>
struct PageBounds {
  template <typename T>
  using Each = std::array<T, N>;

  std::array<Each<float>, 3> least, most;
  Each<float> extent;

  void put(std::size_t i, const SlotPage& page) {
    for (std::size_t axis = 0; axis < 3; ++axis) {
      least[axis][i] = page.least[axis];
      most[axis][i] = page.most[axis];
    }
    extent[i] = page.extent;
  }
};

// Bound of the rounding errors of float32, here and in shaders, relative to the sum of the terms'
// magnitudes: some 8 operations each.
constexpr double kPageRounding = 2e-6;

// Finds, by bounds alone, which pages of a group a view may show: those where a splat could pass
// the sorters' test of single splats (depth_order.hpp's visible(), splat_cull.comp).
class PageView {
 public:
  // view, group: of the group that the pages belong to.
  PageView(const SortView& view, const GroupView& group, const ClipBox& box);

  bool mayShow(const SlotPage& page) const;
  // Returns 1 or 0 for each of several pages. sides: which sides of the view to test, as bits.
  template <std::size_t N>
  std::array<std::uint32_t, N> mayShow(const PageBounds<N>& pages, std::uint32_t sides = ~0u) const;
  // Returns, as bits, the sides of the view that some of the bounds lies beyond. Pages within the
  // bounds need no test against the other sides.
  std::uint32_t sidesAcross(const SlotPage& bounds) const;
  // Returns 1 or 0 for each of several single splats; approximate near the view's edges. Positions
  // that float32 can't hold aren't shown, as in the sorters.
  template <std::size_t N>
  std::array<std::uint32_t, N> mayShow(const std::array<std::array<float, N>, 3>& means,
                                       const std::array<float, N>& extents) const;

 private:
  // A splat passes where normal . mean + offset <= slope * extent.
  struct Plane {
    std::array<double, 3> normal, rounding;  // rounding: error of float32 per metre of a coordinate
    double offset, slope;
  };

  void add(const std::array<double, 4>& side, const std::array<double, 4>& terms, double slope);

  std::array<Plane, 6> planes_;
  std::size_t count_ = 0;
  // A splat passes the clip box where |axis . mean + offset| <= half, for each axis.
  struct Slab {
    std::array<double, 3> axis;
    double offset, half;
  };
  bool clips_;
  std::array<Slab, 3> slabs_{};
};

template <std::size_t N>
std::array<std::uint32_t, N> PageView::mayShow(const std::array<std::array<float, N>, 3>& means,
                                               const std::array<float, N>& extents) const {
  const auto along = [&means](const std::array<double, 3>& axis, double offset, std::size_t i) {
    return float(axis[0]) * means[0][i] + float(axis[1]) * means[1][i] +
           float(axis[2]) * means[2][i] + float(offset);
  };
  std::array<std::uint32_t, N> shows;
  for (std::size_t i = 0; i < N; ++i) shows[i] = extents[i] >= 0;
  for (const Plane& plane : planes_) {
    const float slope = static_cast<float>(plane.slope);
    for (std::size_t i = 0; i < N; ++i) {
      shows[i] &= along(plane.normal, plane.offset, i) <= slope * extents[i];
    }
  }
  for (const Slab& slab : slabs_) {
    if (!clips_) break;
    const float half = static_cast<float>(slab.half);
    for (std::size_t i = 0; i < N; ++i) {
      shows[i] &= std::fabs(along(slab.axis, slab.offset, i)) <= half;
    }
  }
  return shows;
}

template <std::size_t N>
std::array<std::uint32_t, N> PageView::mayShow(const PageBounds<N>& pages,
                                               std::uint32_t sides) const {
  std::array<std::array<float, N>, 3> centre, half, size;
  for (std::size_t axis = 0; axis < 3; ++axis) {
    for (std::size_t i = 0; i < N; ++i) {
      centre[axis][i] = 0.5f * (pages.least[axis][i] + pages.most[axis][i]);
      half[axis][i] = 0.5f * (pages.most[axis][i] - pages.least[axis][i]);
      size[axis][i] = std::fabs(centre[axis][i]) + half[axis][i];
    }
  }
  std::array<std::uint32_t, N> shows;
  for (std::size_t i = 0; i < N; ++i) shows[i] = pages.extent[i] >= 0;
  for (const Slab& slab : slabs_) {
    if (!clips_) break;
    std::array<float, N> middle, reach;
    middle.fill(static_cast<float>(slab.offset));
    reach.fill(static_cast<float>(slab.half));
    for (std::size_t axis = 0; axis < 3; ++axis) {
      const float along = static_cast<float>(slab.axis[axis]), length = std::fabs(along);
      for (std::size_t i = 0; i < N; ++i) {
        middle[i] += along * centre[axis][i];
        reach[i] += length * (half[axis][i] + float(kPageRounding) * size[axis][i]);
      }
    }
    for (std::size_t i = 0; i < N; ++i) shows[i] &= !isBeyond(std::fabs(middle[i]), reach[i]);
  }
  for (std::size_t side = 0; side < count_; ++side) {
    if ((sides >> side & 1u) == 0) continue;
    const Plane& plane = planes_[side];
    std::array<float, N> least;
    least.fill(static_cast<float>(plane.offset));
    for (std::size_t axis = 0; axis < 3; ++axis) {
      const float normal = static_cast<float>(plane.normal[axis]), length = std::fabs(normal);
      const float rounding = static_cast<float>(plane.rounding[axis]);
      for (std::size_t i = 0; i < N; ++i) {
        least[i] += normal * centre[axis][i] - length * half[axis][i] - rounding * size[axis][i];
      }
    }
    const float slope = static_cast<float>(plane.slope);
    for (std::size_t i = 0; i < N; ++i) shows[i] &= !isBeyond(least[i], slope * pages.extent[i]);
  }
  return shows;
}

}  // namespace rosplat
