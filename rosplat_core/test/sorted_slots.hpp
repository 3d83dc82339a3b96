#pragma once

#include <cstdint>
#include <vector>

#include "rosplat_core/order/depth_order.hpp"

namespace rosplat {

// The order of the slots from 0 on, of one view: in pages without gaps, the last filled up with
// empty slots.
inline std::vector<std::uint32_t> sortedSlots(DepthOrder& sorter, const SortView& view,
                                              std::vector<float> positions,
                                              std::vector<float> extents) {
  std::vector<SortPage> pages;
  for (std::uint32_t slot = 0; slot < extents.size(); slot += SortPage::kSlots) {
    pages.push_back({slot, slot / SortPage::kSlots});
  }
  extents.resize(pages.size() * SortPage::kSlots, -1.0f);
  positions.resize(3 * extents.size());
  std::vector<std::uint32_t> order;
  sorter.sort(&view, positions.data(), extents.data(), pages.data(), pages.size(),
              [&](std::size_t total) {
                order.resize(total);
                return order.data();
              });
  return order;
}

}  // namespace rosplat
