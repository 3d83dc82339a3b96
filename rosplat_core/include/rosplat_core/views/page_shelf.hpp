#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <vector>

#include "rosplat_core/map/slot_pages.hpp"
#include "rosplat_core/views/page_view.hpp"

namespace rosplat {

// Neighbouring pages of a group. A view tests the bounds of all pages first; if these may be seen,
// it tests the pages side by side.
struct PageShelf {
  static constexpr std::size_t kPages = 32;

  std::size_t begin, end;             // indices among all pages
  SlotPage bounds;                    // around all pages of the shelf
  float widest_parent;                // widest cell whose node stands for a slot of the shelf [m]
  PageBounds<kPages> pages;           // by page
  std::array<float, kPages> parents;  // widest_parent by page [m]
  // Copies of SlotPage's by page: reading the SlotPages as well would take as long as the tests.
  std::array<std::uint32_t, kPages> first_slots, places;
};

// Puts all pages on shelves. widest_parent(page): as PageShelf::widest_parent, of one page [m].
std::vector<PageShelf> shelve(const std::vector<SlotPage>& pages,
                              const std::function<float(const SlotPage&)>& widest_parent);

}  // namespace rosplat
