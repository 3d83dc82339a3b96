#include "gpu/slot_store.hpp"

#include <algorithm>

namespace rosplat {

namespace {

constexpr std::size_t kWord = sizeof(std::uint32_t);

std::size_t bandBytes(int band) { return kBandWords[band] * kWord; }

// Not cleared: NVIDIA's driver (580) clears a new buffer after the write that follows.
void writeZeros(gl::Buffer& buffer) {
  const std::vector<std::uint32_t> zeros(buffer.bytes() / kWord);
  buffer.write(0, zeros.data(), buffer.bytes());
}

}  // namespace

SlotStore::Page& SlotStore::page(std::uint32_t first_slot, bool overwritten) {
  const auto found = pages_.find(first_slot);
  if (found != pages_.end()) return found->second;
  Page fresh;
  fresh.slots = gl::Buffer(kPageSlots * kSlotWords * kWord, GL_DYNAMIC_DRAW);
  if (!overwritten) writeZeros(fresh.slots);  // opacity 0: an empty slot
  for (int band = 1; band <= sh_degree_; ++band) {
    fresh.bands[band] = gl::Buffer(kPageSlots * bandBytes(band), GL_DYNAMIC_DRAW);
  }
  return pages_.emplace(first_slot, std::move(fresh)).first->second;
}

void SlotStore::addBands(int degree) {
  for (auto& [first_slot, page] : pages_) {
    for (int band = sh_degree_ + 1; band <= degree; ++band) {
      page.bands[band] = gl::Buffer(kPageSlots * bandBytes(band), GL_DYNAMIC_DRAW);
      writeZeros(page.bands[band]);
    }
  }
  sh_degree_ = std::max(sh_degree_, degree);
}

void SlotStore::apply(const GaussianEdit& edit, double now) {
  if (edit.clear) {
    pages_.clear();
    sh_degree_ = 0;
    capacity_ = 0;
  }
  addBands(edit.sh_degree);
  capacity_ = std::max(capacity_, edit.capacity);

  std::size_t source = 0;
  for (const auto& [run_first, run_count] : edit.runs) {
    std::uint32_t first = run_first, left = run_count;
    while (left > 0) {
      const std::uint32_t offset = first % kPageSlots;
      const std::uint32_t count = std::min(left, kPageSlots - offset);
      if (edit.sh_degree >= 0 || pages_.count(first - offset)) {
        Page& target = page(first - offset, count == kPageSlots);
        if (edit.sh_degree >= 0) {
          const auto begin = edit.slots.begin() + std::ptrdiff_t(kSlotWords * source);
          staged_.assign(begin, begin + std::ptrdiff_t(kSlotWords * count));
        } else {
          staged_.assign(kSlotWords * count, 0u);  // opacity 0: an empty slot
        }
        for (std::size_t i = kChangeWord; i < staged_.size(); i += kSlotWords) {
          staged_[i] |= static_cast<std::uint32_t>(now) << 16;
        }
        target.slots.write(offset * kSlotWords * kWord, staged_.data(), staged_.size() * kWord);
        for (int band = 1; edit.sh_degree >= 0 && band <= sh_degree_; ++band) {
          const std::uint32_t* words = nullptr;
          if (band <= edit.sh_degree) {
            words = &edit.bands[band][kBandWords[band] * source];
          } else {
            staged_.assign(std::size_t(kBandWords[band]) * count, 0u);
            words = staged_.data();
          }
          target.bands[band].write(offset * bandBytes(band), words, count * bandBytes(band));
        }
      }
      first += count;
      left -= count;
      source += count;
    }
  }
}

std::size_t SlotStore::bytes() const {
  std::size_t bytes = 0;
  for (const auto& [first_slot, page] : pages_) {
    bytes += page.slots.bytes();
    for (const gl::Buffer& band : page.bands) bytes += band.bytes();
  }
  return bytes;
}

}  // namespace rosplat
