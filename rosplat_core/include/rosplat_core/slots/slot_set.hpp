#pragma once

#include <algorithm>
#include <bitset>
#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

#include "rosplat_core/slots/constants.hpp"

namespace rosplat {

// Runs of consecutive slots: first, count.
using SlotRuns = std::vector<std::pair<std::uint32_t, std::uint32_t>>;

template <typename Visit>
void forEachSlot(const SlotRuns& runs, Visit visit) {
  for (const auto& [first, count] : runs) {
    for (std::uint32_t i = 0; i < count; ++i) visit(first + i);
  }
}

// Calls visit(first slot, count, how many slots come before) for parts of runs, each in one page.
template <typename Visit>
void forEachPart(const SlotRuns& runs, Visit visit) {
  std::size_t before = 0;
  for (const auto& [first, length] : runs) {
    for (std::uint32_t done = 0, count; done < length; done += count, before += count) {
      count = std::min(length - done, kPageSlots - (first + done) % kPageSlots);
      visit(first + done, count, before);
    }
  }
}

inline std::size_t countSlots(const SlotRuns& runs) {
  std::size_t slots = 0;
  for (const auto& [first, count] : runs) slots += count;
  return slots;
}

// A set of slots, with memory for the pages that they lie in.
class SlotSet {
 public:
  static constexpr std::uint32_t kPage = kPageSlots;

  // Makes room for slots, which set() needs. Throws std::bad_alloc: the set is the same then.
  void makeRoom(const SlotRuns& runs);
  // The parts of runs that there is room for: no other slot is in the set.
  SlotRuns within(const SlotRuns& runs) const;

  bool has(std::uint32_t slot) const;
  // Whether any of the kPage slots from page * kPage on is in the set.
  bool any(std::uint32_t page) const;
  // Puts a slot in or takes it out. There must be room for it. Returns whether it was in.
  bool set(std::uint32_t slot, bool in) noexcept;

 private:
  static constexpr std::uint32_t kNone = 0xffffffffu;

  std::vector<std::uint32_t> places_;  // in pages_, by number of the page; kNone: no room
  std::vector<std::bitset<kPage>> pages_;
};

}  // namespace rosplat
