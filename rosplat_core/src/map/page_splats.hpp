#pragma once

#include <bitset>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <vector>

#include "rosplat_core/slots/constants.hpp"
#include "rosplat_core/slots/splats.hpp"

namespace rosplat {

// The splats of a page of slots, in memory of the page's own or in someone else's.
class PageSplats {
 public:
  static constexpr std::size_t kSlots = kPageSlots;

  // Takes splats from one on as they are, which may end before the page does. keeper: has their
  // memory. Returns which of the page's slots hold one that means something.
  std::bitset<kSlots> refer(const SplatsView& splats, std::size_t first,
                            std::shared_ptr<const void> keeper);
  // Takes memory of its own: for all slots, bands up to a degree, and these channels. What is there
  // stays the same. Throws std::bad_alloc.
  void reserve(int sh_degree, const std::vector<std::size_t>& channels);

  // Puts a splat into the i-th place of arrays that have room for it, with bands up to sh_degree.
  void read(std::size_t at, std::size_t i, int sh_degree, Splats& to) const;
  // Whether the page holds packed rows.
  bool packed() const { return rows_ != nullptr; }
  // Writes it as packed_rows.hpp has it, with bands up to sh_degree. False where the page isn't
  // packed.
  bool readRow(std::size_t at, int sh_degree, std::uint8_t* to) const;
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
  const std::uint32_t* rows_ = nullptr;  // as in SplatsView
  std::vector<const float*> channels_;   // of a map by their places in it; null: no values
  std::shared_ptr<const void> keeper_;
  Floats shapes_, sh_;  // positions, orientations, scales and opacities; harmonics
  std::vector<Floats> own_channels_;
};

}  // namespace rosplat
