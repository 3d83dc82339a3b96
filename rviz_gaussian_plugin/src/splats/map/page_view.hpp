#pragma once

#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "map/group_view.hpp"
#include "map/render_settings.hpp"
#include "map/slot_pages.hpp"
#include "rosplat_sorter/depth_order.hpp"

namespace rosplat {

// Which pages of a group a view may show: those of which a splat could pass the sorters' test of
// single splats (depth_order.hpp's visible(), splat_cull.comp), by their bounds alone.
class PageView {
 public:
  // The group's; box: what is kept of the map.
  PageView(const rosplat_sorter::View& view, const GroupView& group, const ClipBox& box);

  bool mayShow(const SlotPage& page) const;
  // Nearly the same of single splats, side by side: 1 or 0.
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

}  // namespace rosplat
