#include "map/page_shelf.hpp"

#include <algorithm>

namespace rosplat {

std::vector<PageShelf> shelve(const std::vector<SlotPage>& pages) {
  constexpr std::size_t kPages = 32;
  std::vector<PageShelf> shelves;
  shelves.reserve(pages.size() / kPages + 1);
  for (std::size_t i = 0; i < pages.size(); ++i) {
    const SlotPage& page = pages[i];
    if (i % kPages == 0 || shelves.back().bounds.group != page.group) {
      shelves.push_back({i, i, page});
    }
    PageShelf& shelf = shelves.back();
    shelf.end = i + 1;
    shelf.bounds.extent = std::max(shelf.bounds.extent, page.extent);
    for (std::size_t axis = 0; axis < 3; ++axis) {
      shelf.bounds.least[axis] = std::min(shelf.bounds.least[axis], page.least[axis]);
      shelf.bounds.most[axis] = std::max(shelf.bounds.most[axis], page.most[axis]);
    }
  }
  return shelves;
}

}  // namespace rosplat
