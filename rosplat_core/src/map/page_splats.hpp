#pragma once

#include <cstddef>
#include <memory>
#include <vector>

#include "rosplat_core/slots/constants.hpp"
#include "rosplat_core/slots/splat_arrays.hpp"

namespace rosplat {

// The splats of a page of slots, in memory of the page's own or in someone else's.
class PageSplats {
 public:
  static constexpr std::size_t kSlots = kPageSlots;

  // A map's channels by their places in it. Null: the page has no values of it.
  using Channels = std::vector<const float*>;

  // Takes arrays as they are, which may end before the page does. keeper: has their memory.
  void refer(const SplatArrays<const float>& arrays, Channels channels,
             std::shared_ptr<const void> keeper);
  // Takes memory of its own: for all slots, bands up to a degree, and these channels. What is there
  // stays the same. Throws std::bad_alloc.
  void reserve(int sh_degree, const std::vector<std::size_t>& channels);

  const SplatArrays<const float>& arrays() const { return arrays_; }
  const float* channel(std::size_t place) const {
    return place < channels_.size() ? channels_[place] : nullptr;
  }
  // To be written to, after reserve().
  SplatArrays<float> own();
  // Not null where the page has values of a channel.
  float* ownChannel(std::size_t place) {
    return place < own_channels_.size() ? own_channels_[place].get() : nullptr;
  }
  std::size_t channels() const { return channels_.size(); }

 private:
  using Floats = std::unique_ptr<float[]>;

  void own(int sh_degree);

  SplatArrays<const float> arrays_;
  Channels channels_;
  std::shared_ptr<const void> keeper_;
  Floats shapes_, sh_;  // positions, orientations, scales and opacities; harmonics
  std::vector<Floats> own_channels_;
};

}  // namespace rosplat
