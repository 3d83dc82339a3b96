#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <iterator>
#include <vector>

namespace rosplat {

// What decides how well a splat can be drawn.
struct SampledSplat {
  std::array<float, 3> position{};  // relative to its group's origin [m]
  float size = -1;                  // largest standard deviation [m], -1 of an empty slot
  float opacity = 0;
  std::uint32_t group = 0;  // by index
};

// Every 2^k-th slot of a map, with k such that a few thousand stay: for statistics of the whole.
class MapSample {
 public:
  static constexpr std::size_t kMost = 4096;

  void set(std::uint32_t slot, const SampledSplat& splat) noexcept {
    while (slot >> k_ >= kMost) {
      ++k_;
      for (std::size_t i = 0; i < kMost; ++i) {
        splats_[i] = 2 * i < kMost ? splats_[2 * i] : SampledSplat{};
      }
    }
    const std::size_t i = slot >> k_;
    if (i << k_ == slot) splats_[i] = splat;
  }
  void drop(std::uint32_t slot) noexcept { set(slot, {}); }

  // Slots that aren't empty.
  std::vector<SampledSplat> splats() const {
    std::vector<SampledSplat> splats;
    std::copy_if(splats_.begin(), splats_.end(), std::back_inserter(splats),
                 [](const SampledSplat& splat) { return splat.size >= 0; });
    return splats;
  }

 private:
  int k_ = 0;
  std::vector<SampledSplat> splats_{kMost};  // by slot / 2^k
};

}  // namespace rosplat
