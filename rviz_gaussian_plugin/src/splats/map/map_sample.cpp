#include "map/map_sample.hpp"

#include <algorithm>
#include <iterator>

namespace rosplat {

void MapSample::keep(std::uint32_t slot, const SampledSplat& splat) {
  while (slot >> k_ >= kMost) {
    ++k_;
    for (std::size_t i = 0; 2 * i < splats_.size(); ++i) splats_[i] = splats_[2 * i];
    splats_.resize((splats_.size() + 1) / 2);
  }
  const std::size_t i = slot >> k_;
  if (i << k_ != slot) return;
  if (i >= splats_.size()) splats_.resize(i + 1);
  splats_[i] = splat;
}

std::vector<SampledSplat> MapSample::splats() const {
  std::vector<SampledSplat> splats;
  std::copy_if(splats_.begin(), splats_.end(), std::back_inserter(splats),
               [](const SampledSplat& splat) { return splat.size >= 0; });
  return splats;
}

}  // namespace rosplat
