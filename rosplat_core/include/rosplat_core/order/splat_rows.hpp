#pragma once

#include <cstddef>
#include <utility>
#include <vector>

#include "rosplat_core/map/slot_pages.hpp"

namespace rosplat {

// What sorting needs of a map: centres and extents, in rows. Each page of the map has a row for
// each of its slots, by its place.
class SplatRows {
 public:
  // Runs of rows: first, count.
  using Runs = std::vector<std::pair<std::size_t, std::size_t>>;

  // Returns the rows that changed. Throws std::bad_alloc: then the rows are as they were.
  Runs apply(const GaussianEdit& edit);

  const SlotPages& pages() const { return pages_; }
  std::size_t size() const { return extents_.size(); }
  // 3 a row, relative to the origin of the page's group. [m]
  const float* positions() const { return positions_.data(); }
  // As GaussianEdit::extents; -1 in an empty slot. [m]
  const float* extents() const { return extents_.data(); }
  std::size_t bytes() const {
    return (positions_.capacity() + extents_.capacity()) * sizeof(float) + pages_.bytes();
  }

  static std::size_t rowOf(const SlotPage& page) {
    return std::size_t{page.place} * SlotPage::kSlots;
  }

 private:
  SlotPages pages_;
  std::vector<float> positions_, extents_;
};

}  // namespace rosplat
