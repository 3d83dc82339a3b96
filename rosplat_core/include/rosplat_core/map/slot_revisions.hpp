#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <vector>

namespace rosplat {

// The revision of the last change of each slot of a page, 0 before any. Takes 4 bytes a slot, and
// none while all slots have the same revision.
class SlotRevisions {
 public:
  explicit SlotRevisions(std::size_t slots) : slots_(slots) {}

  std::uint64_t operator[](std::size_t slot) const {
    return since_base_.empty() ? base_ : base_ + since_base_[slot];
  }
  // Sets all slots.
  void fill(std::uint64_t revision) {
    base_ = revision;
    since_base_ = {};
  }
  // Allocates the memory for set(). Throws std::bad_alloc; set() doesn't then, until fill().
  void reserve() {
    if (since_base_.empty()) since_base_.resize(slots_);
  }
  // revision: not below earlier ones. Slots that are more than 2^31 revisions older look newer.
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
