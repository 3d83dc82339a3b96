#include "rosplat_core/views/page_view.hpp"

#include <cmath>

namespace rosplat {

namespace {

// Factor on extents: those that the graphics card unpacks may be larger than the map's.
constexpr double kPacked = 1.02;

}  // namespace

PageView::PageView(const SortView& view, const GroupView& group, const ClipBox& box)
    : clips_(box.enabled) {
  const float* r = view.rotation;
  const float* t = view.translation;
  // Adds the side factor * (x or y) + of_w * w <= slope * extent in camera axes, w = z or 1.
  const auto side = [&](int axis, double factor, double of_w, double slope) {
    std::array<double, 4> sum{}, terms{};
    for (int i = 0; i < 4; ++i) {
      const double along = i < 3 ? r[3 * axis + i] : t[axis];
      const double w = view.orthographic ? double(i == 3) : i < 3 ? r[6 + i] : t[2];
      sum[i] = factor * along + of_w * w;
      terms[i] = std::fabs(factor * along) + std::fabs(of_w * w);
    }
    add(sum, terms, slope);
  };
  for (const double sign : {1.0, -1.0}) {
    side(0, sign * view.fx, sign * view.offset_x - view.half_width, view.slope_x);
    side(1, sign * view.fy, sign * view.offset_y - view.half_height, view.slope_y);
  }
  const auto depth = [&](double sign, double limit) {
    add({sign * r[6], sign * r[7], sign * r[8], sign * t[2] + limit},
        {std::fabs(r[6]), std::fabs(r[7]), std::fabs(r[8]), std::fabs(t[2])}, 0);
  };
  depth(-1, view.near_clip);
  depth(1, -double(view.far_clip));
  for (int i = 0; i < 3; ++i) {
    const float* const row = group.to_box[i];
    const double half = 0.5 * box.size[i];
    slabs_[i] = {
        {row[0], row[1], row[2]}, row[3], half + kPageRounding * (std::fabs(row[3]) + half)};
  }
}

void PageView::add(const std::array<double, 4>& side, const std::array<double, 4>& terms,
                   double slope) {
  planes_[count_++] = {
      {side[0], side[1], side[2]},
      {kPageRounding * terms[0], kPageRounding * terms[1], kPageRounding * terms[2]},
      side[3] - kPageRounding * terms[3],
      kPacked * slope};
}

bool PageView::mayShow(const SlotPage& page) const {
  PageBounds<1> bounds;
  bounds.put(0, page);
  return mayShow(bounds)[0];
}

std::uint32_t PageView::sidesAcross(const SlotPage& bounds) const {
  std::uint32_t sides = 0;
  for (std::size_t side = 0; side < count_; ++side) {
    double most = planes_[side].offset;
    for (std::size_t axis = 0; axis < 3; ++axis) {
      const double normal = planes_[side].normal[axis];
      most += normal * (normal > 0 ? bounds.most : bounds.least)[axis];
    }
    sides |= std::uint32_t(!(most <= 0)) << side;
  }
  return sides;
}

}  // namespace rosplat
