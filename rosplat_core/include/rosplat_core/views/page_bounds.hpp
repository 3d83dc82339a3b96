#pragma once

#include <array>
#include <cstddef>
#include <limits>

#include "rosplat_core/map/slot_pages.hpp"

namespace rosplat {

// Whether a bound of a page proves that all of the page lies beyond a limit. A bound that float32
// can't hold, infinite or NaN, proves nothing: the slots of such a page are tested one by one.
inline bool isBeyond(float bound, float limit) {
  return (bound > limit) & (bound <= std::numeric_limits<float>::max());
}

// SlotPage's bounds of several pages side by side, so that a processor tests several at once.
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
