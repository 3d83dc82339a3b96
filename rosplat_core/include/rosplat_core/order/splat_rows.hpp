#pragma once

#include <cstddef>
#include <utility>
#include <vector>

#include "rosplat_core/map/slot_pages.hpp"

namespace rosplat {

// The part of a map that sorting needs: centres and extents, in rows. Each slot of the map's pages
// has a row: see rowOf().
class SplatRows {
 public:
  // Runs of rows: first, count.
  using Runs = std::vector<std::pair<std::size_t, std::size_t>>;

  // Applies an edit; returns the rows that changed. If it throws std::bad_alloc, nothing changed.
  Runs apply(const GaussianEdit& edit);

  const SlotPages& pages() const { return pages_; }
  std::size_t size() const { return extents_.size(); }
  // 3 numbers a row, relative to the origin of the page's group [m].
  const float* positions() const { return positions_.data(); }
  // As GaussianEdit::extents; -1 for an empty slot [m].
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
