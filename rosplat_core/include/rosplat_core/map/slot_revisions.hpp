#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <vector>

namespace rosplat {

// The revision of the last change of each slot of a page, 0 before any. They take 4 bytes a slot,
// and none where all are alike.
class SlotRevisions {
 public:
  explicit SlotRevisions(std::size_t slots) : slots_(slots) {}

  std::uint64_t operator[](std::size_t slot) const {
    return since_base_.empty() ? base_ : base_ + since_base_[slot];
  }
  // Of all slots.
  void fill(std::uint64_t revision) {
    base_ = revision;
    since_base_ = {};
  }
  // Takes the memory for set(), which may throw std::bad_alloc; set() never does then.
  void reserve() {
    if (since_base_.empty()) since_base_.resize(slots_);
  }
  // revision: not below those before. One 2^31 revisions older is taken for newer than it is.
  void set(std::size_t slot, std::uint64_t revision) {
    reserve();
    if (revision - base_ > kMost) rebase(revision - kMost / 2);
    since_base_[slot] = static_cast<std::uint32_t>(revision - base_);
  }

 private:
  static constexpr std::uint64_t kMost = std::numeric_limits<std::uint32_t>::max();

  void rebase(std::uint64_t base) {
    for (std::uint32_t& since : since_base_) {
      since = static_cast<std::uint32_t>(std::max(base_ + since, base) - base);
    }
    base_ = base;
  }

  std::size_t slots_;
  std::uint64_t base_ = 0;
  std::vector<std::uint32_t> since_base_;
};

}  // namespace rosplat
