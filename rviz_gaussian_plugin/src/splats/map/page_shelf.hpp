#pragma once

#include <cstddef>
#include <vector>

#include "map/lattice.hpp"
#include "map/slot_pages.hpp"

namespace rosplat {

// Some neighbouring pages of a group. What a view can't show by the bounds of all of them, it needs
// not test page by page.
struct PageShelf {
  std::size_t begin, end;            // among all pages
  SlotPage bounds;                   // as if they were one
  float widest_parent = kBoundless;  // of their slots, as SlotStore has it [m]
};

std::vector<PageShelf> shelve(const std::vector<SlotPage>& pages);

}  // namespace rosplat
