#pragma once

#include <bitset>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <vector>

#include "rosplat_core/slots/constants.hpp"
#include "rosplat_core/slots/splats.hpp"

namespace rosplat {

// The splats of a page of slots, in the page's own memory or in that of another owner.
class PageSplats {
 public:
  static constexpr std::size_t kSlots = kPageSlots;

  // Refers to the splats from `first` on in place; they may end before the page does. keeper: owns
  // their memory. Returns which of the page's slots hold a valid splat.
  std::bitset<kSlots> refer(const SplatsView& splats, std::size_t first,
                            std::shared_ptr<const void> keeper);
  // Allocates own memory for all slots, bands up to a degree, and these channels, and copies the
  // present splats there. Throws std::bad_alloc.
  void reserve(int sh_degree, const std::vector<std::size_t>& channels);

  // Writes the splat of slot `at` to the i-th place of arrays, with bands up to sh_degree.
  void read(std::size_t at, std::size_t i, int sh_degree, Splats& to) const;
  // Whether the page holds packed rows.
  bool packed() const { return rows_ != nullptr; }
  // Writes the row of slot `at` (packed_rows.hpp), with bands up to sh_degree. Returns false if the
  // page isn't packed.
  bool readRow(std::size_t at, int sh_degree, std::uint8_t* to) const;
  const float* channel(std::size_t place) const {
    return place < channels_.size() ? channels_[place] : nullptr;
  }
  // The page's own arrays, for writing after reserve().
  SplatArrays<float> own();
  // Null if the page has no values of a channel.
  float* ownChannel(std::size_t place) {
    return place < own_channels_.size() ? own_channels_[place].get() : nullptr;
  }
  std::size_t channels() const { return channels_.size(); }

 private:
  using Floats = std::unique_ptr<float[]>;

  void own(int sh_degree);

  SplatArrays<const float> arrays_;
  const std::uint32_t* rows_ = nullptr;  // as in SplatsView
  std::vector<const float*> channels_;   // by place in the map's channels; null: no values
  std::shared_ptr<const void> keeper_;
  Floats shapes_, sh_;  // positions, orientations, scales and opacities; harmonics
  std::vector<Floats> own_channels_;
};

}  // namespace rosplat
