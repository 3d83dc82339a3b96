#include "rosplat_core/map/map_sample.hpp"

#include <algorithm>
#include <iterator>

namespace rosplat {

void MapSample::set(std::uint32_t slot, const SampledSplat& splat) noexcept {
  while (slot >> k_ >= kMost) {
    ++k_;
    for (std::size_t i = 0; i < kMost; ++i) {
      splats_[i] = 2 * i < kMost ? splats_[2 * i] : SampledSplat{};
    }
  }
  const std::size_t i = slot >> k_;
  if (i << k_ == slot) splats_[i] = splat;
}

std::vector<SampledSplat> MapSample::splats() const {
  std::vector<SampledSplat> splats;
  std::copy_if(splats_.begin(), splats_.end(), std::back_inserter(splats),
               [](const SampledSplat& splat) { return splat.size >= 0; });
  return splats;
}

}  // namespace rosplat
