#include "map/page_splats.hpp"

#include <algorithm>
#include <cstring>
#include <utility>

#include "map/harmonics.hpp"
#include "rosplat_core/map/channels.hpp"
#include "rosplat_core/slots/packed_rows.hpp"
#include "rosplat_core/slots/packed_slot.hpp"

namespace rosplat {

namespace {

// Uninitialised, so that slots that nobody writes to take no memory from the system.
std::unique_ptr<float[]> floats(std::size_t count) {
  return std::unique_ptr<float[]>(new float[count]);
}

}  // namespace

std::bitset<PageSplats::kSlots> PageSplats::refer(const SplatsView& splats, std::size_t first,
                                                  std::shared_ptr<const void> keeper) {
  const SplatArrays<const float>& from = splats.arrays;
  arrays_.count = std::min(from.count - first, kSlots);
  arrays_.sh_degree = from.sh_degree;
  for (const auto& [name, values] : splats.channels) channels_.push_back(values + first);
  keeper_ = std::move(keeper);
  std::bitset<kSlots> used;
  if (splats.rows) {
    rows_ = splats.rows + first * rowWords(from.sh_degree);
    for (std::size_t i = 0; i < arrays_.count; ++i) used.set(i);
    return used;
  }
  arrays_.positions = from.positions + 3 * first;
  arrays_.orientations = from.orientations + 4 * first;
  arrays_.scales = from.scales + 3 * first;
  arrays_.opacities = from.opacities + first;
  arrays_.sh = from.sh + from.shStride() * first;
  for (std::size_t i = 0; i < arrays_.count; ++i) {
    used[i] = isUsable(arrays_, i, arrays_.positions + 3 * i);
  }
  return used;
}

void PageSplats::read(std::size_t at, std::size_t i, int sh_degree, Splats& to) const {
  float* const sh = &to.sh[harmonicsOf(sh_degree) * i];
  if (!rows_) {
    std::copy_n(arrays_.positions + 3 * at, 3, &to.positions[3 * i]);
    std::copy_n(arrays_.orientations + 4 * at, 4, &to.orientations[4 * i]);
    std::copy_n(arrays_.scales + 3 * at, 3, &to.scales[3 * i]);
    to.opacities[i] = arrays_.opacities[at];
    copyHarmonics(arrays_.sh + arrays_.shStride() * at, arrays_.sh_degree, sh, sh_degree);
    return;
  }
  const std::uint32_t* const row = rows_ + rowWords(arrays_.sh_degree) * at;
  const Splat splat = unpackSlot(row);
  std::copy_n(splat.position.begin(), 3, &to.positions[3 * i]);
  std::copy_n(splat.orientation.begin(), 4, &to.orientations[4 * i]);
  std::copy_n(splat.scale.begin(), 3, &to.scales[3 * i]);
  to.opacities[i] = splat.opacity;
  std::copy_n(splat.color.begin(), 3, sh);
  const int known = std::min(sh_degree, arrays_.sh_degree);
  unpackHarmonics(row, known, bandsOf(row), sh + 3);
  std::fill(sh + harmonicsOf(known), sh + harmonicsOf(sh_degree), 0.0f);
}

bool PageSplats::readRow(std::size_t at, int sh_degree, std::uint8_t* to) const {
  if (!rows_) return false;
  const std::size_t wanted = packed_rows::size(1, sh_degree);
  const std::size_t known = std::min(wanted, packed_rows::size(1, arrays_.sh_degree));
  std::memcpy(to, rows_ + rowWords(arrays_.sh_degree) * at, known);
  std::memset(to + known, 0, wanted - known);
  return true;
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
  SplatArrays<const float> before = arrays_;
  const std::size_t count = before.count;
  Splats unpacked;
  if (rows_) {
    unpacked.positions.resize(3 * count);
    unpacked.orientations.resize(4 * count);
    unpacked.scales.resize(3 * count);
    unpacked.opacities.resize(count);
    unpacked.sh.resize(before.shStride() * count);
    for (std::size_t i = 0; i < count; ++i) read(i, i, before.sh_degree, unpacked);
    before = unpacked.view().arrays;
  }
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
  rows_ = nullptr;
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
