#include "rosplat_core/views/page_shelf.hpp"

#include <algorithm>

namespace rosplat {

std::vector<PageShelf> shelve(const std::vector<SlotPage>& pages,
                              const std::function<float(const SlotPage&)>& widest_parent) {
  constexpr std::size_t kPages = PageShelf::kPages;
  std::vector<PageShelf> shelves;
  shelves.reserve(pages.size() / kPages + 1);
  for (std::size_t i = 0; i < pages.size(); ++i) {
    const SlotPage& page = pages[i];
    if (i % kPages == 0 || shelves.back().bounds.group != page.group) {
      shelves.push_back({i, i, page, 0, {}, {}, {}, {}});
      shelves.back().pages.extent.fill(-1);
    }
    PageShelf& shelf = shelves.back();
    const std::size_t place = i - shelf.begin;
    shelf.end = i + 1;
    shelf.pages.put(place, page);
    shelf.parents[place] = widest_parent(page);
    shelf.first_slots[place] = page.first_slot;
    shelf.places[place] = page.place;
    shelf.widest_parent = std::max(shelf.widest_parent, shelf.parents[place]);
    shelf.bounds.extent = std::max(shelf.bounds.extent, page.extent);
    for (std::size_t axis = 0; axis < 3; ++axis) {
      shelf.bounds.least[axis] = std::min(shelf.bounds.least[axis], page.least[axis]);
      shelf.bounds.most[axis] = std::max(shelf.bounds.most[axis], page.most[axis]);
    }
  }
  return shelves;
}

}  // namespace rosplat
