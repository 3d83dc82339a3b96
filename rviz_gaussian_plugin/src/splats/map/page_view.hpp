#pragma once

#include <array>

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

}  // namespace rosplat
