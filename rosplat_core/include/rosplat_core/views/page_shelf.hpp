#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <vector>

#include "rosplat_core/map/slot_pages.hpp"
#include "rosplat_core/views/page_bounds.hpp"

namespace rosplat {

// Some neighbouring pages of a group. What a view can't show by the bounds of all of them, it needs
// not test page by page; and the others are tested side by side.
struct PageShelf {
  static constexpr std::size_t kPages = 32;

  std::size_t begin, end;             // among all pages
  SlotPage bounds;                    // as if they were one
  float widest_parent;                // of the cells whose nodes stand for their slots [m]
  PageBounds<kPages> pages;           // each page's
  std::array<float, kPages> parents;  // the same
  // The same, as SlotPage has them: to read these as well would take as long as the tests.
  std::array<std::uint32_t, kPages> first_slots, places;
};

// widest_parent: of a page.
std::vector<PageShelf> shelve(const std::vector<SlotPage>& pages,
                              const std::function<float(const SlotPage&)>& widest_parent);

}  // namespace rosplat
