#include "map/page_splats.hpp"

#include <algorithm>
#include <utility>

#include "map/harmonics.hpp"
#include "rosplat_core/map/channels.hpp"

namespace rosplat {

namespace {

// Not initialised: memory of slots that nobody writes to is never taken.
std::unique_ptr<float[]> floats(std::size_t count) {
  return std::unique_ptr<float[]>(new float[count]);
}

}  // namespace

void PageSplats::refer(const SplatArrays<const float>& arrays, Channels channels,
                       std::shared_ptr<const void> keeper) {
  arrays_ = arrays;
  arrays_.count = std::min(arrays.count, kSlots);
  channels_ = std::move(channels);
  keeper_ = std::move(keeper);
}

void PageSplats::reserve(int sh_degree, const std::vector<std::size_t>& channels) {
  own(sh_degree);
  for (const std::size_t place : channels) {
    if (place >= channels_.size()) {
      own_channels_.resize(place + 1);
      channels_.resize(place + 1);
    }
    if (own_channels_[place]) continue;
    own_channels_[place] = floats(kSlots);
    std::fill_n(own_channels_[place].get(), kSlots, kNoValue);
    channels_[place] = own_channels_[place].get();
  }
}

void PageSplats::own(int sh_degree) {
  if (shapes_ && sh_degree <= arrays_.sh_degree) return;
  const SplatArrays<const float> before = arrays_;
  const std::size_t count = before.count;
  SplatArrays<const float> after = before;
  after.count = kSlots;
  after.sh_degree = std::max(sh_degree, before.sh_degree);
  Floats sh = floats(after.shStride() * kSlots);
  for (std::size_t i = 0; i < count; ++i) {
    copyHarmonics(before.sh + before.shStride() * i, before.sh_degree,
                  sh.get() + after.shStride() * i, after.sh_degree);
  }
  after.sh = sh.get();
  if (!shapes_) {
    Floats shapes = floats(11 * kSlots);
    std::vector<Floats> own_channels(channels_.size());
    for (std::size_t k = 0; k < channels_.size(); ++k) {
      if (!channels_[k]) continue;
      own_channels[k] = floats(kSlots);
      std::copy_n(channels_[k], count, own_channels[k].get());
      std::fill_n(own_channels[k].get() + count, kSlots - count, kNoValue);
    }
    shapes_ = std::move(shapes);
    own_channels_ = std::move(own_channels);
    for (std::size_t k = 0; k < channels_.size(); ++k) channels_[k] = own_channels_[k].get();
    const SplatArrays<float> into = own();
    std::copy_n(before.positions, 3 * count, into.positions);
    std::copy_n(before.orientations, 4 * count, into.orientations);
    std::copy_n(before.scales, 3 * count, into.scales);
    std::copy_n(before.opacities, count, into.opacities);
    after.positions = into.positions;
    after.orientations = into.orientations;
    after.scales = into.scales;
    after.opacities = into.opacities;
  }
  sh_ = std::move(sh);
  arrays_ = after;
  keeper_.reset();
}

SplatArrays<float> PageSplats::own() {
  float* const shapes = shapes_.get();
  return {kSlots,
          arrays_.sh_degree,
          shapes,
          shapes + 3 * kSlots,
          shapes + 7 * kSlots,
          shapes + 10 * kSlots,
          sh_.get()};
}

}  // namespace rosplat
