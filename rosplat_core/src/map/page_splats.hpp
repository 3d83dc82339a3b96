#pragma once

#include <array>
#include <bitset>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <vector>

#include "rosplat_core/slots/constants.hpp"
#include "rosplat_core/slots/splats.hpp"

namespace rosplat {

// The splats of a page of slots as packed rows (packed_slot.hpp), in the page's own memory or in
// that of another owner.
class PageSplats {
 public:
  static constexpr std::size_t kSlots = kPageSlots;

  // Refers to packed splats from `first` on in place; they may end before the page does. keeper:
  // owns their memory. Returns which of the page's slots hold a splat.
  std::bitset<kSlots> refer(const SplatsView& splats, std::size_t first,
                            std::shared_ptr<const void> keeper);
  // Allocates own memory for all slots, bands up to a degree, and these channels, and copies the
  // present splats there. Throws std::bad_alloc.
  void reserve(int sh_degree, const std::vector<std::size_t>& channels);
  // Packs the i-th of some splats into slot `at`, or copies its row; position: in place of its own.
  // Returns false if the splat is invalid, and so is its row then. Needs reserve() before.
  bool write(std::size_t at, const SplatsView& splats, std::size_t i,
             const std::array<float, 3>& position);

  // Writes the splat of slot `at` to the i-th place of arrays.
  void read(std::size_t at, std::size_t i, const SplatArrays<float>& to) const;
  // Writes the row of slot `at`, with bands up to sh_degree.
  void readRow(std::size_t at, int sh_degree, void* to) const;
  const float* channel(std::size_t place) const {
    return place < channels_.size() ? channels_[place] : nullptr;
  }
  // For writing after reserve(); null if the page has no values of a channel.
  float* ownChannel(std::size_t place) {
    return place < own_channels_.size() ? own_channels_[place].get() : nullptr;
  }

 private:
  using Floats = std::unique_ptr<float[]>;

  void own(int sh_degree);

  std::size_t count_ = 0;  // rows that there are
  int sh_degree_ = 0;
  const std::uint32_t* rows_ = nullptr;
  std::vector<const float*> channels_;  // by place in the map's channels; null: no values
  std::shared_ptr<const void> keeper_;
  std::unique_ptr<std::uint32_t[]> own_rows_;
  std::vector<Floats> own_channels_;
};

}  // namespace rosplat
