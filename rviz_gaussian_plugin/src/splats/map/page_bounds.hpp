#pragma once

#include <array>
#include <cstddef>

#include "map/slot_pages.hpp"

namespace rosplat {

// Bounds of pages side by side, so that a processor tests several at once: as SlotPage has them.
template <std::size_t N>
struct PageBounds {
  template <typename T>
  using Each = std::array<T, N>;

  std::array<Each<float>, 3> least, most;
  Each<float> extent;

  void put(std::size_t i, const SlotPage& page) {
    for (std::size_t axis = 0; axis < 3; ++axis) {
      least[axis][i] = page.least[axis];
      most[axis][i] = page.most[axis];
    }
    extent[i] = page.extent;
  }
};

}  // namespace rosplat
