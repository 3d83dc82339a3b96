#include "rosplat_core/order/splat_rows.hpp"

#include <algorithm>

namespace rosplat {

SplatRows::Runs SplatRows::apply(const GaussianEdit& edit) {
  const bool writes = edit.sh_degree >= 0;
  // All allocations come first, so that a failure changes nothing.
  const std::vector<std::uint32_t> touched = SlotPages::touched(edit);
  std::size_t fresh = 0;
  for (const std::uint32_t slot : touched) fresh += edit.clear || !pages_.find(slot) ? 1 : 0;
  const std::size_t rows =
      (edit.clear ? 0 : size()) + (writes ? fresh * std::size_t{SlotPage::kSlots} : 0);
  Runs changed;
  changed.reserve(1 + edit.runs.size() + 2 * touched.size());
  if (edit.clear) {
    std::vector<float> positions, extents;
    positions.reserve(3 * rows);
    extents.reserve(rows);
    pages_.apply(edit);
    positions_ = std::move(positions);
    extents_ = std::move(extents);
  } else {
    // With room for a quarter more: doubling would take too much memory.
    if (3 * rows > positions_.capacity()) positions_.reserve(3 * (rows + rows / 4));
    if (rows > extents_.capacity()) extents_.reserve(rows + rows / 4);
    pages_.apply(edit);
  }
  positions_.resize(3 * rows);
  extents_.resize(rows, -1.0f);
  for (const std::uint32_t first_slot : pages_.emptied()) {
    const std::size_t row = rowOf(*pages_.find(first_slot));
    std::fill_n(&extents_[row], SlotPage::kSlots, -1.0f);
    changed.emplace_back(row, SlotPage::kSlots);
  }
  forEachPart(edit.runs, [&](std::uint32_t slot, std::uint32_t count, std::size_t source) {
    const SlotPage* const page = pages_.find(slot);
    if (!page) return;
    const std::size_t row = rowOf(*page) + slot % SlotPage::kSlots;
    if (writes) {
      for (std::size_t i = 0; i < count; ++i) {
        const std::array<float, 3> position = edit.position(source + i);
        std::copy_n(position.data(), 3, &positions_[3 * (row + i)]);
      }
      std::copy_n(&edit.extents[source], count, &extents_[row]);
    } else {
      std::fill_n(&extents_[row], count, -1.0f);
    }
    if (!changed.empty() && changed.back().first + changed.back().second == row) {
      changed.back().second += count;
    } else {
      changed.emplace_back(row, count);
    }
  });
  if (edit.clear) changed.assign(rows > 0 ? 1 : 0, {0, rows});  // all rows are new
  return changed;
}

}  // namespace rosplat
