#include "map/page_splats.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <utility>

#include "rosplat_core/map/channels.hpp"
#include "rosplat_core/slots/packed_rows.hpp"
#include "rosplat_core/slots/packed_slot.hpp"

namespace rosplat {

std::bitset<PageSplats::kSlots> PageSplats::refer(const SplatsView& splats, std::size_t first,
                                                  std::shared_ptr<const void> keeper) {
  count_ = std::min(splats.arrays.count - first, kSlots);
  sh_degree_ = splats.arrays.sh_degree;
  rows_ = splats.rows + first * rowWords(sh_degree_);
  for (const auto& [name, values] : splats.channels) channels_.push_back(values + first);
  keeper_ = std::move(keeper);
  std::bitset<kSlots> used;
  for (std::size_t i = 0; i < count_; ++i) {
    used[i] = packed_rows::isUsable(rows_ + rowWords(sh_degree_) * i);
  }
  return used;
}

bool PageSplats::write(std::size_t at, const SplatsView& splats, std::size_t i,
                       const std::array<float, 3>& position) {
  std::uint32_t* const row = &own_rows_[rowWords(sh_degree_) * at];
  const SplatArrays<const float>& from = splats.arrays;
  const std::size_t known = rowWords(std::min(from.sh_degree, sh_degree_));
  const std::uint32_t* const source =
      splats.rows ? splats.rows + rowWords(from.sh_degree) * i : nullptr;
  const bool usable = source ? packed_rows::isUsable(source) && allFinite(position.data(), 3)
                             : isUsable(from, i, position.data());
  if (!usable) {
    const float nowhere[] = {std::nanf(""), 0, 0};
    std::memset(row, 0, rowWords(sh_degree_) * sizeof(*row));
    std::memcpy(row, nowhere, sizeof(nowhere));
    return false;
  }
  if (source) {
    std::copy_n(source, known, row);
    std::memcpy(row, position.data(), sizeof(position));
  } else {
    Splat splat = splatAt(from, i);
    splat.position = position;
    packSlot(splat, from.sh + from.shStride() * i + 3, std::min(from.sh_degree, sh_degree_), row,
             bandsOf(row));
  }
  std::fill(row + known, row + rowWords(sh_degree_), 0u);
  return true;
}

void PageSplats::read(std::size_t at, std::size_t i, const SplatArrays<float>& to) const {
  packed_rows::unpack(rows_ + rowWords(sh_degree_) * at, sh_degree_, to, i);
}

void PageSplats::readRow(std::size_t at, int sh_degree, void* to) const {
  const std::size_t known = rowWords(std::min(sh_degree, sh_degree_));
  auto* const words = static_cast<std::uint8_t*>(to);
  const std::size_t bytes = known * sizeof(std::uint32_t);
  std::memcpy(words, rows_ + rowWords(sh_degree_) * at, bytes);
  std::memset(words + bytes, 0, (rowWords(sh_degree) - known) * sizeof(std::uint32_t));
}

void PageSplats::reserve(int sh_degree, const std::vector<std::size_t>& channels) {
  own(sh_degree);
  for (const std::size_t place : channels) {
    if (place >= channels_.size()) {
      own_channels_.resize(place + 1);
      channels_.resize(place + 1);
    }
    if (own_channels_[place]) continue;
    own_channels_[place] = Floats(new float[kSlots]);
    std::fill_n(own_channels_[place].get(), kSlots, kNoValue);
    channels_[place] = own_channels_[place].get();
  }
}

void PageSplats::own(int sh_degree) {
  if (own_rows_ && sh_degree <= sh_degree_) return;
  const int degree = std::max(sh_degree, sh_degree_);
  // Uninitialised, so that slots that nobody writes to take no memory from the system.
  std::unique_ptr<std::uint32_t[]> rows(new std::uint32_t[rowWords(degree) * kSlots]);
  for (std::size_t i = 0; i < count_; ++i) readRow(i, degree, &rows[rowWords(degree) * i]);
  if (!own_rows_) {
    std::vector<Floats> channels(channels_.size());
    for (std::size_t k = 0; k < channels_.size(); ++k) {
      if (!channels_[k]) continue;
      channels[k] = Floats(new float[kSlots]);
      std::copy_n(channels_[k], count_, channels[k].get());
      std::fill_n(channels[k].get() + count_, kSlots - count_, kNoValue);
    }
    own_channels_ = std::move(channels);
    for (std::size_t k = 0; k < channels_.size(); ++k) channels_[k] = own_channels_[k].get();
  }
  own_rows_ = std::move(rows);
  rows_ = own_rows_.get();
  sh_degree_ = degree;
  count_ = kSlots;
  keeper_.reset();
}

}  // namespace rosplat
