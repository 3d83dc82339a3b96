#pragma once

#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "rosplat_core/map/slot_pages.hpp"
#include "rosplat_core/views/group_view.hpp"
#include "rosplat_core/views/page_bounds.hpp"
#include "rosplat_core/views/render_settings.hpp"
#include "rosplat_core/views/sort_view.hpp"

namespace rosplat {

// Of what float32 rounds here and in shaders, relative to all that is summed up: some 8 operations
// each.
constexpr double kPageRounding = 2e-6;

// Which pages of a group a view may show: those of which a splat could pass the sorters' test of
// single splats (depth_order.hpp's visible(), splat_cull.comp), by their bounds alone.
class PageView {
 public:
  // The group's; box: what is kept of the map.
  PageView(const SortView& view, const GroupView& group, const ClipBox& box);

  bool mayShow(const SlotPage& page) const;
  // Of each of several: 1 or 0. sides: those of the view to test, as bits.
  template <std::size_t N>
  std::array<std::uint32_t, N> mayShow(const PageBounds<N>& pages, std::uint32_t sides = ~0u) const;
  // The sides of the view, as bits, that don't have all within some bounds on their inner side:
  // pages within them need no test against the others.
  std::uint32_t sidesAcross(const SlotPage& bounds) const;
  // Nearly the same of single splats, side by side: 1 or 0. What float32 can't hold isn't shown, as
  // the sorters have it.
  template <std::size_t N>
  std::array<std::uint32_t, N> mayShow(const std::array<std::array<float, N>, 3>& means,
                                       const std::array<float, N>& extents) const;

 private:
  // A splat passes where normal . mean + offset <= slope * extent.
  struct Plane {
    std::array<double, 3> normal, rounding;  // of float32, for each metre of a coordinate
    double offset, slope;
  };

  void add(const std::array<double, 4>& side, const std::array<double, 4>& terms, double slope);

  std::array<Plane, 6> planes_;
  std::size_t count_ = 0;
  // A mean is kept where its coordinates in the box are no larger than half of that.
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
